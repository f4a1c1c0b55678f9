"""Surfaces of distance grids, and the NumPy z-buffer against rays through the same pixels."""

import numpy as np
import pytest
import torch
from capsules import sphere

from avatar.body import builtin_body
from avatar.camera import Camera, look_at, orbit_camera, pinhole, pixel_rays
from command.errors import AssetError
from geometry.isosurface import Detail, GridSteps, Hints, extract, graded_axis, project_to_zero, sample_near_surface
from geometry.mesh import TriangleMesh, area_normals, enclosed_volume
from geometry.rasterise import rasterise
from geometry.repair import find_faults


def test_graded_axis_is_fine_inside_its_spans_only_and_takes_the_finest_step_of_its_details():
    axis = graded_axis(-1.0, 1.0, [(0.2, 0.6)], 0.05, 0.02, details=[(0.3, 0.4, 0.005), (-0.5, -0.4, 0.03)])
    steps, middle = np.diff(axis), 0.5 * (axis[1:] + axis[:-1])
    assert len(axis) % 8 == 0 and axis[-1] >= 1.0
    assert (steps[(middle > 0.3) & (middle < 0.4)] < 0.0051).all()
    assert (steps[(middle > 0.45) & (middle < 0.6)] > 0.0199).all()
    assert (steps[(middle > -0.45) & (middle < -0.4)] < 0.031).all()
    assert (steps[(middle < -0.6) | (middle > 0.7)] > 0.049).all()


@pytest.mark.parametrize("high, coarse, fine", [(1.0, 0.01, 0.02), (1.0, 0.01, 0.0), (0.0, 0.02, 0.01)])
def test_an_axis_without_length_or_with_steps_the_wrong_way_round_is_refused(high, coarse, fine):
    with pytest.raises(ValueError, match=f"axis from 0.0 to {high} with steps {coarse}, {fine}"):
        graded_axis(0.0, high, [], coarse, fine)


STEPS = GridSteps(0.008, 0.004)
outward = lambda points: points / np.linalg.norm(points, axis=1, keepdims=True)


def around_ball(count=3000):
    """Hints on a ball of ten centimetres, and the same with normals."""
    facing = outward(np.random.default_rng(0).normal(size=(count, 3)))
    hints = Hints(0.1 * facing, np.zeros(count, bool))
    return hints, hints._replace(facing=facing)


def test_a_detail_keeps_what_the_grid_would_lose():
    """A ridge of 2 mm on a ball, in cells of 8 mm and of 1 mm."""
    ball, _ = sphere(0.1)

    def distance(points):
        ridge = np.maximum(np.abs(points[:, 0]) - 0.001, np.linalg.norm(points, axis=1) - 0.104)
        ridge = np.maximum(ridge, 0.06 - points[:, 2])
        return np.minimum(ball(points), ridge)

    detail = Detail(np.array([-0.01, -0.02, 0.09]), np.array([0.01, 0.02, 0.11]), 0.001)
    for given, top in (((), False), ((detail,), True)):
        found = extract(distance, outward, around_ball(400)[0], STEPS, details=given)
        assert not find_faults(found.mesh.faces, len(found.mesh.vertices))
        across = (np.abs(found.mesh.vertices[:, 1]) < 0.015) & (found.mesh.vertices[:, 2] > 0.09)
        assert (np.linalg.norm(found.mesh.vertices[across], axis=1).max() > 0.1035) == top


def test_what_a_field_makes_up_at_the_edge_of_its_box_is_air_where_hints_tell_front_from_back():
    """Nothing was learnt 3 cm off a template; without the hints' normals nobody can tell, and it is an error."""
    ball, _ = sphere(0.1)
    below = lambda points: np.minimum(ball(points), points[:, 1] + 0.125)
    blind, hints = around_ball()
    assert enclosed_volume(extract(below, outward, hints, STEPS).mesh) == pytest.approx(4 / 3e3 * np.pi, rel=0.02)
    with pytest.raises(AssetError, match=r"should be positive 3 cm outside the template"):
        extract(below, outward, blind, STEPS)


def test_what_hangs_a_millimetre_before_the_surface_is_not_joined_to_it():
    """A lump of 2 cm that the field has before a ball, in cells of 8 mm: left out where the hints' normals are given,
    while a bump of the ball itself stays."""
    ball, _ = sphere(0.1)
    lump, _ = sphere(0.02, (0, 0, 0.121))
    bump, _ = sphere(0.012, (0.1, 0, 0))
    distance = lambda points: np.minimum(np.minimum(ball(points), bump(points)), lump(points))

    def normal(points):
        return np.where((lump(points) < 0.01)[:, None], (points - [0, 0, 0.121]) / 0.02, outward(points))

    joined, apart = (extract(distance, normal, hints, STEPS, margin=0.06) for hints in around_ball())
    assert joined.mesh.vertices[:, 2].max() > 0.135
    assert apart.mesh.vertices[:, 2].max() < 0.11 and not find_faults(apart.mesh.faces, len(apart.mesh.vertices))
    assert apart.mesh.vertices[:, 0].max() > 0.107


