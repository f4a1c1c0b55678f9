"""Triangle meshes: normals, seams and volumes, points spread over them, closest points, winding numbers."""

import numpy as np
import pytest
import trimesh
from icosphere import icosphere
from scipy.spatial import KDTree

from avatar.body import builtin_body
from avatar.rotation import fibonacci_sphere
from geometry import closest
from geometry.closest import closest_on_triangles, closest_points, triangle_index
from geometry.mesh import TriangleMesh, component_labels, enclosed_volume, face_areas, largest_component, vertex_normals
from geometry.mesh import weld as welded_vertices
from geometry.sample import lattice_samples, stratified_samples
from geometry.winding import winding_grid


def test_normals_areas_and_volume_of_the_body_are_those_of_trimesh():
    body = builtin_body("male")
    mesh = trimesh.Trimesh(body.vertices.astype(np.float64), body.faces, process=False)
    expected = trimesh.geometry.mean_vertex_normals(len(mesh.vertices), mesh.faces, np.cross(
        mesh.triangles[:, 1] - mesh.triangles[:, 0], mesh.triangles[:, 2] - mesh.triangles[:, 0]))  # fmt: skip
    named = np.unique(mesh.faces)
    np.testing.assert_allclose(vertex_normals(body.vertices, body.faces)[named], expected[named], rtol=0, atol=1e-12)
    np.testing.assert_allclose(face_areas(body.vertices, body.faces), mesh.area_faces, rtol=1e-12)
    parted = mesh.split(only_watertight=False)
    assert component_labels(body.faces, len(body.vertices))[named].max() + 1 >= len(parted)


def test_normals_do_not_see_texture_seams():
    vertices, faces = icosphere(1.0)
    # every face has its own corners
    split = vertices[faces].reshape(-1, 3)
    own = np.arange(len(split)).reshape(-1, 3)
    expected = vertex_normals(vertices, faces)[faces.ravel()]
    np.testing.assert_allclose(vertex_normals(split, own, welded_vertices(split)), expected, atol=1e-12)


def test_a_vertex_without_area_has_a_unit_normal():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 5, 5]])
    np.testing.assert_array_equal(vertex_normals(vertices, np.array([[0, 1, 2]])), np.tile([0.0, 1, 0], (4, 1)))


def test_float32_vertices_are_summed_in_double_precision():
    vertices, faces = icosphere(0.3, subdivisions=4)
    single = vertices.astype(np.float32)
    np.testing.assert_array_equal(vertex_normals(single, faces), vertex_normals(single.astype(np.float64), faces))


def test_the_largest_component_is_the_one_of_greatest_area():
    small, many = icosphere(0.1, subdivisions=4)
    large, few = icosphere(1.0, (3, 0, 0), subdivisions=2)
    mesh = TriangleMesh(np.concatenate([small, large]), np.concatenate([many, few + len(small)]))
    kept, dropped, share = largest_component(mesh)
    assert dropped == 1 and len(kept.faces) == len(few)
    np.testing.assert_array_equal(kept.vertices, large)
    expected = face_areas(small, many).sum() / face_areas(*mesh).sum()
    np.testing.assert_allclose(share, expected, rtol=1e-9)
    np.testing.assert_allclose(enclosed_volume(kept), trimesh.Trimesh(large, few, process=False).volume, rtol=1e-12)


def test_samples_are_seeded_uniform_by_area_and_keep_to_the_faces_kept():
    vertices, faces = icosphere(1.0)
    # faces of many sizes
    vertices = vertices * np.exp(vertices[:, :1])
    keep = vertices[faces].mean(1)[:, 1] > 0
    samples = stratified_samples(vertices, faces, 20_000, seed=1, weight=keep)
    share = np.bincount(samples.face, minlength=len(faces)) / 20_000
    area = face_areas(vertices, faces) * keep
    # one point of 20 000 at either end
    np.testing.assert_allclose(share, area / area.sum(), atol=1.001e-4)
    again = stratified_samples(vertices, faces, 20_000, seed=1, weight=keep)
    np.testing.assert_array_equal(samples.face, again.face)
    expected = np.average(vertices[faces].mean(1), weights=area, axis=0)
    np.testing.assert_allclose(samples.on(vertices, faces).mean(0), expected, atol=2e-3)


def test_a_generator_goes_on_where_it_stands():
    vertices, faces = icosphere(1.0)
    rng = np.random.default_rng(4)
    first = stratified_samples(vertices, faces, 50, seed=rng)
    second = stratified_samples(vertices, faces, 50, seed=rng)
    np.testing.assert_array_equal(first.barycentric, stratified_samples(vertices, faces, 50, seed=4).barycentric)
    assert not np.array_equal(first.barycentric, second.barycentric)


@pytest.mark.parametrize("area_at", ["first", "last"])
def test_no_point_falls_on_a_face_without_area(area_at):
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    faces = np.array([[0, 0, 1], [0, 1, 2], [1, 1, 2]])[:: 1 if area_at == "first" else -1]
    samples = stratified_samples(corners, faces, 5000, seed=2)
    assert (face_areas(corners, faces)[samples.face] > 0).all()
    assert samples.barycentric.min() >= 0
    np.testing.assert_allclose(samples.barycentric.sum(1), 1, atol=1e-15)


def test_lattice_samples_are_no_farther_apart_than_asked_and_cover_by_area():
    vertices, faces = icosphere(0.5, subdivisions=2)
    samples = lattice_samples(vertices, faces, np.full(len(faces), 0.02))
    points = samples.on(vertices, faces)
    anywhere = stratified_samples(vertices, faces, 5000, seed=0).on(vertices, faces)
    assert KDTree(points).query(anywhere)[0].max() < 0.02


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


RADIUS, CELL = 0.1, 0.01
AREA = 4 * np.pi * RADIUS**2


LOW = np.full(3, -0.203)


def around(low=LOW, shape=(41, 41, 41), sign=lambda d: np.ones(len(d))):
    """Winding number of a sphere's samples, each counted by its sign, at nodes; how far each is off its middle."""
    d = fibonacci_sphere(4000)
    grid = winding_grid(RADIUS * d, AREA / 4000 * sign(d)[:, None] * d, low, shape, CELL)
    nodes = low + CELL * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1)
    return grid, np.linalg.norm(nodes, axis=-1), nodes


def test_a_sphere_winds_once_round_its_inside_and_never_round_its_outside():
    grid, away, _ = around()
    assert np.abs(grid[away < RADIUS - 2 * CELL] - 1).max() < 0.02
    assert np.abs(grid[away > RADIUS + 2 * CELL]).max() < 0.02


def test_samples_beyond_the_box_count():
    cut, _, _ = around(LOW + CELL * np.array([20, 5, 0]), shape=(8, 10, 12))
    np.testing.assert_allclose(cut, around()[0][20:28, 5:15, :12], atol=0.01)


def test_a_hole_leaves_signs_as_they_are_away_from_it():
    grid, away, nodes = around(sign=lambda d: 1.0 * (d[:, 1] < 0.8))
    below = nodes[..., 1] < 0.02
    assert grid[below & (away < RADIUS - 2 * CELL)].min() > 0.75
    assert grid[away > RADIUS + 4 * CELL].max() < 0.25


def test_one_turned_normal_in_twenty_opens_nothing():
    grid, away, _ = around(sign=lambda d: np.where(np.random.default_rng(0).random(len(d)) < 0.05, -1.0, 1.0))
    assert grid[away < RADIUS - 3 * CELL].min() > 0.75
    assert grid[away > RADIUS + 3 * CELL].max() == pytest.approx(0, abs=0.25)
