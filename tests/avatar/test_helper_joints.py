"""Twist and bend joints: how far each turns, and where they stand."""

import numpy as np
import pytest

from avatar.bend import BEND_CARRIER, BEND_JOINTS, BENDS, BendJoints
from avatar.body import builtin_body
from avatar.helper_joints import BONES, CARRIER, HELPER_JOINTS, HelperJoints
from avatar.rotation import (
    axis_angle_from_quaternion,
    matrix_from_axis_angle,
    quaternion_from_axis_angle,
    quaternion_product,
)
from avatar.skeleton import JOINTS, PARENTS, joint_transforms
from avatar.twist import SEGMENTS, TWIST_JOINTS, TwistJoints

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


def test_a_swing_alone_turns_no_twist_joint():
    pose = np.zeros((52, 3))
    for segment in SEGMENTS.values():
        pose[segment.joint] = axis_angle_from_quaternion(swing_across(axis(segment), 1.3))
    others = CARRIER[52 : 52 + len(TWIST_JOINTS)] != JOINTS.index("left_elbow")
    assert np.abs(TwistJoints(REST).angles(pose)[others]).max() < 1e-9


def test_twists_move_without_a_jump_up_to_half_a_turn():
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


def test_a_bone_without_length_is_not_twisted():
    joints = REST.copy()
    joints[JOINTS.index("left_wrist")] = joints[JOINTS.index("left_elbow")]
    angles = TwistJoints(joints).axis_angle(np.ones((52, 3)))
    assert np.isfinite(angles).all() and (angles[:13] == 0).all()


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


def test_both_of_a_hinge_stand_in_the_same_place_in_any_pose():
    pose = np.random.default_rng(0).normal(size=(52, 3))
    found = BendJoints(REST, PUSH).transforms(pose, joint_transforms(pose, REST))
    for name, bend in BENDS.items():
        if bend.both:
            first, second = (BEND_JOINTS.index(f"{name}_bend{k}") for k in (0, 1))
            np.testing.assert_allclose(found[first], found[second], atol=1e-12)
            assert BEND_CARRIER[first] == PARENTS[bend.joint] and BEND_CARRIER[second] == bend.joint


def test_a_turn_about_the_bone_bends_nothing():
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


def test_half_turns_and_bones_without_length_are_finite():
    joints = REST.copy()
    joints[JOINTS.index("left_wrist")] = joints[JOINTS.index("left_elbow")]
    pose = np.zeros((52, 3))
    for bend in BENDS.values():
        pose[bend.joint] = np.pi * np.cross(axis(bend), [0.3, 0.5, 0.8])
    for values in BendJoints(joints, PUSH).local(pose):
        assert np.isfinite(values).all()


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
