"""Two-bone IK: exact where it reaches, nearest where not, continuous, and nothing else moves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from avatar.body import builtin_body
from avatar.limits import clamped, joint_angles, posed
from avatar.skeleton import JOINTS, joint_transforms
from player.pose.ik import LIMBS, reach_for

SOME = settings(max_examples=15, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
limbs = st.sampled_from(sorted(LIMBS))
BODIES = [builtin_body("male").joints.astype(float), builtin_body("female").joints.astype(float)]


def start_pose(seed, scale=0.5):
    rng = np.random.default_rng(seed)
    pose = clamped(rng.normal(size=(52, 3)) * scale)
    return pose, rng.normal(size=3), BODIES[seed % 2], rng


def reach_distance(joints, limb):
    """Shortest and longest distance from first to end joint, metres."""
    first, middle, last, _ = LIMBS[limb]
    a, b = np.linalg.norm(joints[middle] - joints[first]), np.linalg.norm(joints[last] - joints[middle])
    return abs(a - b), a + b


def aimed(seed, limb):
    """A pose, where the limb begins, how near and far it reaches, and a direction."""
    pose, root, joints, rng = start_pose(seed)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    return pose, root, joints, places(pose, root, joints)[LIMBS[limb].first], reach_distance(joints, limb), direction


def places(pose, root, joints):
    return joint_transforms(pose, joints, root)[:, :3, 3]


@SOME
@given(seeds, limbs, st.sampled_from(["world", "follow"]), st.floats(0, 1))
def test_the_end_is_at_every_target_within_reach(seed, limb, end, share):
    pose, root, joints, first, (nearest, farthest), direction = aimed(seed, limb)
    target = first + direction * (nearest + share * (farthest - nearest))
    out = reach_for(pose, root, joints, limb, target, end=end)
    assert np.linalg.norm(places(out, root, joints)[LIMBS[limb].end] - target) < 1e-9
    untouched = np.delete(np.arange(52), LIMBS[limb][:3] if end == "world" else LIMBS[limb][:2])
    assert np.array_equal(out[untouched], pose[untouched])
    before, after = joint_transforms(pose, joints, root), joint_transforms(out, joints, root)
    k = LIMBS[limb].end
    if end == "world":
        np.testing.assert_allclose(after[k, :3, :3], before[k, :3, :3], atol=1e-9)
    else:
        assert np.array_equal(out[k], pose[k])


@SOME
@given(seeds, limbs, st.floats(1.0, 50.0))
def test_out_of_reach_the_end_is_as_near_as_the_limb_gets(seed, limb, beyond):
    pose, root, joints, first, (nearest, farthest), direction = aimed(seed, limb)
    for distance, kept in ((farthest * beyond, farthest), (nearest * 0.5, nearest)):
        target = first + direction * distance
        end = places(reach_for(pose, root, joints, limb, target), root, joints)[LIMBS[limb].end]
        # the nearest point of the shell that the end can be in
        np.testing.assert_allclose(end, first + direction * kept, atol=1e-7)


@SOME
@given(seeds, limbs, st.floats(0.0, 2.5))
def test_where_the_hand_is_already_nothing_changes(seed, limb, bend):
    pose, root, joints, _ = start_pose(seed)
    pose[LIMBS[limb].middle] = posed({JOINTS[LIMBS[limb].middle]: {"flexion": np.degrees(bend)}})[LIMBS[limb].middle]
    here = places(pose, root, joints)[LIMBS[limb].end]
    out = reach_for(pose, root, joints, limb, here)
    np.testing.assert_allclose(joint_transforms(out, joints, root), joint_transforms(pose, joints, root), atol=1e-7)


@settings(SOME, max_examples=6)
@given(seeds, limbs)
def test_a_moving_target_moves_the_limb_continuously(seed, limb):
    """Along a line through reach, full stretch and beyond; at full stretch the bend moves as a square root."""
    pose, root, joints, rng = start_pose(seed, 0.3)
    chain = LIMBS[limb]
    at = places(pose, root, joints)
    line = at[chain.end] - at[chain.first]
    sideways = np.cross(line, rng.normal(size=3))
    ends = [at[chain.first] + s * line + t * sideways / np.linalg.norm(sideways) for s, t in ((0.5, 0.2), (1.6, -0.2))]
    steps = 100
    path = np.linspace(*ends, steps)
    elbows = np.array([places(reach_for(pose, root, joints, limb, p), root, joints)[chain.middle] for p in path])
    step = np.linalg.norm(ends[1] - ends[0]) / steps
    jumps = np.linalg.norm(np.diff(elbows, axis=0), axis=1)
    assert jumps.max() < 3 * np.sqrt(step * np.linalg.norm(line)) and np.median(jumps) < 5 * step


@pytest.mark.parametrize("limb", sorted(LIMBS))
@pytest.mark.parametrize("joints", BODIES)
def test_a_straight_limb_bends_as_anatomy_does(limb, joints):
    """From the T-pose, where the bend has no direction: elbows go back, knees forward, no bone turns about itself."""
    root = np.array([0.3, 1.0, -0.2])
    pose = np.zeros((52, 3))
    chain = LIMBS[limb]
    at = places(pose, root, joints)
    target = at[chain.first] + 0.7 * (at[chain.end] - at[chain.first])
    out = reach_for(pose, root, joints, limb, target)
    moved = places(out, root, joints)
    assert np.linalg.norm(moved[chain.end] - target) < 1e-9
    sticks_out = (moved - at)[chain.middle, 2]
    assert sticks_out > 0.1 if "foot" in limb else sticks_out < -0.1
    angles = np.degrees(joint_angles(out)[chain.middle])
    assert angles[0] > 60 and np.abs(angles[1:]).max() < 6


def test_stretched_folded_and_at_the_shoulder_it_stays_finite_and_put():
    joints = BODIES[0]
    root = np.zeros(3)
    for seed in range(5):
        pose, _, _, _ = start_pose(seed)
        for limb, chain in LIMBS.items():
            first = places(pose, root, joints)[chain.first]
            for target in (first, first + 1e-12, first + [1e-7, 0, 0], first + [0, 1e9, 0]):
                out = reach_for(pose, root, joints, limb, target)
                assert np.isfinite(out).all()
                moved = places(out, root, joints)
                assert np.linalg.norm(moved[chain.first] - first) < 1e-12
                again = reach_for(out, root, joints, limb, target)
                np.testing.assert_allclose(places(again, root, joints), moved, atol=1e-5)


def test_a_limb_of_equal_bones_folds_onto_its_root():
    joints = BODIES[0].copy()
    chain = LIMBS["left_hand"]
    joints[chain.middle] = joints[chain.first] + [0.25, 0, 0]
    joints[chain.end] = joints[chain.middle] + [0.25, 0, 0]
    pose, root = np.zeros((52, 3)), np.zeros(3)
    first = joints[chain.first]
    out = reach_for(pose, root, joints, "left_hand", first)
    assert np.linalg.norm(places(out, root, joints)[chain.end] - first) < 1e-9
    unfolded = reach_for(out, root, joints, "left_hand", first + [0, 0.3, 0])
    assert np.linalg.norm(places(unfolded, root, joints)[chain.end] - first - [0, 0.3, 0]) < 1e-9


@SOME
@given(seeds, limbs, st.floats(-np.pi, np.pi))
def test_the_pole_says_where_elbow_and_knee_point(seed, limb, turn):
    pose, root, joints, first, (_, farthest), direction = aimed(seed, limb)
    chain, target = LIMBS[limb], first + 0.7 * farthest * direction
    across = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    across /= np.linalg.norm(across)
    pole = np.cos(turn) * across + np.sin(turn) * np.cross(direction, across)
    out = reach_for(pose, root, joints, limb, target, pole=2 * pole + 0.5 * direction)
    moved = places(out, root, joints)
    assert np.linalg.norm(moved[chain.end] - target) < 1e-9
    out_of_line = moved[chain.middle] - first
    out_of_line -= direction * (out_of_line @ direction)
    np.testing.assert_allclose(out_of_line / np.linalg.norm(out_of_line), pole, atol=1e-7)


def test_twists_stay_relative_to_the_bending_plane():
    """A forearm turned palm up stays so while the hand is carried about."""
    joints, root = BODIES[0], np.zeros(3)
    pose = posed({"left_elbow": {"flexion": 70, "palm down": -40}, "left_shoulder": {"raise": -40}})
    at = places(pose, root, joints)
    for shift in ([0.1, 0.1, 0.1], [-0.1, 0.2, 0.05], [0.0, -0.15, 0.1]):
        out = reach_for(pose, root, joints, "left_hand", at[20] + shift, end="follow")
        assert np.degrees(joint_angles(out)[18, 2]) == pytest.approx(-40, abs=1e-6)


def test_bad_questions_are_refused():
    joints, root, pose = BODIES[0], np.zeros(3), np.zeros((52, 3))
    with pytest.raises(ValueError, match="no limb 'tail'"):
        reach_for(pose, root, joints, "tail", root)
    with pytest.raises(ValueError, match="finite"):
        reach_for(pose, root, joints, "left_hand", np.array([np.nan, 0, 0]))
    short = joints.copy()
    short[18] = short[16]
    with pytest.raises(ValueError, match="bone of no length"):
        reach_for(pose, root, short, "left_hand", root)
