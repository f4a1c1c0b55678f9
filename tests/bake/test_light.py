"""The light that a baked avatar's base colour shows, and where its lamps stand."""

from types import SimpleNamespace

import numpy as np
import torch

from avatar.light import CaptureLight, lamps_of
from bake.bake import avatar_light
from bake.field import numpy_field
from bake.level import Charted, light_at
from train.fused import CanonicalField

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