def test_sparse_samples_have_the_sign_of_dense_ones_and_are_exact_at_the_surface():
    distance, _ = sphere(0.3, (0.05, -0.02, 0.01))
    axes = tuple(graded_axis(-0.5, 0.5, [(0.1, 0.2)], 0.02, 0.01) for _ in range(3))
    volume, queries = sample_near_surface(distance, axes, np.zeros((1, 3)))
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    exact = distance(grid.reshape(-1, 3)).reshape(volume.shape)
    np.testing.assert_array_equal(np.sign(volume), np.sign(exact.astype(np.float32)))
    near = np.abs(exact) < 0.004
    np.testing.assert_allclose(volume[near], exact[near], atol=1e-6)
    assert queries < 0.6 * volume.size


@pytest.mark.parametrize("slope", [0.5, 0.85, 1.0, 1.8])
def test_projection_reaches_the_zero_set_whatever_the_slope(slope):
    distance, normal = sphere(0.1)
    rng = np.random.default_rng(0)
    points = rng.normal(size=(500, 3))
    points *= (0.1 + rng.uniform(-0.003, 0.003, (500, 1))) / np.linalg.norm(points, axis=1, keepdims=True)
    sloped = lambda p: slope * distance(p) + 30 * distance(p) ** 2
    _, residual = project_to_zero(sloped, points, normal(points), reach=0.004)
    assert residual.max() < 1e-4


def test_projection_says_where_no_zero_is_in_reach_and_fine_points_get_a_finer_mesh():
    distance, normal = sphere(0.1)
    points = np.array([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]])
    moved, residual = project_to_zero(distance, points, normal(points), reach=0.004)
    assert np.isfinite(moved).all() and (residual > 0.09).all()
    box = np.array([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1], [0.05, 0.05, 0.05]])
    found = extract(distance, normal, Hints(box, np.array([False, False, True])), GridSteps(0.01, 0.0025))
    v, f = found.mesh
    side = np.linalg.norm(v[f[:, 1]] - v[f[:, 0]], axis=1)
    centre = v[f].mean(1)
    inside = (np.abs(centre - 0.05) < 0.008).all(1)
    assert side[inside].mean() < 0.4 * side[~(np.abs(centre - 0.05) < 0.02).any(1)].mean()


def test_person_is_one_closed_manifold_on_the_zero_set(run):
    def distance(points):
        return run.field.distance(torch.tensor(points, dtype=torch.float32)).numpy().astype(float)

    surface = run.surface
    assert not find_faults(surface.faces, len(surface.vertices))
    assert enclosed_volume(TriangleMesh(surface.vertices, surface.faces)) > 0.03
    away = np.abs(distance(surface.vertices))
    assert np.quantile(away, 0.999) < 1e-4  # metres; creases between capsules have no exact normal
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1, atol=1e-5)
    # normals face the way the triangles do
    facing = area_normals(surface.vertices, surface.faces)
    wide = np.linalg.norm(facing, axis=1) > 1e-7
    assert ((facing * surface.normals[surface.faces[:, 0]]).sum(1)[wide] > 0).mean() > 0.99


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


def test_a_square_has_no_seam_and_triangles_behind_or_at_the_camera_are_left_out():
    camera = Camera(pinhole((64, 64), 2 * np.arctan(1 / 4)), look_at([0, 0, 8], [0, 0, 0]), (64, 64))
    drawn = rasterise(SQUARE, FACES, camera)  # 4 m of view, the square is 2 m
    expected = np.zeros((64, 64), bool)
    expected[16:48, 16:48] = True
    assert ((drawn.face >= 0) == expected).all()
    np.testing.assert_allclose(drawn.depth[expected], 8.0, rtol=1e-12)
    camera = Camera(pinhole((16, 16), 0.9), look_at([0, 0, 0.5], [0, 0, 0]), (16, 16))
    assert (rasterise(SQUARE + [0, 0, 1.0], FACES, camera).face == -1).all()
    across = SQUARE[:, [0, 2, 1]]  # stretches from behind the camera to before it
    assert (rasterise(across, FACES, camera).face == -1).all()
    assert (rasterise(np.zeros((4, 3)), FACES, camera).face == -1).all()


def test_batches_change_nothing_and_pixels_that_are_asked_for_see_what_they_see_in_the_whole(monkeypatch):
    body = builtin_body("male")
    camera = orbit_camera(np.zeros(3), 3.0, 0.4, 0.1, (64, 96))
    whole = rasterise(body.vertices, body.faces, camera)
    monkeypatch.setattr("geometry.rasterise.CANDIDATES", 500)
    parts = rasterise(body.vertices, body.faces, camera)
    assert np.array_equal(whole.depth, parts.depth) and (whole.face >= 0).sum() > 300
    camera = orbit_camera(body.vertices.mean(0), 2.6, 0.4, 0.1, (90, 120))
    whole, asked = rasterise(body.vertices, body.faces, camera), np.zeros((120, 90), bool)
    asked.ravel()[np.random.default_rng(0).integers(0, asked.size, 300)] = True
    some = rasterise(body.vertices, body.faces, camera, asked=asked)
    assert (whole.face[asked] >= 0).sum() > 20
    assert np.array_equal(some.face[asked], whole.face[asked]) and np.array_equal(some.depth[asked], whole.depth[asked])
    assert (some.face < 0).sum() > (whole.face < 0).sum()  # what no pixel asks for is not drawn
