"""Limits of joints, whose angles name every rotation, and joints that help others to bend."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from avatar.bend import BEND_CARRIER, BEND_JOINTS, BENDS, BendJoints
from avatar.body import builtin_body
from avatar.helper_joints import BONES, CARRIER, HELPER_JOINTS, HelperJoints
from avatar.limits import (
    allowed,
    axis_angle_from_joint_angles,
    clamped,
    joint_angles,
    limits,
    posed,
    swing_excess,
    with_angle,
    within,
)
from avatar.motion.fingers import relaxed_hands
from avatar.motion.read import read_motion
from avatar.rotation import (
    axis_angle_from_quaternion,
    matrix_from_axis_angle,
    quaternion_from_axis_angle,
    quaternion_product,
)
from avatar.skeleton import JOINTS, PARENTS, joint_transforms
from avatar.twist import SEGMENTS, TWIST_JOINTS, TwistJoints
from player.pose.mirror import mirrored

FEW = settings(max_examples=12, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def any_pose(seed, scale=2.0):
    return np.random.default_rng(seed).normal(size=(52, 3)) * scale


def test_every_joint_has_three_named_angles_on_orthonormal_axes_with_zero_inside():
    table = limits()
    np.testing.assert_allclose(table.axes @ table.axes.swapaxes(1, 2), np.tile(np.eye(3), (52, 1, 1)), atol=1e-12)
    assert all(len(set(names)) == 3 for names in table.names) and len(table.names) == 52
    assert (table.low < 0).all() and (table.high > 0).all()
    # the widest corner of each swing's outline stays below half a turn, where swing and twist are unique
    t = np.linspace(0, 2 * np.pi, 721)
    direction = np.stack([np.cos(t), np.sin(t)], -1)
    bound = np.where(direction[:, None] < 0, -table.low[None, :, :2], table.high[None, :, :2])
    radius = np.sum((np.abs(direction[:, None]) / bound) ** 4, -1) ** -0.25
    assert radius[:, 1:].max() < np.pi


@FEW
@given(seeds, st.sampled_from([0.01, 1.0, 3.0]))
def test_the_angles_name_every_rotation(seed, scale):
    pose = any_pose(seed, scale)
    back = axis_angle_from_joint_angles(joint_angles(pose))
    np.testing.assert_allclose(matrix_from_axis_angle(back), matrix_from_axis_angle(pose), atol=1e-12)


def test_angles_of_half_turns_give_the_rotation_and_words_name_what_they_do_not_know():
    axes = limits().axes
    for angle in (np.pi - 1e-9, np.pi, np.pi + 1e-9):
        pose = axes[:, 0] * angle
        back = axis_angle_from_joint_angles(joint_angles(pose))
        np.testing.assert_allclose(matrix_from_axis_angle(back), matrix_from_axis_angle(pose), atol=1e-8)
    with pytest.raises(ValueError, match="no joint 'left_tail'"):
        posed({"left_tail": {"flexion": 1}})
    with pytest.raises(ValueError, match=r"left_knee has no 'raise'; it has flexion"):
        posed({"left_knee": {"raise": 1}})


@FEW
@given(seeds)
def test_angles_inside_are_read_back_as_they_were_written(seed):
    table = limits()
    rng = np.random.default_rng(seed)
    angles = rng.uniform(table.low, table.high)
    angles[:, :2] *= 0.8 / np.maximum(swing_excess(angles), 0.8)[:, None]
    angles[0] *= 0.5
    np.testing.assert_allclose(joint_angles(axis_angle_from_joint_angles(angles)), angles, atol=1e-12)


@FEW
@given(seeds, st.sampled_from([0.05, 0.5, 2.0]))
def test_clamping_brings_all_inside_and_leaves_what_is_inside_to_the_last_bit(seed, scale):
    pose = any_pose(seed, scale)
    inside = within(pose)
    out = clamped(pose)
    assert within(out).all()
    assert np.array_equal(out[inside], pose[inside])
    assert not (out[~inside] == pose[~inside]).all(-1).any()
    assert np.array_equal(clamped(out), out)
    # the swing keeps its direction
    a, b = joint_angles(pose), joint_angles(out)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    assert np.abs(cross).max() < 1e-9


@FEW
@given(seeds, seeds)
def test_clamping_is_continuous(seed, other):
    """A small step of the angles is a small step of the clamped ones, also across the boundary."""
    table = limits()
    rng = np.random.default_rng(seed)
    angles = rng.uniform(1.5 * table.low, 1.5 * table.high)
    angles[:, :2] *= np.minimum(1, 2.8 / np.linalg.norm(angles[:, :2], axis=1))[:, None]
    angles[:, 2] = np.clip(angles[:, 2], -3, 3)
    step = 1e-5 * np.random.default_rng(other).normal(size=(52, 3))
    a, b = (axis_angle_from_joint_angles(v) for v in (angles, angles + step))
    gap = matrix_from_axis_angle(clamped(a)) - matrix_from_axis_angle(clamped(b))
    assert np.abs(gap).max() < 1e-3


def test_limits_are_symmetric_and_the_ends_of_a_slider_on_the_outline():
    pose = any_pose(3, 0.4)
    angles, other = joint_angles(pose), joint_angles(mirrored(pose))
    for k, name in enumerate(JOINTS):
        if name.startswith("left"):
            partner = JOINTS.index("right" + name[4:])
            np.testing.assert_allclose(other[partner], angles[k], atol=1e-12)
    assert np.array_equal(within(pose)[1:3], within(mirrored(pose))[[2, 1]])
    k = JOINTS.index("left_shoulder")
    angles = np.zeros((52, 3))
    angles[k, 0] = np.radians(-80)
    low, high = allowed(k, angles[k])[1]
    for value in (low, high):
        angles[k, 1] = value
        assert swing_excess(angles)[k] == pytest.approx(1, abs=1e-9)
    assert np.degrees(high) < 135


@pytest.mark.parametrize(
    ("joint", "name", "end", "moves"),
    [
        ("left_elbow", "flexion", "left_wrist", (None, 0, 1)),  # forwards
        ("right_elbow", "flexion", "right_wrist", (None, 0, 1)),
        ("left_shoulder", "raise", "left_wrist", (None, 1, 0)),
        ("right_shoulder", "forwards", "right_wrist", (None, 0, 1)),
        ("left_hip", "flexion", "left_knee", (0, None, 1)),
        ("left_hip", "abduction", "left_ankle", (1, None, 0)),
        ("right_hip", "abduction", "right_ankle", (-1, None, 0)),
        ("right_knee", "flexion", "right_ankle", (0, None, -1)),  # backwards
        ("left_ankle", "toes up", "left_foot", (0, 1, None)),
        ("spine1", "bend forward", "head", (0, None, 1)),
        ("spine1", "bend to the left", "head", (1, None, 0)),
        ("left_wrist", "flexion", "left_middle1", (None, -1, 0)),  # towards the palm
        ("right_wrist", "towards the thumb", "right_middle1", (None, 0, 1)),
        ("left_collar", "raise", "left_shoulder", (None, 1, None)),
        ("left_index1", "curl", "left_index3", (None, -1, None)),
        ("right_index1", "towards the thumb's side", "right_index3", (None, None, 1)),
    ],
)
def test_a_positive_angle_moves_the_limb_where_its_name_says(joint, name, end, moves):
    joints = builtin_body("male").joints
    pose = posed({joint: {name: 20}})
    way = joint_transforms(pose, joints)[JOINTS.index(end), :3, 3] - joints[JOINTS.index(end)]
    assert np.linalg.norm(way) > 0.01
    for axis, sign in enumerate(moves):
        if sign == 0:
            assert abs(way[axis]) < 0.35 * np.abs(way).max()
        elif sign is not None:
            assert sign * way[axis] > 0.9 * np.abs(way).max() * (abs(sign) > 0) * 0.5


def test_hinges_are_hinges_and_motion_of_people_is_inside(data):
    table = limits()
    for joint, low, high in (("left_knee", -10, 150), ("right_elbow", -10, 150), ("left_index2", -10, 110)):
        k = JOINTS.index(joint)
        np.testing.assert_allclose(np.degrees([table.low[k, 0], table.high[k, 0]]), [low, high])
        assert np.degrees(table.high[k, 1]) <= 10
    for name in ("counting", "walking"):
        clip = read_motion(name).read()
        assert within(clip.axis_angle, 0.02).mean() > 0.999, name
    assert within(np.concatenate([np.zeros((22, 3)), relaxed_hands()])).all()
    # walks captured from people, retargeted: hips, knees and shoulders are inside almost always
    joints = [JOINTS.index(f"{s}_{p}") for s in ("left", "right") for p in ("hip", "knee", "shoulder")]
    for file in ("pybvh_cmu_12_01_walk", "fairmotion_cmu_01_01", "pymo_AV_8Walk_Meredith"):
        motion = read_motion(data / "bvh" / f"{file}.bvh")
        clip = motion.read(0, min(motion.frames, 400))
        assert within(clip.axis_angle, 0.02)[:, joints].mean() > 0.99, file


@FEW
@given(seeds, st.integers(1, 51), st.integers(0, 2), st.floats(-4, 4))
def test_a_slider_moves_one_angle_and_stays_inside(seed, joint, freedom, value):
    pose = clamped(any_pose(seed, 0.5))
    out = with_angle(pose, joint, freedom, value)
    assert within(out).all()
    assert np.array_equal(np.delete(out, joint, 0), np.delete(pose, joint, 0))
    before, after = joint_angles(pose)[joint], joint_angles(out)[joint]
    others = [k for k in range(3) if k != freedom]
    np.testing.assert_allclose(after[others], before[others], atol=1e-9)
    low, high = allowed(joint, before)[freedom]
    assert after[freedom] == pytest.approx(np.clip(value, low, high), abs=1e-9)
    unlimited = with_angle(pose, joint, freedom, 0.3 * value, limited=False)
    assert np.isfinite(unlimited).all()


REST = builtin_body("male").joints.astype(np.float64)
SIDES = ("left", "right")


def axis(bone):
    along = REST[bone.child] - REST[bone.joint]
    return along / np.linalg.norm(along)


def of(name, angles):
    """The angles of one segment's joints, in their order."""
    return angles[[k for k, joint in enumerate(TWIST_JOINTS) if joint.rstrip("0123456789") == f"{name}_twist"]]


