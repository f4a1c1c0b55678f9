"""What eyes, lamps and the field's light come to in a level of a bake."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import torch
from capsules import ball_mesh

from avatar.light import CaptureLight, lamps_of
from bake.atlas import unwrap
from bake.bake import avatar_light
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
FIELD = UNLIT._replace(
    light_normal=lambda points: torch.tensor([0.6, 0.8, 0.0]).expand(len(points), 3),
    seen_light=lambda points, normals: torch.stack([1 + 0.1 * normals[:, 1], 0.01 * points[:, 0]], 1),
)


def charted() -> Charted:
    points, up = np.random.default_rng(0).uniform(0, 1, (5, 3)), np.tile([0.0, 1.0, 0.0], (5, 1))
    cone = SimpleNamespace()
    return Charted(np.zeros((5, 2)), np.array([[0, 1, 2]]), points, up, cone)  # type: ignore[arg-type]


def test_each_vertex_holds_the_light_of_its_place_and_normal():
    normals, found = light_at(numpy_field(FIELD), charted())
    assert found is not None
    assert found.dtype == np.float32
    np.testing.assert_allclose(normals, np.tile([0.6, 0.8, 0.0], (5, 1)), rtol=1e-6)
    np.testing.assert_allclose(found, np.stack([np.full(5, 1.08), 0.01 * charted().points[:, 0]], 1), rtol=1e-6)


def test_where_a_surface_was_cut_light_falls_on_its_own_normals():
    """The field goes on behind the cut; its normals there are another surface's."""
    cut = charted()._replace(normals=np.tile([0.0, 0.0, 1.0], (5, 1)))
    normals, found = light_at(numpy_field(FIELD), cut)
    np.testing.assert_array_equal(normals, cut.normals)
    assert found is not None
    np.testing.assert_allclose(found[:, 0], 1.0, rtol=1e-6)


def test_a_field_whose_light_is_no_factor_has_none():
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
