"""The player's quick kinematics against the plain ones of avatar/."""

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.camera import orbit_camera, view_from_world
from avatar.rotation import matrix_from_axis_angle, quaternion_from_matrix
from avatar.skeleton import joint_transforms
from player.draw import kinematics
from player.draw.posing import Poser, quaternions, screen_bounds

# zero, denormal, both sides of the series' branch, both sides of a half turn, full turns
ANGLES = [0.0, 1e-300, 1e-30, 1e-8, 0.0099, 0.0101, 1.0, np.pi - 1e-9, np.pi, np.pi + 1e-9, 2 * np.pi, 1e3]


def turned(angle, seed=0):
    axes = np.random.default_rng(seed).normal(size=(52, 3))
    return angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", ANGLES)
def test_rotations_equal_the_plain_ones(angle):
    v = turned(angle)
    v[::7] = 0
    np.testing.assert_allclose(kinematics.rotations(v), matrix_from_axis_angle(v), rtol=0, atol=2e-15 * max(1, angle))


@pytest.mark.parametrize("angle", ANGLES)
def test_quaternions_equal_the_plain_ones(angle):
    R = matrix_from_axis_angle(turned(angle))
    ours, plain = kinematics.quaternions(R), quaternion_from_matrix(R)
    same = np.abs(np.einsum("ij,ij->i", ours, plain))  # at a half turn q and -q are equally right
    np.testing.assert_allclose(same, 1, rtol=0, atol=4e-16)
    assert (ours[:, 3] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(ours, axis=1), 1, rtol=0, atol=4e-16)


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0, np.pi])
def test_the_chain_equals_the_plain_kinematics_seen_from_a_camera(angle, within):
    joints = builtin_body("female").joints.astype(float)
    pose, root = turned(angle), np.array([0.3, -0.7, 12.0])
    outer = view_from_world(orbit_camera((0, 0, 0), 3.0, 0.4, 0.2, (64, 64)))
    found = kinematics.Chain(joints).transforms(pose, root, outer)
    within(found - outer @ joint_transforms(pose, joints, root), 1e-13)


def test_posed_bones_and_their_quaternions_are_those_of_the_plain_product(avatar):
    camera, pose, root = orbit_camera((0, 0, 0), 3.0, 0.4, 0.2, (64, 64)), turned(0.4, 2), np.ones(3)
    bones = Poser(avatar, avatar.levels[0]).posed(pose, root, camera)
    joint_from_canonical = np.linalg.inv(joint_transforms(avatar.canonical_pose, avatar.joint_positions))
    plain = view_from_world(camera) @ joint_transforms(pose, avatar.joint_positions, root) @ joint_from_canonical
    np.testing.assert_allclose(bones.view_from_canonical, plain, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.abs(quaternions(bones)), np.abs(quaternion_from_matrix(plain[:, :3, :3])), atol=1e-12)


def test_the_reach_of_a_sphere_is_its_silhouette_or_a_little_more(avatar):
    """One bone left: the box holds the sphere's outline and is at most a tenth wider."""
    camera = orbit_camera((0, 0, 0), 3.0, 0.0, 0.0, (400, 300))
    bones = Poser(avatar, avatar.levels[0]).posed(np.zeros((52, 3)), np.array([0.4, -0.2, 0.1]), camera)
    one = bones._replace(radii=np.where(np.arange(52) == 15, 0.15, -1.0))
    x, y, z = one.centers[15] * (1, -1, -1)
    box = screen_bounds(one, camera).box
    for k, (offset, side) in enumerate(((x, 0), (y, 1))):
        middle, half = np.arctan2(offset, z), np.arcsin(0.15 / np.hypot(offset, z))
        true = camera.K[side, side] * np.tan([middle - half, middle + half]) + camera.K[side, 2]
        low, high = box[[k, k + 2]]
        wide = true[1] - true[0]
        assert true[0] - 0.1 * wide < low <= true[0] and true[1] <= high < true[1] + 0.1 * wide
