"""Two-bone IK, exact where it reaches and nearest where not, and feet that it holds where they stand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from avatar.body import builtin_body
from avatar.limits import clamped, joint_angles, posed
from avatar.motion.clip import Clip
from avatar.skeleton import JOINTS, joint_transforms
from player.effects.foot_lock import FootLock
from player.effects.held_feet import MOST_BENT, TOES, TOGETHER, HeldFeet, Steps, found_steps, leg_bones, offset
from player.film.shot import Shot
from player.film.stage import Stage
from player.pose.ik import LIMBS, reach_for
from player.scene.effects import PLAIN
from player.scene.motions import motion_for
from player.scene.scene import Scene, SceneAvatar
from player.scene.track import Track

SOME = settings(max_examples=15, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
limbs = st.sampled_from(sorted(LIMBS))
BODIES = [builtin_body("male").joints.astype(float), builtin_body("female").joints.astype(float)]


def start_pose(seed, scale=0.5):
    rng = np.random.default_rng(seed)
    pose = clamped(rng.normal(size=(52, 3)) * scale)
    return pose, rng.normal(size=3), BODIES[seed % 2], rng


def aimed(seed, limb):
    """A pose, where the limb begins, how near and far it reaches, and a direction."""
    pose, root, joints, rng = start_pose(seed)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    first, middle, last, _ = LIMBS[limb]
    a, b = np.linalg.norm(joints[middle] - joints[first]), np.linalg.norm(joints[last] - joints[middle])
    return pose, root, joints, places(pose, root, joints)[first], (abs(a - b), a + b), direction


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


def test_at_its_limits_a_limb_stays_finite_and_bad_questions_are_refused():
    joints, root = BODIES[0], np.zeros(3)
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
    pose = np.zeros((52, 3))
    with pytest.raises(ValueError, match="finite"):
        reach_for(pose, root, joints, "left_hand", np.array([np.nan, 0, 0]))
    short = joints.copy()
    short[18] = short[16]
    with pytest.raises(ValueError, match="bone of no length"):
        reach_for(pose, root, short, "left_hand", root)


def test_equal_bones_fold_onto_the_root_and_twists_stay_relative_to_the_bending_plane():
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
    # A forearm turned palm up stays so while the hand is carried about.
    joints, root = BODIES[0], np.zeros(3)
    pose = posed({"left_elbow": {"flexion": 70, "palm down": -40}, "left_shoulder": {"raise": -40}})
    at = places(pose, root, joints)
    for shift in ([0.1, 0.1, 0.1], [-0.1, 0.2, 0.05], [0.0, -0.15, 0.1]):
        out = reach_for(pose, root, joints, "left_hand", at[20] + shift, end="follow")
        assert np.degrees(joint_angles(out)[18, 2]) == pytest.approx(-40, abs=1e-6)


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


def held_poses(feet: HeldFeet, clip: Clip):
    return [feet.pose(frame, 0, clip) for frame in range(len(clip.root))]


def poses_of(clip: Clip):
    return list(zip(clip.axis_angle.astype(float), clip.root.astype(float), strict=True))


def transforms(poses, joints):
    axis_angle, root = (np.stack(part) for part in zip(*(pose[:2] for pose in poses), strict=True))
    return joint_transforms(axis_angle, joints, root)


def test_toes_slide_no_further_than_2_mm_while_they_are_held_and_knees_bend_within_limits(joints, sliding):
    feet, raw = HeldFeet(sliding, joints, LOCK), poses_of(sliding)
    held = held_poses(feet, sliding)
    before, after = transforms(raw, joints)[..., :3, 3], transforms(held, joints)
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
    feet, raw = HeldFeet(sliding, joints, LOCK), poses_of(sliding)
    held = held_poses(feet, sliding)
    before, after = (np.diff(transforms(some, joints)[..., :3, 3], 2, axis=0) for some in (raw, held))
    # acceleration, metres a frame and frame, of pelvis, knees, ankles and toes
    for joint in (0, 4, 5, 7, 8, 10, 11):
        rough, smooth = (np.linalg.norm(path[:, joint], axis=1) for path in (before, after))
        assert smooth.max() < rough.max() + 0.012


def test_a_rig_of_a_hundredth_is_held_as_the_whole_one(joints, sliding):
    small = replace(sliding, root=0.01 * sliding.root)
    whole, tiny = HeldFeet(sliding, joints, LOCK), HeldFeet(small, 0.01 * joints, LOCK)
    assert [len(steps.start) for steps in whole.steps] == [len(steps.start) for steps in tiny.steps]
    for frame in range(0, len(sliding.root), 7):
        a = whole.pose(frame, 0, sliding)
        b = tiny.pose(frame, 0, small)
        # the toe's own path is the same, a hundredth as long; the pelvis's drop too
        np.testing.assert_allclose(b[1], 0.01 * a[1], atol=1e-9)
        np.testing.assert_allclose(
            transforms([b], 0.01 * joints)[0, :, :3, 3], 0.01 * transforms([a], joints)[0, :, :3, 3], atol=1e-8
        )


def test_the_pelvis_gives_way_where_a_leg_is_too_short(joints):
    """Standing straight, one foot is held where it was while the body drifts away."""
    height = -transforms([(np.zeros((52, 3)), np.zeros(3))], joints)[0, TOES[0], 1, 3]
    root = np.tile([0.0, height, 0.0], (60, 1))
    root[:, 0] = np.linspace(0, 0.28, 60)
    clip = Clip(np.zeros((60, 52, 3)), root, 30.0)
    feet = HeldFeet(clip, joints, LOCK)
    held = held_poses(feet, clip)
    dropped = root[:, 1] - np.stack([pose.root for pose in held])[:, 1]
    assert 0.002 < dropped.max() < 0.15 and dropped.min() >= 0
    toes = transforms(held, joints)[:, TOES[0], :3, 3]
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


def test_where_no_foot_is_held_and_in_a_single_frame_it_is_the_very_pose(joints, sliding):
    up = replace(sliding, root=sliding.root + np.linspace(0, 30, len(sliding.root))[:, None] * [0, 1, 0])
    feet = HeldFeet(up, joints, replace(LOCK, release=0.05))
    (axis_angle, root, _), last = feet.pose(len(up.root) - 1, 0, up), len(up.root) - 1
    assert np.shares_memory(axis_angle, up.axis_angle[last]) and np.shares_memory(root, up.root[last])
    steps = Steps(*np.zeros((2, 0)), *np.zeros((3, 0, 3)))
    assert not offset(steps, 5, np.ones(3), 3.0).any()
    clip = Clip(np.zeros((1, 52, 3)), np.zeros((1, 3)), 30.0)
    track = Track(clip, joints=joints, foot_lock=LOCK)
    assert np.array_equal(track.pose(0.0)[1], clip.root[0])
    flying = Clip(np.zeros((50, 52, 3)), np.cumsum(np.full((50, 3), 0.2), 0), 30.0)
    feet = HeldFeet(flying, joints, LOCK)
    assert not feet.held(0, flying.axis_angle, flying.root).changed.any()


def test_off_is_bit_identical_and_shares_of_a_film_are_the_film():
    entry = SceneAvatar("mannequin", "walking")
    plain, asked = (Stage(Scene((entry,), effects=replace(PLAIN, foot_lock=lock)), 1) for lock in (None, LOCK))
    raw = Track(plain.tracks[0].motion).pose
    changed = 0
    for frame in range(0, plain.frames, 5):
        (a, root, _), (b, same, _) = plain.poses(frame)[0], raw(frame / plain.rate)
        assert np.array_equal(a, b) and np.array_equal(root, same)
        changed += not np.array_equal(asked.poses(frame)[0][0], a)
    assert changed > 10
    # another machine begins in the middle
    other = Stage(asked.scene, 1)
    for frame in (200, 120, 121, 7):
        for one, two in zip(asked.poses(frame)[0][:2], other.poses(frame)[0][:2], strict=True):
            assert np.array_equal(one, two)
    identities = [Shot(stage.scene, 0, 9, (64, 64), 30.0, None).identity() for stage in (plain, asked)]
    assert identities[0] != identities[1], "parts of the one are no parts of the other"


def test_neighbours_are_solved_at_once_as_each_alone(joints, sliding, monkeypatch):
    feet, calls = HeldFeet(sliding, joints, LOCK), []
    frames = len(sliding.root)
    alone = [feet.held(k, sliding.axis_angle[k : k + 1], sliding.root[k : k + 1]) for k in range(frames)]
    monkeypatch.setattr("player.effects.held_feet.reach_for", lambda *given: calls.append(1) or reach_for(*given))
    together = held_poses(feet, sliding)
    assert len(calls) <= 2 * -(-frames // TOGETHER)
    for one, (axis_angle, root, _) in zip(alone, together, strict=True):
        np.testing.assert_allclose(axis_angle, one.axis_angle[0], rtol=0, atol=1e-12)
        np.testing.assert_allclose(root, one.root[0], rtol=0, atol=1e-12)
