"""Twist joints: how far each turns, and where they stand."""

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.helper_joints import CARRIER
from avatar.rotation import axis_angle_from_quaternion, quaternion_from_axis_angle, quaternion_product
from avatar.skeleton import JOINTS, joint_transforms
from avatar.twist import SEGMENTS, TWIST_JOINTS, TwistJoints

REST = builtin_body("male").joints.astype(np.float64)
SIDES = ("left", "right")


def axis(segment):
    along = REST[segment.child] - REST[segment.joint]
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
