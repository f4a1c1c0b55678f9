"""The NumPy z-buffer against rays through the same pixels."""

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.camera import Camera, look_at, orbit_camera, pinhole, pixel_rays
from geometry.rasterise import rasterise

SQUARE = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def _first_hits(vertices, faces, camera):
    """Depth of the nearest triangle by Moeller and Trumbore's intersection, pixel by pixel."""
    origins, directions = pixel_rays(camera)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    n = np.cross(b - a, c - a)
    nearest = np.full(len(origins), np.inf)
    along = directions @ camera.camera_from_world[2, :3]
    for f in range(len(faces)):
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((a[f] - origins) @ n[f]) / (directions @ n[f])
            p = origins + t[:, None] * directions
            sides = [
                np.einsum("ij,j->i", np.cross(q - r, p - r), n[f])
                for r, q in ((a[f], b[f]), (b[f], c[f]), (c[f], a[f]))
            ]
            inside = np.logical_and.reduce([side >= -1e-12 for side in sides]) & (t > 0)
            nearest = np.where(inside & (t * along < nearest), t * along, nearest)
    return nearest.reshape(camera.size[::-1])


@pytest.mark.parametrize("seed", range(4))
def test_depth_is_that_of_the_first_triangle_each_ray_meets(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = rng.normal(0, 0.7, (30, 3)), rng.integers(0, 30, (25, 3))
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 0] != faces[:, 2])]
    camera = Camera(pinhole((40, 31), 0.9), look_at([0.5, 1, 5], [0, 0, 0]), (40, 31))
    drawn, expected = rasterise(vertices, faces, camera), _first_hits(vertices, faces, camera)
    assert ((drawn.face >= 0) == np.isfinite(expected)).all()
    assert (np.isfinite(drawn.depth) == (drawn.face >= 0)).all()
    on = drawn.face >= 0
    np.testing.assert_allclose(drawn.depth[on], expected[on], rtol=1e-9)


def test_two_triangles_make_a_square_without_a_seam():
    camera = Camera(pinhole((64, 64), 2 * np.arctan(1 / 4)), look_at([0, 0, 8], [0, 0, 0]), (64, 64))
    drawn = rasterise(SQUARE, FACES, camera)  # 4 m of view, the square is 2 m
    expected = np.zeros((64, 64), bool)
    expected[16:48, 16:48] = True
    assert ((drawn.face >= 0) == expected).all()
    np.testing.assert_allclose(drawn.depth[expected], 8.0, rtol=1e-12)


def test_triangles_behind_or_at_the_camera_are_left_out():
    camera = Camera(pinhole((16, 16), 0.9), look_at([0, 0, 0.5], [0, 0, 0]), (16, 16))
    assert (rasterise(SQUARE + [0, 0, 1.0], FACES, camera).face == -1).all()
    across = SQUARE[:, [0, 2, 1]]  # stretches from behind the camera to before it
    assert (rasterise(across, FACES, camera).face == -1).all()
    assert (rasterise(np.zeros((4, 3)), FACES, camera).face == -1).all()


def test_batches_of_candidates_change_nothing(monkeypatch):
    body = builtin_body("male")
    camera = orbit_camera(np.zeros(3), 3.0, 0.4, 0.1, (64, 96))
    whole = rasterise(body.vertices, body.faces, camera)
    monkeypatch.setattr("geometry.rasterise.CANDIDATES", 500)
    parts = rasterise(body.vertices, body.faces, camera)
    assert np.array_equal(whole.depth, parts.depth) and (whole.face >= 0).sum() > 300


def test_pixels_that_are_asked_for_see_what_they_see_in_the_whole_picture():
    body = builtin_body("male")
    camera = orbit_camera(body.vertices.mean(0), 2.6, 0.4, 0.1, (90, 120))
    whole, asked = rasterise(body.vertices, body.faces, camera), np.zeros((120, 90), bool)
    asked.ravel()[np.random.default_rng(0).integers(0, asked.size, 300)] = True
    some = rasterise(body.vertices, body.faces, camera, asked=asked)
    assert (whole.face[asked] >= 0).sum() > 20
    assert np.array_equal(some.face[asked], whole.face[asked]) and np.array_equal(some.depth[asked], whole.depth[asked])
    assert (some.face < 0).sum() > (whole.face < 0).sum()  # what no pixel asks for is not drawn
