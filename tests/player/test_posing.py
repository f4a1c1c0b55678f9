"""The player's quick kinematics, and posing in GLSL, against the plain ones of avatar/."""

import numpy as np
import pytest
from dual_quaternions import dual_quaternion_from_transform, skin_points_dual_quaternion
from glsl_probe import probe

from avatar.body import builtin_body
from avatar.camera import orbit_camera, view_from_world
from avatar.rotation import matrix_from_axis_angle, quaternion_from_matrix
from avatar.skeleton import joint_transforms, skin_transforms
from avatar.skinning import SkinWeights, blended_rotations, skin_points
from player.draw.posing import PosedBones, Poser, dual_parts, quaternions, screen_bounds

# zero, denormal, both sides of the series' branch, both sides of a half turn, full turns
ANGLES = [0.0, 1e-300, 1e-30, 1e-8, 0.0099, 0.0101, 1.0, np.pi - 1e-9, np.pi, np.pi + 1e-9, 2 * np.pi, 1e3]


def turned(angle):
    axes = np.random.default_rng(2).normal(size=(52, 3))
    return angle * axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", ANGLES)
def test_posed_bones_are_the_plain_product(avatar, angle):
    camera, pose, root = orbit_camera((0, 0, 0), 3.0, 0.4, 0.2, (64, 64)), turned(angle), np.array([0.3, -0.7, 12.0])
    pose[::7] = 0
    bones = Poser(avatar, avatar.levels[0]).posed(pose, root, camera)
    joint_from_canonical = np.linalg.inv(joint_transforms(avatar.canonical_pose, avatar.joint_positions))
    plain = view_from_world(camera) @ joint_transforms(pose, avatar.joint_positions, root) @ joint_from_canonical
    np.testing.assert_allclose(bones.view_from_canonical, plain, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.abs(quaternions(bones)), np.abs(quaternion_from_matrix(plain[:, :3, :3])), atol=1e-12)


def test_the_reach_of_a_sphere_is_its_silhouette(avatar):
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


POINT = "vec4(skinned(point, joints, weights), 0.0)"
BACK = "vec4(turned_back(blended_turn(joints, weights), direction), 0.0)"


@pytest.fixture(scope="module")
def body():
    return builtin_body("male")


def blocks(transforms):
    """Uniform blocks of bones: rows of their transforms, and real and dual parts of their quaternions."""
    real = quaternion_from_matrix(transforms[:, :3, :3])
    dual = dual_parts(PosedBones(transforms, transforms[:, :3, 3], np.zeros(52)), real)
    assert np.abs(dual - dual_quaternion_from_transform(transforms)[:, 1]).max() < 1e-14
    parts = {"Bones": transforms[:, :3], "Turns": real, "Duals": dual}
    return {name: part.astype(np.float32) for name, part in parts.items()}


def heaviest_first(skin):
    order = np.argsort(-skin.weights, axis=1, kind="stable")
    return SkinWeights(np.take_along_axis(skin.joints, order, 1), np.take_along_axis(skin.weights, order, 1))


def random_transforms(body, seed, reach):
    rng = np.random.default_rng(seed)
    return skin_transforms(rng.normal(size=(52, 3)) * reach, body.joints, rng.normal(size=3))


def asked(context, include, expression, transforms, skin, **values):
    values |= {"joints": skin.joints, "weights": skin.weights}
    found = probe(context, [include], expression, values, blocks=blocks(transforms), ints=("joints",), stage="vertex")
    return found[:, :3]


@pytest.mark.parametrize("reach", [0.0, 0.3, 2.0])
def test_skinned_points_equal_the_reference(context, body, reach):
    transforms = random_transforms(body, 1, reach)
    out = asked(context, "skinning.glsl", POINT, transforms, body.skin, point=body.vertices)
    assert np.abs(out - skin_points(body.vertices, body.skin, transforms)).max() < 3e-6  # metres
    skin = heaviest_first(body.skin)
    out = asked(context, "skinning_dual.glsl", POINT, transforms, skin, point=body.vertices)
    away = np.abs(out - skin_points_dual_quaternion(body.vertices, skin, transforms)).max(1)
    # where a bone stands at 90 degrees of the half sphere's rim to the heaviest, rounding decides its side
    assert (away < 5e-6).mean() > 0.999


@pytest.mark.parametrize("reach", [0.3, 2.0])
def test_directions_turn_back_as_the_reference_says(context, body, reach):
    transforms, skin = random_transforms(body, 2, reach), heaviest_first(body.skin)
    d = np.random.default_rng(3).normal(size=(len(body.vertices), 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    out = asked(context, "directions.glsl", BACK, transforms, skin, direction=d)
    expected = np.einsum("nji,nj->ni", blended_rotations(skin, transforms), d)
    # as above
    agrees = np.abs(out - expected).max(1) < 1e-5
    assert agrees.mean() > 0.999
    assert np.abs(np.linalg.norm(out, axis=1) - 1).max() < 1e-6


@pytest.mark.parametrize("angle", [0.0, 90.0, 135.0, 179.9, 180.0])
def test_directions_stay_unit_between_two_bones(context, angle):
    transforms = np.tile(np.eye(4), (52, 1, 1))
    transforms[1, :3, :3] = matrix_from_axis_angle(np.radians([angle, 0, 0]))
    share = np.linspace(0, 1, 101)
    weights = np.stack([np.maximum(share, 1 - share), np.minimum(share, 1 - share), 0 * share, 0 * share], 1)
    joints = np.zeros((101, 4), int)
    joints[share < 0.5, 1] = 1
    joints[share >= 0.5, 0] = 1
    direction = np.tile([0.6, 0.0, 0.8], (101, 1))
    out = asked(context, "directions.glsl", BACK, transforms, SkinWeights(joints, weights), direction=direction)
    assert np.abs(np.linalg.norm(out, axis=1) - 1).max() < 1e-6
