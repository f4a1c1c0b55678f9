"""GLSL against the reference: posing of points and turning of directions."""

import numpy as np
import pytest
from glsl_probe import probe

from avatar.body import builtin_body
from avatar.rotation import matrix_from_axis_angle, quaternion_from_matrix
from avatar.skeleton import skin_transforms
from avatar.skinning import (
    SkinWeights,
    blended_rotations,
    dual_quaternion_from_transform,
    skin_points,
    skin_points_dual_quaternion,
)
from player.draw.posing import PosedBones, dual_parts

POINT = "vec4(skinned(point, joints, weights), 0.0)"
BACK = "vec4(turned_back(blended_turn(joints, weights), direction), 0.0)"


@pytest.fixture(scope="module")
def body():
    return builtin_body("male")


def upload(context, transforms):
    rows = context.gl.buffer(np.ascontiguousarray(transforms[:, :3], np.float32).tobytes())
    turns = context.gl.buffer(quaternion_from_matrix(transforms[:, :3, :3]).astype(np.float32).tobytes())
    rows.bind_to_uniform_block(1)
    turns.bind_to_uniform_block(2)
    return rows, turns


def heaviest_first(skin):
    order = np.argsort(-skin.weights, axis=1, kind="stable")
    return SkinWeights(np.take_along_axis(skin.joints, order, 1), np.take_along_axis(skin.weights, order, 1))


def random_transforms(body, seed, reach):
    rng = np.random.default_rng(seed)
    return skin_transforms(rng.normal(size=(52, 3)) * reach, body.joints, rng.normal(size=3))


@pytest.mark.parametrize("reach", [0.0, 0.3, 2.0])
def test_skinned_points_equal_the_reference(context, body, reach):
    transforms = random_transforms(body, 1, reach)
    buffers = upload(context, transforms)
    values = {"point": body.vertices, "joints": body.skin.joints, "weights": body.skin.weights}
    out = probe(context, ["skinning.glsl"], POINT, values, ints=("joints",), stage="vertex")[:, :3]
    assert np.abs(out - skin_points(body.vertices, body.skin, transforms)).max() < 3e-6  # metres
    for buffer in buffers:
        buffer.release()


@pytest.mark.parametrize("reach", [0.3, 2.0])
def test_directions_turn_back_as_the_reference_says(context, body, reach):
    transforms = random_transforms(body, 2, reach)
    buffers = upload(context, transforms)
    skin = heaviest_first(body.skin)
    d = np.random.default_rng(3).normal(size=(len(body.vertices), 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    values = {"direction": d, "joints": skin.joints, "weights": skin.weights}
    out = probe(context, ["directions.glsl"], BACK, values, ints=("joints",), stage="vertex")[:, :3]
    expected = np.einsum("nji,nj->ni", blended_rotations(skin, transforms), d)
    # where a bone stands at 90 degrees of the half sphere's rim to the heaviest, rounding decides its side
    agrees = np.abs(out - expected).max(1) < 1e-5
    assert agrees.mean() > 0.999
    assert np.abs(np.linalg.norm(out, axis=1) - 1).max() < 1e-6
    for buffer in buffers:
        buffer.release()


@pytest.mark.parametrize("angle", [0.0, 90.0, 135.0, 179.9, 180.0])
def test_directions_stay_unit_between_two_bones(context, angle):
    transforms = np.tile(np.eye(4), (52, 1, 1))
    transforms[1, :3, :3] = matrix_from_axis_angle(np.radians([angle, 0, 0]))
    buffers = upload(context, transforms)
    share = np.linspace(0, 1, 101)
    weights = np.stack([np.maximum(share, 1 - share), np.minimum(share, 1 - share), 0 * share, 0 * share], 1)
    joints = np.zeros((101, 4), int)
    joints[share < 0.5, 1] = 1
    joints[share >= 0.5, 0] = 1
    values = {"direction": np.tile([0.6, 0.0, 0.8], (101, 1)), "joints": joints, "weights": weights}
    out = probe(context, ["directions.glsl"], BACK, values, ints=("joints",), stage="vertex")[:, :3]
    assert np.abs(np.linalg.norm(out, axis=1) - 1).max() < 1e-6
    for buffer in buffers:
        buffer.release()


def upload_dual(context, transforms):
    bones = PosedBones(transforms, transforms[:, :3, 3], np.zeros(52))
    real = quaternion_from_matrix(transforms[:, :3, :3])
    expected = dual_quaternion_from_transform(transforms)[:, 1]
    dual = dual_parts(bones, real)
    assert np.abs(dual - expected).max() < 1e-14
    buffers = [context.gl.buffer(part.astype(np.float32).tobytes()) for part in (real, dual)]
    buffers[0].bind_to_uniform_block(2)
    buffers[1].bind_to_uniform_block(3)
    return buffers


@pytest.mark.parametrize("reach", [0.0, 0.3, 2.0])
def test_dual_quaternion_points_equal_the_reference(context, body, reach):
    transforms = random_transforms(body, 4, reach)
    buffers = upload_dual(context, transforms)
    skin = heaviest_first(body.skin)
    values = {"point": body.vertices, "joints": skin.joints, "weights": skin.weights}
    out = probe(context, ["skinning_dual.glsl"], POINT, values, ints=("joints",), stage="vertex")[:, :3]
    away = np.abs(out - skin_points_dual_quaternion(body.vertices, skin, transforms)).max(1)
    # where a bone stands at 90 degrees of the half sphere's rim to the heaviest, rounding decides its side
    assert (away < 5e-6).mean() > 0.999
    for buffer in buffers:
        buffer.release()


@pytest.mark.parametrize("angle", [0.0, 90.0, 135.0, 179.9])
def test_a_twisted_limb_keeps_its_radius_with_dual_quaternions_only(context, angle):
    """Two bones share a tube 5 cm thick half and half; the second is turned about the tube's axis, 10 cm along it."""
    transforms = np.tile(np.eye(4), (52, 1, 1))
    transforms[1, :3, :3] = matrix_from_axis_angle(np.radians([angle, 0, 0]))
    around = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    tube = np.stack([np.full(64, 0.1), 0.05 * np.cos(around), 0.05 * np.sin(around)], 1)
    values = {"point": tube, "joints": np.tile([0, 1, 0, 0], (64, 1)), "weights": np.tile([0.5, 0.5, 0, 0], (64, 1))}
    radii = []
    for include, upload_one in (("skinning_dual.glsl", upload_dual), ("skinning.glsl", upload)):
        buffers = upload_one(context, transforms)
        out = probe(context, [include], POINT, values, ints=("joints",), stage="vertex")[:, :3]
        radii.append(np.linalg.norm(out[:, 1:], axis=1))
        assert np.abs(out[:, 0] - 0.1).max() < 1e-6
        for buffer in buffers:
            buffer.release()
    assert np.abs(radii[0] - 0.05).max() < 1e-6
    assert np.abs(radii[1] - 0.05 * np.cos(np.radians(angle) / 2)).max() < 1e-6