def swing_across(direction, angle):
    across = np.cross(direction, [0.3, -0.5, 0.8])
    return quaternion_from_axis_angle(angle * across / np.linalg.norm(across))


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("degrees", [-179.9, -90.0, 0.0, 1e-6, 90.0, 179.9])
@pytest.mark.parametrize("swing", [0.0, 0.7, 2.0])
def test_a_twist_is_found_under_any_swing_and_shared_out_evenly(side, degrees, swing):
    """Wrist and shoulder: of the rotation swing x twist each joint turns by its share of the twist alone."""
    pose, angle = np.zeros((52, 3)), np.radians(degrees)
    forearm, upper = SEGMENTS[f"{side}_forearm"], SEGMENTS[f"{side}_upper_arm"]
    for segment, joint in ((forearm, forearm.child), (upper, upper.joint)):
        twist = quaternion_from_axis_angle(angle * axis(segment))
        pose[joint] = axis_angle_from_quaternion(quaternion_product(swing_across(axis(segment), swing), twist))
    angles = TwistJoints(REST).angles(pose)
    np.testing.assert_allclose(of(f"{side}_forearm", angles), np.linspace(0, angle, 13), atol=1e-9)
    # those of the upper arm undo it: the first keeps the shoulder's swing alone
    np.testing.assert_allclose(of(f"{side}_upper_arm", angles), -angle * (1 - np.arange(4) / 4), atol=1e-9)


