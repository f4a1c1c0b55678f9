"""Surface distances against closed forms and a brute-force search."""

import numpy as np
import pytest
import trimesh

from bench.surface_distance import (
    closest_points,
    face_areas,
    mesh_distance,
    nearest_on_triangles,
    rigid_alignment,
    sample_surface,
    triangle_index,
)


def sphere(radius, centre=(0.0, 0.0, 0.0), subdivisions=5):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.asarray(mesh.vertices) + centre, np.asarray(mesh.faces)


def test_concentric_spheres_are_their_radii_apart_in_centimetres():
    measured = mesh_distance(sphere(0.30), sphere(0.32))
    assert measured == pytest.approx((2.0, 2.0, 2.0), abs=0.02)  # the chord error of 20480 faces is 0.01 cm


def test_a_moved_sphere_has_the_mean_distance_of_the_closed_form():
    # |x + s| - r averaged over the sphere, both directions: s/2 in the limit of a small shift s
    shift = 0.002
    measured = mesh_distance(sphere(0.3), sphere(0.3, (shift, 0, 0)), count=20_000)
    assert measured.chamfer == pytest.approx(100 * shift / 2, rel=0.02)


def test_half_a_sphere_is_exact_one_way_and_incomplete_the_other():
    vertices, faces = sphere(0.3)
    upper = faces[(vertices[faces][:, :, 1] > 0).all(1)]
    measured = mesh_distance((vertices, faces), (vertices, upper))
    assert measured.p2s == pytest.approx(0, abs=1e-6)
    assert measured.completeness > 5


@pytest.mark.parametrize("stretch", [1.0, 40.0])
def test_closest_points_equal_the_search_over_every_face(stretch):
    rng = np.random.default_rng(3)
    vertices = rng.normal(size=(60, 3)) * [1, 1, stretch]  # long thin triangles among others
    faces = rng.integers(0, 60, (80, 3))  # some degenerate: an index twice
    points = rng.normal(size=(200, 3)) * 3
    found = closest_points(points, triangle_index(vertices, faces))
    corners = np.broadcast_to(vertices[faces].transpose(1, 0, 2)[:, :, None], (3, 80, 200, 3)).reshape(3, -1, 3)
    repeated = np.tile(points, (80, 1))
    every = np.linalg.norm(repeated - nearest_on_triangles(repeated, *corners), axis=1).reshape(80, 200)
    np.testing.assert_allclose(found.distance, every.min(0), rtol=0, atol=1e-12)


def test_nearest_point_of_a_triangle_is_never_farther_than_any_point_of_it():
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(3, 4000, 3))
    corners[2, :1000] = 0.3 * corners[0, :1000] + 0.7 * corners[1, :1000]  # collinear
    corners[1, 1000:1200] = corners[2, 1000:1200] = corners[0, 1000:1200]  # one point
    points = rng.normal(size=(4000, 3))
    nearest = np.linalg.norm(points - nearest_on_triangles(points, *corners), axis=-1)
    for _ in range(50):
        weights = rng.dirichlet([0.5, 0.5, 0.5], 4000)
        inside = np.einsum("nk,knc->nc", weights, corners)
        assert (nearest <= np.linalg.norm(points - inside, axis=-1) + 1e-12).all()


def test_samples_are_seeded_uniform_by_area_and_keep_to_the_faces_kept():
    vertices, faces = sphere(1.0, subdivisions=3)
    keep = vertices[faces].mean(1)[:, 1] > 0
    samples = sample_surface(vertices, faces, 20_000, seed=1, keep=keep)
    assert keep[samples.face].all()
    again = sample_surface(vertices, faces, 20_000, seed=1, keep=keep)
    np.testing.assert_array_equal(samples.face, again.face)
    expected = np.average(vertices[faces].mean(1)[keep], weights=face_areas(vertices, faces)[keep], axis=0)
    np.testing.assert_allclose(samples.on(vertices, faces).mean(0), expected, atol=2e-3)


def test_alignment_undoes_a_rigid_motion():
    mesh = trimesh.creation.box((0.3, 0.5, 1.7))
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    points = sample_surface(vertices, faces, 800, seed=0).on(vertices, faces)
    moved_from_truth = trimesh.transformations.rotation_matrix(0.05, [1, 2, 3])
    moved_from_truth[:3, 3] = [0.01, -0.02, 0.015]
    moved = points @ moved_from_truth[:3, :3].T + moved_from_truth[:3, 3]
    found = rigid_alignment(moved, triangle_index(vertices, faces), rounds=100)
    np.testing.assert_allclose(found @ moved_from_truth, np.eye(4), atol=2e-3)
