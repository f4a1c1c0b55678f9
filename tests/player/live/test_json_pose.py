"""Our JSON pose messages: what is read, what is refused, what is counted."""

import json

import numpy as np
import pytest

from player.live.frame import Counters
from player.live.json_pose import REORDERED, JsonDecoder, PoseError, build_pose, parse_pose


def message(sequence=0, *, sender="a", seconds=None, height=None):
    seconds = sequence / 60 if seconds is None else seconds
    pose = np.full((52, 3), 0.01 * (sequence % 100))
    return build_pose(pose, np.zeros(3), time=seconds, sequence=sequence, sender=sender, pelvis_height=height)


def test_a_pose_survives_the_text():
    rng = np.random.default_rng(0)
    axis_angle, root = rng.normal(size=(52, 3)), rng.normal(size=3)
    found = parse_pose(build_pose(axis_angle, root, time=12.5, sequence=7, sender="x", pelvis_height=0.93))
    assert np.abs(found.pose.axis_angle - axis_angle).max() < 1e-6 and np.abs(found.pose.root - root).max() < 1e-6
    assert (found.time, found.sequence, found.sender, found.pelvis_height) == (12.5, 7, "x", 0.93)


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
    with pytest.raises(PoseError):
        parse_pose(REFUSED[case])


def test_unknown_keys_are_ignored():
    assert parse_pose(broken(betas=[1, 2], expr={"a": 1}, id=...)).sender == ""


def feed(order, decoder=None, counters=None):
    decoder, counters = decoder or JsonDecoder(), counters or Counters()
    used = [decoder.decode(message(n), 0.01 * k, counters) for k, n in enumerate(order)]
    return [None if found is None else found[0].sequence for found in used], counters


def test_gaps_late_and_repeated_messages_are_counted():
    used, counters = feed([0, 1, 3, 3, 2, 2, 7, 8])
    assert used == [0, 1, 3, None, None, None, 7, 8]
    assert (counters.late, counters.duplicate, counters.lost) == (1, 2, 3)  # 4, 5 and 6 never came


def test_a_restarted_sender_is_followed_at_once():
    decoder, counters = JsonDecoder(), Counters()
    feed(range(1000, 1010), decoder, counters)
    found = decoder.decode(message(0), 1.0, counters)
    assert found is not None and found[1] and counters.late == counters.lost == 0
    # restarted after a few messages: late ones for a while, then followed
    decoder, counters = JsonDecoder(), Counters()
    feed(range(40), decoder, counters)
    found = [decoder.decode(message(n, seconds=100 + n), 1.0, counters) for n in range(40)]
    assert found.count(None) == counters.late == REORDERED // 2 and found[-1] is not None


def test_one_sender_is_followed_until_it_falls_silent():
    decoder, counters = JsonDecoder(), Counters()
    assert decoder.decode(message(5, sender="a"), 0.0, counters)
    assert decoder.decode(message(9, sender="b"), 0.5, counters) is None and counters.other == 1
    found = decoder.decode(message(10, sender="b"), 2.0, counters)
    assert found is not None and found[0].sender == "b" and found[1] and counters.lost == 0
