"""Live poses: odd clocks, lying packets, silence; what goes out comes in again."""

import numpy as np
import pytest
from pose_twins import angles_between

from avatar.body import builtin_body
from avatar.motion.amass import read_amass
from avatar.motion.read import builtin_motion
from avatar.rotation import quaternion_from_axis_angle, quaternion_inverse, quaternion_product
from avatar.skeleton import PARENTS
from experiments.live_sender import bundle_of_55, spoilt
from player.draw.drawing import Pose
from player.live.calibration import calibrated, pose_from_rig
from player.live.command import encoder, send, timed_poses
from player.live.inbox import Inbox
from player.live.one_euro import OneEuro
from player.live.osc import LARGEST
from player.live.take import Take
from player.live.vmc import VmcRig


@pytest.mark.parametrize("kind", ["vmc", "udp"])
@pytest.mark.parametrize("motion", ["counting", "walking"])
def test_a_motion_sent_out_comes_back_as_the_same_file(kind, motion, tmp_path, within):
    source = builtin_motion(motion)
    now, take = [0.0], Take(tmp_path / "take.npz")
    inbox = Inbox(kind, take=take)
    encode = encoder(kind, builtin_body("male"), lambda: 2e9 + now[0])
    send(
        timed_poses(source, source.rate, loop=False), encode, lambda data: inbox.feed(data, now[0]),
        clock=lambda: now[0], sleep=lambda wait: now.__setitem__(0, now[0] + wait),
    )  # fmt: skip
    inbox.finish()
    take.finish()
    found, sent = read_amass(tmp_path / "take.npz").read(), source.read()
    assert found.axis_angle.shape == sent.axis_angle.shape and found.rate == sent.rate
    within(angles_between(found.axis_angle, sent.axis_angle), 1e-4, "rad")
    within(found.root - sent.root, 1e-5, "m")


@pytest.mark.parametrize("turn", [0.0, 1e-8, 1.0, np.pi - 1e-6, np.pi])
def test_t_pose_calibration_recovers_any_rig(turn, within):
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(52, 3))
    rest = quaternion_from_axis_angle(turn * axes / np.linalg.norm(axes, axis=1, keepdims=True))
    W = np.concatenate([[[0.0, 0, 0, 1]], rest[PARENTS[1:]]])
    axis_angle = rng.normal(size=(52, 3))
    zero, identity = np.zeros(3), np.array([0.0, 0, 0, 1])

    def raw(pose):
        local = quaternion_product(quaternion_inverse(W), quaternion_from_axis_angle(pose))
        return VmcRig(quaternion_product(local, rest), zero, identity, zero, None)

    posed, t_pose = raw(axis_angle), raw(np.zeros((52, 3)))
    for rig, expected in ((posed, axis_angle), (t_pose, 0 * axis_angle)):
        found = pose_from_rig(rig, calibrated(t_pose)).axis_angle
        within(angles_between(found, expected), 1e-12, "rad")
    # such a rig is one whose bones turn in the world as ours do, each from its own rest
    theirs, ours = posed.rotations.copy(), quaternion_from_axis_angle(axis_angle)
    for joint in range(1, 52):
        for world in (theirs, ours):
            world[joint] = quaternion_product(world[PARENTS[joint]], world[joint])
    assert np.abs((theirs * quaternion_product(ours, rest)).sum(-1)).min() > 1 - 1e-10


