"""Frames between network and window: the newest one, odd clocks, silence, floods of nonsense."""

import numpy as np

from player.live.frame import Counters
from player.live.inbox import Inbox
from player.live.json_pose import build_pose
from player.live.osc import build_bundle, build_message
from player.live.take import Take
from player.live.vmc import VmcEncoder
from player.scene.mannequin import builtin_body

ENCODER = VmcEncoder(builtin_body("male").joints)


def bundle(angle, seconds):
    axis_angle = np.zeros((52, 3))
    axis_angle[16, 2] = angle
    return ENCODER.encode(axis_angle, np.array([angle, 1.0, 0.0]), seconds)


def message(angle, seconds, sequence, *, sender=""):
    axis_angle = np.zeros((52, 3))
    axis_angle[16, 2] = angle
    root = np.array([angle, 1.0, 0.0])
    return build_pose(axis_angle, root, time=seconds, sequence=sequence, sender=sender)


def shown(inbox):
    found = inbox.sample()
    return None if found is None else found[1].axis_angle[16, 2]


def test_the_newest_pose_is_shown_and_held():
    inbox = Inbox("vmc")
    assert inbox.sample() is None and inbox.facts(0.0).age is None
    for n in range(60):
        inbox.feed(bundle(0.01 * n, n / 60), 100 + n / 60)
    assert abs(shown(inbox) - 0.59) < 1e-6
    facts = inbox.facts(101.0)
    assert abs(facts.rate - 60) < 1e-6 and abs(facts.age - 1 / 60) < 1e-9
    held = inbox.facts(111.0)  # a stall of 10 s
    assert abs(shown(inbox) - 0.59) < 1e-6 and held.rate == 0 and held.age > 10
    assert inbox.counters == Counters(received=60, frames=60)


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


def test_memory_does_not_grow():
    inbox = Inbox("udp")
    for n in range(3000):
        inbox.feed(message(0.0, n * 1e-4, n, sender=""), n * 1e-4)
    assert len(inbox.arrivals) <= 64 and len(inbox.json.recent) <= 128
    inbox = Inbox("vmc")
    for n in range(2000):
        inbox.feed(build_message("/VMC/Ext/Bone/Pos", f"Bone{n}", *[0.0] * 6, 1.0), 0.0)
        inbox.feed(build_message("/VMC/Ext/T", float(n)), 0.0)
    assert len(inbox.vmc.bones) == 0 and len(inbox.vmc.recent) <= 16 and inbox.newest is None
