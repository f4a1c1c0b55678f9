"""Closest points against a brute-force search and against trimesh."""

import numpy as np
import pytest

from geometry import closest
from geometry.closest import closest_on_triangles, closest_points, triangle_index


@pytest.mark.parametrize("stretch", [1.0, 40.0])
@pytest.mark.parametrize("pairs", [100, 500_000])
def test_closest_points_equal_the_search_over_every_face(stretch, pairs, monkeypatch):
    # few pairs in memory: the groups are cut
    monkeypatch.setattr(closest, "PAIRS_AT_ONCE", pairs)
    rng = np.random.default_rng(3)
    # long thin triangles among others
    vertices = rng.normal(size=(60, 3)) * [1, 1, stretch]
    # some degenerate: an index twice
    faces = rng.integers(0, 60, (80, 3))
    points = rng.normal(size=(200, 3)) * 3
    found = closest_points(points, triangle_index(vertices, faces))
    corners = np.repeat(vertices[faces], 200, axis=0)
    repeated = np.tile(points, (80, 1))
    every = np.linalg.norm(repeated - closest_on_triangles(repeated, corners)[0], axis=1).reshape(80, 200)
    np.testing.assert_allclose(found.distance, every.min(0), rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(points - found.point, axis=1), found.distance, rtol=0, atol=1e-12)
    np.testing.assert_allclose(every[found.face, np.arange(200)], found.distance, rtol=0, atol=1e-12)


def test_unreferenced_vertices_do_not_count_and_no_points_have_no_closest_points():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, 1.0]])
    index = triangle_index(vertices, np.array([[0, 1, 2]]))
    np.testing.assert_allclose(closest_points(vertices[3:], index).distance, 1.0, rtol=1e-15)
    assert closest_points(np.empty((0, 3)), index).point.shape == (0, 3)


def test_nearest_point_of_a_triangle_is_never_farther_than_any_point_of_it():
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(4000, 3, 3))
    # collinear
    corners[:1000, 2] = 0.3 * corners[:1000, 0] + 0.7 * corners[:1000, 1]
    # one point
    corners[1000:1200, 1] = corners[1000:1200, 2] = corners[1000:1200, 0]
    # slivers, from a nanometre to a millimetre thick
    thick = np.logspace(-9, -3, 1000)[:, None]
    corners[1200:2200, 2] = 0.5 * (corners[1200:2200, 0] + corners[1200:2200, 1]) + thick * rng.normal(size=(1000, 3))
    points = rng.normal(size=(4000, 3))
    found, barycentric = closest_on_triangles(points, corners)
    assert barycentric.min() >= 0
    np.testing.assert_allclose(barycentric.sum(1), 1, atol=1e-12)
    nearest = np.linalg.norm(points - found, axis=-1)
    for _ in range(50):
        weights = rng.dirichlet([0.5, 0.5, 0.5], 4000)
        inside = np.einsum("nk,nkc->nc", weights, corners)
        assert (nearest <= np.linalg.norm(points - inside, axis=-1) + 1e-12).all()
