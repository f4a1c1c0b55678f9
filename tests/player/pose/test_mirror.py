"""The mirror: twice is nothing, and the posed joints are where a mirror shows them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from avatar.body import builtin_body
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS, PARENTS, joint_transforms
from player.pose.mirror import PARTNER, mirrored, mirrored_in_place, onto_other_side

SOME = settings(max_examples=15, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def any_pose(seed):
    return np.random.default_rng(seed).normal(size=(52, 3)) * 0.6


def symmetric_joints():
    joints = builtin_body("male").joints.astype(float)
    return 0.5 * (joints + joints[PARTNER] * [-1, 1, 1])


def test_partners_are_pairs_and_the_skeleton_is_its_own_mirror_image():
    assert np.array_equal(PARTNER[PARTNER], np.arange(52))
    assert sum(np.arange(52) == PARTNER) == 6  # pelvis, three of the spine, neck, head
    assert JOINTS[PARTNER[JOINTS.index("left_ring2")]] == "right_ring2"
    assert np.array_equal(PARTNER[PARENTS[1:]], PARENTS[PARTNER[1:]])


@SOME
@given(seeds)
def test_mirroring_twice_is_nothing_to_the_last_bit(seed):
    pose = any_pose(seed)
    assert np.array_equal(mirrored(mirrored(pose)), pose)
    batch = np.stack([pose, -pose])
    assert np.array_equal(mirrored(batch)[1], mirrored(-pose))


@SOME
@given(seeds)
def test_the_posed_joints_are_the_mirror_image(seed):
    pose, joints = any_pose(seed), symmetric_joints()
    root = np.random.default_rng(seed + 1).normal(size=3)
    one = joint_transforms(pose, joints, root)[:, :3, 3]
    other = joint_transforms(mirrored(pose), joints, root * [-1, 1, 1])[:, :3, 3]
    np.testing.assert_allclose(other, one[PARTNER] * [-1, 1, 1], atol=1e-12)


@SOME
@given(seeds)
def test_in_place_the_heading_and_the_height_of_every_joint_stay(seed):
    pose, joints = any_pose(seed), symmetric_joints()
    out = mirrored_in_place(pose)
    back = mirrored_in_place(out)
    np.testing.assert_allclose(matrix_from_axis_angle(back), matrix_from_axis_angle(pose), atol=1e-10)
    a, b = (matrix_from_axis_angle(p[0])[:, 2] for p in (pose, out))
    np.testing.assert_allclose(np.arctan2(a[0], a[2]), np.arctan2(b[0], b[2]), atol=1e-9)
    one, other = (joint_transforms(p, joints)[:, :3, 3] for p in (pose, out))
    np.testing.assert_allclose(other[PARTNER, 1], one[:, 1], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(other[PARTNER], axis=1), np.linalg.norm(one, axis=1), atol=1e-9)


def test_a_body_that_looks_straight_up_is_mirrored_too():
    pose = any_pose(1)
    pose[0] = [-np.pi / 2, 0, 0]
    assert np.array_equal(mirrored_in_place(pose), mirrored(pose))


def test_one_side_is_put_onto_the_other():
    pose = any_pose(2)
    arm = [JOINTS.index(f"left_{p}") for p in ("shoulder", "elbow", "wrist")]
    out = onto_other_side(pose, arm)
    assert np.array_equal(out[PARTNER[arm]], pose[arm] * [1, -1, -1])
    rest = np.setdiff1d(np.arange(52), PARTNER[arm])
    assert np.array_equal(out[rest], pose[rest])