def test_a_swing_alone_turns_no_twist_joint_and_twists_move_without_a_jump_up_to_half_a_turn():
    pose = np.zeros((52, 3))
    for segment in SEGMENTS.values():
        pose[segment.joint] = axis_angle_from_quaternion(swing_across(axis(segment), 1.3))
    others = CARRIER[52 : 52 + len(TWIST_JOINTS)] != JOINTS.index("left_elbow")
    assert np.abs(TwistJoints(REST).angles(pose)[others]).max() < 1e-9
    segment, degrees = SEGMENTS["left_forearm"], np.arange(-179.5, 180, 0.5)
    poses = np.zeros((len(degrees), 52, 3))
    poses[:, segment.child] = np.radians(degrees)[:, None] * axis(segment)
    angles = TwistJoints(REST).angles(poses)
    assert np.abs(np.diff(angles, axis=0)).max() < np.radians(0.5) + 1e-9


def test_twist_joints_stand_on_their_bone_and_the_last_of_a_forearm_turns_with_the_wrist():
    pose = np.random.default_rng(1).normal(size=(52, 3)) * 0.4
    segment = SEGMENTS["right_forearm"]
    pose[segment.child] = 2.5 * axis(segment)
    G = joint_transforms(pose, REST)
    bones = np.concatenate([G, TwistJoints(REST).transforms(pose, G)])
    assert bones.shape == (52 + len(TWIST_JOINTS), 4, 4)
    for k, name in enumerate(TWIST_JOINTS):
        segment = SEGMENTS[name.rsplit("_", 1)[0]]
        assert CARRIER[52 + k] == segment.joint
        ends = G[[segment.joint, segment.child], :3, 3]
        share = segment.shares[int(name.rsplit("twist", 1)[1])]
        np.testing.assert_allclose(bones[52 + k, :3, 3], ends[0] + share * (ends[1] - ends[0]), atol=1e-12)
    last = 52 + TWIST_JOINTS.index("right_forearm_twist12")
    np.testing.assert_allclose(bones[last, :3, :3], G[JOINTS.index("right_wrist"), :3, :3], atol=1e-12)


def test_bones_without_length_and_half_turns_are_finite_and_not_twisted():
    joints = REST.copy()
    joints[JOINTS.index("left_wrist")] = joints[JOINTS.index("left_elbow")]
    angles = TwistJoints(joints).axis_angle(np.ones((52, 3)))
    assert np.isfinite(angles).all() and (angles[:13] == 0).all()
    pose = np.zeros((52, 3))
    for bend in BENDS.values():
        pose[bend.joint] = np.pi * np.cross(axis(bend), [0.3, 0.5, 0.8])
    for values in BendJoints(joints, PUSH).local(pose):
        assert np.isfinite(values).all()


