"""Bend joints: where they stand and how they turn."""

import numpy as np
import pytest

from avatar.bend import BEND_CARRIER, BEND_JOINTS, BENDS, BendJoints
from avatar.body import builtin_body
from avatar.helper_joints import BONES, CARRIER, HELPER_JOINTS, HelperJoints
from avatar.rotation import axis_angle_from_quaternion, matrix_from_axis_angle, quaternion_from_axis_angle
from avatar.skeleton import JOINTS, PARENTS, joint_transforms

REST = builtin_body("male").joints.astype(np.float64)
PUSH = np.array([0.02, 0.03, 0.04, 0.025, 0.035, 0.045])


def axis(bend):
    along = REST[bend.child] - REST[bend.joint]
    return along / np.linalg.norm(along)


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