@pytest.mark.rows
@pytest.mark.parametrize("kind", ["vmc", "udp"])
@pytest.mark.parametrize(
    "clock", ["steady", "backwards", "30 days on", "stall of 10 s", "set ahead", "frozen", "reordered", "twice"]
)
def test_the_last_pose_is_shown_whatever_the_sender_clock_does(kind, clock, within):
    encode_at = [0.0]
    encode = encoder(kind, builtin_body("male"), lambda: encode_at[0])
    inbox, packets, times = Inbox(kind), [], []
    for n in range(100):
        seconds, received = n / 60, 1000 + n / 60
        if clock == "backwards" and n >= 50:
            seconds -= 5000
        elif clock == "30 days on":
            seconds, received = seconds + 30 * 86400, received + 30 * 86400
        elif clock == "stall of 10 s" and n >= 50:
            seconds, received = seconds + 10, received + 10
        elif clock == "set ahead" and n >= 50:
            seconds += 5000
        elif clock == "frozen":
            seconds = 7.0
        encode_at[0] = seconds
        axis_angle = np.zeros((52, 3))
        axis_angle[16, 2] = 0.01 * n
        packets.append((encode(n, seconds, Pose(axis_angle, np.array([0, 0.9, 0.0]))), received))
    if clock == "reordered":
        for n in range(1, 98, 4):
            packets[n], packets[n + 1] = ((packets[n + 1][0], packets[n][1]), (packets[n][0], packets[n + 1][1]))
    if clock == "twice":
        packets = [packet for packet in packets for _ in range(2)]
    for data, received in packets:
        inbox.feed(data, received)
        times.append(inbox.newest.time)
        found = inbox.sample()
        assert found is not None and np.isfinite(found[1].axis_angle).all()
    steps = np.diff(times)
    assert (steps >= 0).all() and (clock == "frozen" or abs(times[-1] - packets[-1][1]) < 0.02)
    assert clock not in ("steady", "30 days on") or np.allclose(steps, 1 / 60, atol=1e-6)
    late = 25 if clock == "reordered" else 0
    assert inbox.counters.late == late and inbox.counters.lost == inbox.counters.malformed == 0
    assert inbox.counters.duplicate == (100 if clock == "twice" else 0)
    found = inbox.sample()  # a silent sender: held
    assert found is not None
    within(found[1].axis_angle[16, 2] - 0.99, 1e-6, "rad")


@pytest.mark.parametrize("kind", ["vmc", "udp"])
def test_good_poses_come_through_ten_thousand_spoilt_packets_a_second(kind, within):
    """A second of poses at 240 Hz, of 55 bones as VMC, among cut, lying, noisy and oversized packets: every pose
    arrives, every other packet is counted."""
    rng, encode, inbox = np.random.default_rng(0), encoder(kind, builtin_body("male")), Inbox(kind)
    axis_angle, oversized, thrown = np.full((52, 3), 0.1), 0, 0
    for n in range(240):
        axis_angle = np.full((52, 3), 0.1 + 1e-3 * n)
        good = encode(n, n / 240, Pose(axis_angle, np.zeros(3)))
        good = bundle_of_55(good) if kind == "vmc" else good
        inbox.feed(good, n / 240)
        for k in range(42):
            large = k == 41
            inbox.feed(bytes(LARGEST + 4) if large else spoilt(rng, good), n / 240 + k / 10_080)
            oversized, thrown = oversized + large, thrown + 1
        found = inbox.sample()
        assert found is not None
        within(found[1].axis_angle - axis_angle, 1e-6, "rad")
    count = inbox.counters
    assert thrown >= 10_000 and count.received == 240 + thrown
    # a spoilt number in the text of a pose may leave one that came before
    again = count.late + count.duplicate if kind == "udp" else 0
    assert (count.frames, count.oversized, count.malformed + again) == (240, oversized, thrown - oversized)


@pytest.mark.parametrize("dt", [-1.0, 0.0, 1e-9, 1e-6, 1 / 240, 1 / 24, 10.0, 30 * 86400.0])
def test_one_euro_leaves_a_constant_pose_constant(dt, within):
    pose = Pose(np.random.default_rng(0).normal(size=(52, 3)), np.array([1.0, 2, 3]))
    smooth = OneEuro()
    for _ in range(200):
        found = smooth(pose, dt)
    within(np.append(angles_between(found.axis_angle, pose.axis_angle), found.root - pose.root), 1e-12, "")
