"""Feet held where they stand: how far they slide, what bends, and that nothing changes where nothing is held."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.motion.clip import Clip
from avatar.skeleton import joint_transforms
from player.effects.foot_lock import FootLock
from player.effects.held_feet import MOST_BENT, TOES, TOGETHER, HeldFeet, Steps, found_steps, leg_bones, offset
from player.film.shot import Shot
from player.film.stage import Stage
from player.pose.ik import reach_for
from player.scene.effects import PLAIN
from player.scene.motions import motion_for
from player.scene.scene import Scene, SceneAvatar
from player.scene.track import Track

LOCK = FootLock()


@pytest.fixture(scope="module")
def sliding(avatar) -> Clip:
    """The walk, blown sideways at 12 cm/s and trembling: feet slide all the time."""
    clip = motion_for(avatar, "walking").read()
    seconds = np.arange(len(clip.root)) / clip.rate
    drift = np.stack([0.12 * seconds, 0.004 * np.sin(9 * seconds), 0.01 * np.sin(5 * seconds)], 1)
    return replace(clip, root=clip.root + drift)


@pytest.fixture(scope="module")
def joints(avatar):
    return avatar.joint_positions.astype(float)


def held_on(clip: Clip, joints, lock: FootLock = LOCK) -> HeldFeet:
    return HeldFeet(clip, joints, lock)


def held_poses(feet: HeldFeet, clip: Clip):
    return [feet.pose(frame, 0, clip) for frame in range(len(clip.root))]


def poses_of(clip: Clip):
    return list(zip(clip.axis_angle.astype(float), clip.root.astype(float), strict=True))


def places(poses, joints):
    axis_angle, root = (np.stack(part) for part in zip(*poses, strict=True))
    return joint_transforms(axis_angle, joints, root)


def test_toes_slide_no_further_than_2_mm_while_they_are_held_and_knees_bend_within_limits(joints, sliding):
    feet, raw = held_on(sliding, joints), poses_of(sliding)
    held = held_poses(feet, sliding)
    before, after = places(raw, joints)[..., :3, 3], places(held, joints)
    slid = {"before": [], "after": []}
    for steps, toe in zip(feet.steps, TOES, strict=True):
        assert len(steps.start) >= 3, "a walk has steps"
        for start, stop in zip(steps.start.astype(int), steps.stop.astype(int), strict=True):
            for name, path in (
                ("before", before[start : stop + 1, toe]),
                ("after", after[start : stop + 1, toe, :3, 3]),
            ):
                slid[name].append(np.linalg.norm(path - path[0], axis=1).max())
    assert np.median(slid["before"]) > 0.02 and max(slid["after"]) <= 0.002
    for leg, (hip, knee, ankle) in {"left_foot": (1, 4, 7), "right_foot": (2, 5, 8)}.items():
        a, b = leg_bones(joints, leg)
        at = after[..., :3, 3]
        assert np.linalg.norm(at[:, ankle] - at[:, hip], axis=1).max() <= a + b + 1e-9
        # the knee opens to the side it did: forwards of the line from hip to ankle, seen in the thigh's frame
        shin = np.einsum("fji,fj->fi", after[:, hip, :3, :3], at[:, ankle] - at[:, knee])
        thigh = np.einsum("fji,fj->fi", after[:, hip, :3, :3], at[:, knee] - at[:, hip])
        bend = np.arctan2(np.linalg.norm(np.cross(thigh, shin), axis=1), (thigh * shin).sum(1))
        assert bend.max() <= MOST_BENT + 1e-6
        assert (np.cross(thigh, shin)[bend > 0.2, 0] > 0).all(), "no knee bends backwards"


def test_nothing_jumps_when_a_foot_is_taken_and_let_go(joints, sliding):
    """Steps between frames grow by little: the release takes time, also of the pelvis."""
    feet, raw = held_on(sliding, joints), poses_of(sliding)
    held = held_poses(feet, sliding)
    before, after = (np.diff(places(some, joints)[..., :3, 3], 2, axis=0) for some in (raw, held))
    # acceleration, metres a frame and frame, of pelvis, knees, ankles and toes
    for joint in (0, 4, 5, 7, 8, 10, 11):
        rough, smooth = (np.linalg.norm(path[:, joint], axis=1) for path in (before, after))
        assert smooth.max() < rough.max() + 0.012


def test_a_rig_of_a_hundredth_is_held_as_the_whole_one(joints, sliding):
    small = replace(sliding, root=0.01 * sliding.root)
    whole, tiny = held_on(sliding, joints), held_on(small, 0.01 * joints)
    assert [len(steps.start) for steps in whole.steps] == [len(steps.start) for steps in tiny.steps]
    for frame in range(0, len(sliding.root), 7):
        a = whole.pose(frame, 0, sliding)
        b = tiny.pose(frame, 0, small)
        # the toe's own path is the same, a hundredth as long; the pelvis's drop too
        np.testing.assert_allclose(b[1], 0.01 * a[1], atol=1e-9)
        np.testing.assert_allclose(
            places([b], 0.01 * joints)[0, :, :3, 3], 0.01 * places([a], joints)[0, :, :3, 3], atol=1e-8
        )


def test_the_pelvis_gives_way_where_a_leg_is_too_short(joints):
    """Standing straight, one foot is held where it was while the body drifts away."""
    height = -places([(np.zeros((52, 3)), np.zeros(3))], joints)[0, TOES[0], 1, 3]
    root = np.tile([0.0, height, 0.0], (60, 1))
    root[:, 0] = np.linspace(0, 0.28, 60)
    clip = Clip(np.zeros((60, 52, 3)), root, 30.0)
    feet = held_on(clip, joints)
    held = held_poses(feet, clip)
    dropped = root[:, 1] - np.stack([r for _, r in held])[:, 1]
    assert 0.002 < dropped.max() < 0.15 and dropped.min() >= 0
    toes = places(held, joints)[:, TOES[0], :3, 3]
    assert np.linalg.norm(toes - toes[0], axis=1).max() < 0.002


def test_hysteresis_keeps_a_toe_that_trembles_about_the_threshold():
    rate, seconds = 60.0, np.arange(240) / 60.0
    # its speed swings between .5 and 1.5 of the threshold
    toe = np.zeros((240, 3))
    toe[:, 0] = np.cumsum(0.35 * (1 + 0.5 * np.sin(20 * seconds)) / rate) * 0.2
    toe[:, 0] += 0.02 * np.sin(15 * seconds)
    steps = found_steps(toe, 0.0, rate, replace(LOCK, farthest=1.0), 1.0)
    assert len(steps.start) == 1 and steps.stop[0] - steps.start[0] > 200
    high = toe + [0, 0.07, 0]
    assert len(found_steps(high, 0.0, rate, LOCK, 1.0).start) == 0, "slow, and high: it is no step"


def test_where_no_foot_is_held_it_is_the_very_pose(joints, sliding):
    up = replace(sliding, root=sliding.root + np.linspace(0, 30, len(sliding.root))[:, None] * [0, 1, 0])
    feet = held_on(up, joints, replace(LOCK, release=0.05))
    (axis_angle, root), last = feet.pose(len(up.root) - 1, 0, up), len(up.root) - 1
    assert np.shares_memory(axis_angle, up.axis_angle[last]) and np.shares_memory(root, up.root[last])
    steps = Steps(*np.zeros((2, 0)), *np.zeros((3, 0, 3)))
    assert not offset(steps, 5, np.ones(3), 3.0).any()


def test_off_is_bit_identical_and_shares_of_a_film_are_the_film():
    entry = SceneAvatar("mannequin", "walking")
    plain, asked = (Stage(Scene((entry,), effects=replace(PLAIN, foot_lock=lock)), 1) for lock in (None, LOCK))
    raw = Track(plain.tracks[0].motion).pose
    changed = 0
    for frame in range(0, plain.frames, 5):
        (a, root), (b, same) = plain.poses(frame)[0], raw(frame / plain.rate)
        assert np.array_equal(a, b) and np.array_equal(root, same)
        changed += not np.array_equal(asked.poses(frame)[0][0], a)
    assert changed > 10
    # another machine begins in the middle
    other = Stage(asked.scene, 1)
    for frame in (200, 120, 121, 7):
        for one, two in zip(asked.poses(frame)[0], other.poses(frame)[0], strict=True):
            assert np.array_equal(one, two)
    identities = [Shot(stage.scene, 0, 9, (64, 64), 30.0, None).identity() for stage in (plain, asked)]
    assert identities[0] != identities[1], "parts of the one are no parts of the other"


def test_a_motion_of_one_frame_and_one_that_never_stands_are_left_alone(joints):
    clip = Clip(np.zeros((1, 52, 3)), np.zeros((1, 3)), 30.0)
    track = Track(clip, joints=joints, foot_lock=LOCK)
    assert np.array_equal(track.pose(0.0)[1], clip.root[0])
    flying = Clip(np.zeros((50, 52, 3)), np.cumsum(np.full((50, 3), 0.2), 0), 30.0)
    feet = held_on(flying, joints)
    assert not feet.held(0, flying.axis_angle, flying.root).changed.any()


def test_neighbours_are_solved_at_once_as_each_alone(joints, sliding, monkeypatch):
    feet, calls = held_on(sliding, joints), []
    frames = len(sliding.root)
    alone = [feet.held(k, sliding.axis_angle[k : k + 1], sliding.root[k : k + 1]) for k in range(frames)]
    monkeypatch.setattr("player.effects.held_feet.reach_for", lambda *given: calls.append(1) or reach_for(*given))
    together = held_poses(feet, sliding)
    assert len(calls) <= 2 * -(-frames // TOGETHER)
    for one, (axis_angle, root) in zip(alone, together, strict=True):
        np.testing.assert_allclose(axis_angle, one.axis_angle[0], rtol=0, atol=1e-12)
        np.testing.assert_allclose(root, one.root[0], rtol=0, atol=1e-12)
