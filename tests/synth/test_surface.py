"""Measuring meshes."""

import numpy as np
import pytest
import trimesh

from player.context import open_context
from player.raster import Rasteriser
from synth.surface import spread_points, surface_distance, vertex_normals, visible_faces, weld


@pytest.fixture(scope="module")
def rasteriser():
    context = open_context()
    rasteriser = Rasteriser(context)
    yield rasteriser
    rasteriser.release()
    context.release()


def _sphere(radius, subdivisions=3):
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def test_only_the_outer_of_two_spheres_is_seen(rasteriser):
    outer, faces = _sphere(0.9)
    inner, _ = _sphere(0.88)
    seen = visible_faces(rasteriser, np.concatenate([outer, inner]), np.concatenate([faces, faces + len(outer)]))
    assert seen[: len(faces)].all() and not seen[len(faces) :].any()


def test_faces_smaller_than_a_pixel_are_seen(rasteriser):
    vertices, faces = _sphere(0.004, 4)  # 1 mm faces on a bead 1.7 m from another: 5 mm pixels
    far = vertices + [1.7, 0, 0]
    assert visible_faces(rasteriser, np.concatenate([vertices, far]), np.concatenate([faces, faces + len(far)])).all()


def test_normals_do_not_see_texture_seams():
    vertices, faces = _sphere(1.0)
    split = vertices[faces].reshape(-1, 3)  # every face has its own corners
    alone = np.arange(len(split)).reshape(-1, 3)
    expected = vertex_normals(vertices, faces)[faces.ravel()]
    np.testing.assert_allclose(vertex_normals(split, alone, weld(split)), expected, atol=1e-12)


def test_distance_to_a_sampled_sphere():
    vertices, faces = _sphere(0.5, 5)
    surface = spread_points(vertices, faces, 100_000, seed=0)
    directions = np.random.default_rng(1).standard_normal((500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for offset in (-0.02, 0.0, 0.003, 0.02):
        found = surface_distance((0.5 + offset) * directions, surface)
        np.testing.assert_allclose(found.mean(), abs(offset), atol=2e-4)


def test_points_are_spread_by_area():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [3, 0, 0], [0, 3, 1.0]])
    faces = np.array([[0, 1, 2], [0, 3, 4]])
    area = trimesh.Trimesh(vertices, faces, process=False).area_faces
    share = np.bincount(spread_points(vertices, faces, 10_000, seed=0).faces) / 10_000
    np.testing.assert_allclose(share, area / area.sum(), atol=2e-4)  # stratified: one point of 10 000