PUSH = np.array([0.02, 0.03, 0.04, 0.025, 0.035, 0.045])


def swung(bend, direction, degrees):
    """A pose whose joint swings its bone towards a direction."""
    across = np.cross(axis(bend), direction)
    pose = np.zeros((52, 3))
    pose[bend.joint] = np.radians(degrees) * across / np.linalg.norm(across)
    return pose


@pytest.mark.parametrize("name", BENDS)
@pytest.mark.parametrize("degrees", [1e-6, 45.0, 90.0, 150.0])
def test_a_bend_joint_turns_by_half_the_swing_and_stands_outside_of_the_bend(name, degrees):
    bend, push = BENDS[name], PUSH[list(BENDS).index(name)]
    pose = swung(bend, (0.1, -1.0, -0.3), degrees)
    G = joint_transforms(pose, REST)
    found = BendJoints(REST, PUSH).transforms(pose, G)
    assert found.shape == (len(BEND_JOINTS), 4, 4)
    parent, e = G[PARENTS[bend.joint]], axis(bend)
    turned = matrix_from_axis_angle(pose[bend.joint]) @ e
    expected = G[bend.joint, :3, 3] + parent[:3, :3] @ (push * (e - turned))
    for k, joint in enumerate(BEND_JOINTS):
        if joint.rsplit("_", 1)[0] == name:
            np.testing.assert_allclose(found[k, :3, 3], expected, atol=1e-12)
            half = parent[:3, :3] @ matrix_from_axis_angle(pose[bend.joint] / 2)
            np.testing.assert_allclose(found[k, :3, :3], half, atol=1e-9)


def test_both_of_a_hinge_stand_in_one_place_in_any_pose_and_a_turn_about_the_bone_bends_nothing():
    pose = np.random.default_rng(0).normal(size=(52, 3))
    found = BendJoints(REST, PUSH).transforms(pose, joint_transforms(pose, REST))
    for name, bend in BENDS.items():
        if bend.both:
            first, second = (BEND_JOINTS.index(f"{name}_bend{k}") for k in (0, 1))
            np.testing.assert_allclose(found[first], found[second], atol=1e-12)
            assert BEND_CARRIER[first] == PARENTS[bend.joint] and BEND_CARRIER[second] == bend.joint
    joints = BendJoints(REST, PUSH)
    pose = np.zeros((52, 3))
    for bend in BENDS.values():
        pose[bend.joint] = 1.1 * axis(bend)
    turns, places = joints.local(pose)
    for k, name in enumerate(BEND_JOINTS):
        own = name.endswith("1")
        expected = -pose[BEND_CARRIER[k]] if own else np.zeros(3)
        np.testing.assert_allclose(axis_angle_from_quaternion(turns[k]), expected, atol=1e-9)
    np.testing.assert_allclose(places, joints.offsets, atol=1e-12)


def test_a_raised_arm_is_not_pushed_and_a_lowered_one_is():
    joints, k = BendJoints(REST, PUSH), BEND_JOINTS.index("left_shoulder_bend1")
    pushed = {}
    for up in (-1.0, 1.0):
        pose = np.zeros((52, 3))
        bend = BENDS["left_shoulder"]
        # until the bone points straight up or down
        level = np.arcsin(axis(bend)[1])
        pose[bend.joint] = swung(bend, (0, up, 0), 90 - up * np.degrees(level))[bend.joint]
        pushed[up] = np.linalg.norm(joints.local(pose)[1][k])
    assert pushed[1.0] < 1e-9 and pushed[-1.0] > PUSH[2]


def test_helper_joints_of_a_block_of_frames_are_those_of_each_and_files_without_push_have_none_that_bend():
    poses = np.random.default_rng(1).normal(size=(3, 52, 3))
    helpers = HelperJoints(REST, PUSH)
    turns, places = helpers.local(poses)
    for k, pose in enumerate(poses):
        G = joint_transforms(pose, REST)
        bones = helpers.with_helpers(pose, G)
        assert len(bones) == BONES and helpers.names == HELPER_JOINTS
        local = np.tile(np.eye(4), (len(HELPER_JOINTS), 1, 1))
        local[:, :3, :3], local[:, :3, 3] = matrix_from_axis_angle(turns[k]), places[k]
        np.testing.assert_allclose(G[CARRIER[52:]] @ local, bones[52:], atol=1e-9)
        np.testing.assert_array_equal(HelperJoints(REST, None).with_helpers(pose, G), bones[: -len(BEND_JOINTS)])
    assert np.allclose(np.linalg.norm(quaternion_from_axis_angle(turns), axis=-1), 1)
