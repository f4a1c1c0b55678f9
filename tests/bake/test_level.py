"""What eyes, lamps, cones and the field's light come to in a level of a bake."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from capsules import ball_mesh

from avatar.light import CaptureLight, lamps_of
from bake.atlas import unwrap
from bake.bake import avatar_light
from bake.cone import FLOOR, REACH, clamped_tangent, matrix_from_six, six_from_matrix, tangent_frame, view_cone
from bake.field import numpy_field
from bake.level import Charted, enlargements, light_at, magnifiers
from bake.options import BakeOptions
from geometry.decimate import Magnifier, magnified
from geometry.isosurface import Detail
from train.fused import CanonicalField

EYE = Detail(np.array([-0.015, -0.01, 0.085]), np.array([0.015, 0.01, 0.105]), 0.001)


def test_a_field_s_details_are_magnified_before_head_and_hands():
    options = BakeOptions()
    joints = np.random.default_rng(0).normal(size=(52, 3))
    plain, eyed = enlargements(joints, options), enlargements(joints, options, (EYE,))
    assert len(eyed) == len(plain) + 1 and len(plain) == 3
    first = eyed[0]
    assert isinstance(first, Magnifier) and first.scale == options.eye_scale > 1
    np.testing.assert_allclose(first.centre, [0, 0, 0.095])
    assert first.radius == 0.015
    assert magnifiers((EYE,), replace(options, eye_scale=3.0))[0].scale == 3.0


@pytest.mark.slow
def test_magnified_charts_have_finer_texels_at_the_eye_alone():
    mesh = ball_mesh(step=0.006)
    part = np.zeros(len(mesh.faces), np.int64)
    middle = mesh.vertices[mesh.faces].mean(1)
    near = np.linalg.norm(middle - 0.5 * (EYE.low + EYE.high), axis=1) < 0.015
    far = middle[:, 2] < 0

    def texels(vertices):
        """Of each part of the surface, per square metre."""
        chart = unwrap(vertices, mesh.faces, part, np.ones(1), size=256, padding=2)
        a, b, c = (256 * chart.uv[chart.faces[:, i]] for i in range(3))
        covered = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        return covered[near].sum() / near.sum(), covered[far].sum() / far.sum()

    (eye, back), (fine, behind) = (
        texels(mesh.vertices),
        texels(magnified(mesh.vertices, magnifiers((EYE,), BakeOptions()))),
    )
    assert fine / behind > 3 * eye / back


# a plane whose mean shading grows upwards
UNLIT = CanonicalField(
    distance=lambda points: points[:, 1],
    normal=lambda points: torch.tensor([0.0, 1.0, 0.0]).expand(len(points), 3),
    color=lambda points, directions: 0.5 + 0 * points,
)
FIELD = replace(
    UNLIT,
    light_normal=lambda points: torch.tensor([0.6, 0.8, 0.0]).expand(len(points), 3),
    seen_light=lambda points, normals: torch.stack([1 + 0.1 * normals[:, 1], 0.01 * points[:, 0]], 1),
)


def charted() -> Charted:
    points, up = np.random.default_rng(0).uniform(0, 1, (5, 3)), np.tile([0.0, 1.0, 0.0], (5, 1))
    cone = SimpleNamespace()
    return Charted(np.zeros((5, 2)), np.array([[0, 1, 2]]), points, up, cone)  # type: ignore[arg-type]


def test_light_falls_on_the_normals_of_its_place_and_on_the_own_ones_of_a_cut():
    normals, found = light_at(numpy_field(FIELD), charted())
    assert found is not None
    assert found.dtype == np.float32
    np.testing.assert_allclose(normals, np.tile([0.6, 0.8, 0.0], (5, 1)), rtol=1e-6)
    np.testing.assert_allclose(found, np.stack([np.full(5, 1.08), 0.01 * charted().points[:, 0]], 1), rtol=1e-6)
    # The field goes on behind the cut; its normals there are another surface's.
    cut = charted()._replace(normals=np.tile([0.0, 0.0, 1.0], (5, 1)))
    normals, found = light_at(numpy_field(FIELD), cut)
    np.testing.assert_array_equal(normals, cut.normals)
    assert found is not None
    np.testing.assert_allclose(found[:, 0], 1.0, rtol=1e-6)
    normals, found = light_at(numpy_field(UNLIT), charted())
    assert found is None
    np.testing.assert_array_equal(normals, charted().normals)
    assert avatar_light(None, {}) is None


def test_the_avatars_lamps_lie_where_the_camera_stands_before_it():
    light = CaptureLight(0.5, lamps_of(np.array([[1.0, 0.0, 0.0]]), np.array([0.4])), frame="world")
    # the camera stood at +x: its lamp, straight behind it, comes to stand at +z
    turned = avatar_light(light, {"light_camera": [1.0, 0.0, 0.0]})
    assert turned is not None
    np.testing.assert_allclose(turned.directions, [[0.0, 0.0, 1.0]], atol=1e-12)
    straight = avatar_light(light, {"light_camera": [0.0, 0.08, 1.0]})
    assert straight is not None
    np.testing.assert_allclose(straight.directions, [[1.0, 0.0, 0.0]], atol=1e-12)


@pytest.fixture(scope="module")
def ball():
    return ball_mesh(step=0.02)


def seen_ball(ball, count=100.0, spread=0.04):
    normals = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    axes = np.stack(tangent_frame(-normals), 1)
    covariance = spread * np.einsum("nki,nkj->nij", axes, axes)
    return np.full(len(normals), count), -0.9 * normals, six_from_matrix(covariance), normals, ball.faces


def test_metric_is_the_inverse_of_the_widened_covariance_in_the_tangent_plane(ball):
    cone = view_cone(*seen_ball(ball))
    first, _ = tangent_frame(cone.direction)
    matrix = matrix_from_six(cone.metric)
    expected = 1 / (REACH**2 * (0.04 + FLOOR**2))
    np.testing.assert_allclose(np.einsum("ni,nij,nj->n", first, matrix, first), expected, rtol=1e-9)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", matrix, cone.direction), 0, atol=1e-9)
    np.testing.assert_array_equal(cone.seen, 1.0)


@pytest.mark.parametrize("degrees, reached", [(10, 10), (20, 18), (40, 32)])
def test_directions_as_far_out_as_the_data_are_bent_as_designed(degrees, reached):
    s2 = np.array([[np.sin(np.radians(degrees)) ** 2 / 1.0, 0, 0, 0, 0, 0]])
    cone = view_cone(np.array([100.0]), np.array([[0, 0, 1.0]]), s2, np.array([[0, 0, -1.0]]), np.array([[0, 0, 0]]))
    direction = np.array([[np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))]])
    angle = np.degrees(np.arcsin(np.linalg.norm(clamped_tangent(direction, cone))))
    assert angle <= degrees and angle == pytest.approx(reached, abs=0.2 * degrees)


def test_visibility_rises_with_the_count(ball):
    count, *rest = seen_ball(ball)
    count = np.resize([0.0, 5.0, 12.5, 20.0, 1e6], len(count))
    seen = view_cone(count, *rest).seen
    np.testing.assert_allclose(seen[:5], [0, 0, 0.5, 1, 1])
