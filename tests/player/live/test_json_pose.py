"""Our JSON pose messages, and frames between network and window: odd clocks, silence, floods of nonsense."""

import json

import numpy as np
import pytest

from player.draw.drawing import Pose
from player.live.frame import Counters, MalformedError
from player.live.inbox import Inbox
from player.live.json_pose import REORDERED, JsonDecoder, build_pose, parse_pose
from player.live.osc import build_bundle, build_message
from player.live.take import Take


def message(sequence=0, *, sender="a", seconds=None):
    seconds = sequence / 60 if seconds is None else seconds
    pose = np.full((52, 3), 0.01 * (sequence % 100))
    return build_pose(Pose(pose, np.zeros(3)), time=seconds, sequence=sequence, sender=sender)


def test_a_pose_survives_the_text_and_unknown_keys_are_ignored():
    rng = np.random.default_rng(0)
    axis_angle, root = rng.normal(size=(52, 3)), rng.normal(size=3)
    found = parse_pose(build_pose(Pose(axis_angle, root), time=12.5, sequence=7, sender="x", pelvis_height=0.93))
    assert np.abs(found.pose.axis_angle - axis_angle).max() < 1e-6 and np.abs(found.pose.root - root).max() < 1e-6
    assert (found.time, found.sequence, found.sender, found.pelvis_height) == (12.5, 7, "x", 0.93)
    assert parse_pose(broken(betas=[1, 2], expr={"a": 1}, id=...)).sender == ""


def broken(**changes):
    content = json.loads(message()) | changes
    return json.dumps({key: value for key, value in content.items() if value is not ...})


REFUSED = {
    "no JSON": b"pose",
    "not UTF-8": b"\xff\xfe{}",
    "a list": b"[]",
    "nested": b"[" * 16000,
    "another version": broken(v=2),
    "no poses": broken(poses=...),
    "155 numbers": broken(poses=[0] * 155),
    "NaN": message().replace(b"0.0", b"NaN", 1),
    "infinite": broken(trans=[0, 0, 1e309]),
    "huge": broken(trans=[0, 0, 1e300]),
    "text": broken(trans=["0", 0, 0]),
    "true": broken(poses=[True] * 156),
    "sequence below 0": broken(seq=-1),
    "sequence 1.5": broken(seq=1.5),
    "a huge whole number": broken(seq=10**400),
    "a huge trans": broken(trans=[10**400, 0, 0]),
    "too many digits": b'{"v":1,"seq":' + b"1" * 9000 + b"}",
    "id": broken(id=[1]),
    "long id": broken(id="x" * 65),
    "no time": broken(t=...),
    "pelvis": broken(pelvis_height=0),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_pose_is_refused(case):
    with pytest.raises(MalformedError):
        parse_pose(REFUSED[case])


def feed(order, decoder=None, counters=None):
    decoder, counters = decoder or JsonDecoder(), counters or Counters()
    used = [decoder.decode(message(n), 0.01 * k, counters) for k, n in enumerate(order)]
    return [None if found is None else found.content.sequence for found in used], counters


def test_one_sender_is_followed_at_a_time_a_restarted_one_at_once():
    used, counters = feed([0, 1, 3, 3, 2, 2, 7, 8])
    assert used == [0, 1, 3, None, None, None, 7, 8]
    assert (counters.late, counters.duplicate, counters.lost) == (1, 2, 3)  # 4, 5 and 6 never came
    decoder, counters = JsonDecoder(), Counters()
    assert decoder.decode(message(5, sender="a"), 0.0, counters)
    assert decoder.decode(message(9, sender="b"), 0.5, counters) is None and counters.other == 1
    found = decoder.decode(message(10, sender="b"), 2.0, counters)
    assert found is not None and found.content.sender == "b" and found.restarted and counters.lost == 0
    decoder, counters = JsonDecoder(), Counters()
    assert all(decoder.decode(message(0, seconds=n), 0.0, counters) for n in range(3)) and counters.lost == 0
    decoder, counters = JsonDecoder(), Counters()
    feed(range(1000, 1010), decoder, counters)
    found = decoder.decode(message(0), 1.0, counters)
    assert found is not None and found.restarted and counters.late == counters.lost == 0
    # restarted after a few messages: late ones for a while, then followed
    decoder, counters = JsonDecoder(), Counters()
    feed(range(40), decoder, counters)
    found = [decoder.decode(message(n, seconds=100 + n), 1.0, counters) for n in range(40)]
    assert found.count(None) == counters.late == REORDERED // 2 and found[-1] is not None


def test_memory_does_not_grow():
    inbox = Inbox("udp")
    for n in range(3000):
        inbox.feed(message(n, seconds=n * 1e-4), n * 1e-4)
    assert len(inbox.arrivals) <= 64 and len(inbox.decoder.recent) <= 128
    inbox = Inbox("vmc")
    for n in range(2000):
        inbox.feed(build_message("/VMC/Ext/Bone/Pos", f"Bone{n}", *[0.0] * 6, 1.0), 0.0)
        inbox.feed(build_message("/VMC/Ext/T", float(n)), 0.0)
    assert len(inbox.decoder.bones) == 0 and len(inbox.decoder.recent) <= 16 and inbox.newest is None


def test_a_frame_in_two_datagrams_is_one_frame(tmp_path):
    half = [("LeftUpperArm", 0.2), ("RightUpperArm", 0.3)]
    inbox = Inbox("vmc", take=Take(tmp_path / "take.npz"))
    for n in range(10):
        for name, turn in half:
            turn *= n / 10
            bone = build_message(
                "/VMC/Ext/Bone/Pos", name, 0.0, 0.0, 0.0, float(np.sin(turn)), 0.0, 0.0, float(np.cos(turn))
            )
            inbox.feed(build_bundle([bone]), n / 30)
    assert inbox.counters.frames == 10
    take = inbox.take
    inbox.finish()
    recorded = take.motion().read().axis_angle[:, [16, 17], 0]
    take.close()
    assert np.allclose(recorded, np.arange(10)[:, None] / 10 * [0.4, 0.6], atol=1e-6)
