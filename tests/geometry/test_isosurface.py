import numpy as np
import pytest
import torch
from capsules import sphere

from command.errors import AssetError
from geometry.isosurface import Detail, GridSteps, Hints, extract, graded_axis, project_to_zero, sample_near_surface
from geometry.mesh import TriangleMesh, area_normals, enclosed_volume
from geometry.repair import find_faults


def test_graded_axis_is_fine_inside_its_spans_only_and_takes_the_finest_step_of_its_details():
    axis = graded_axis(-1.0, 1.0, [(0.2, 0.6)], 0.05, 0.02, details=[(0.3, 0.4, 0.005), (-0.5, -0.4, 0.03)])
    steps, middle = np.diff(axis), 0.5 * (axis[1:] + axis[:-1])
    assert len(axis) % 8 == 0 and axis[-1] >= 1.0
    assert (steps[(middle > 0.3) & (middle < 0.4)] < 0.0051).all()
    assert (steps[(middle > 0.45) & (middle < 0.6)] > 0.0199).all()
    assert (steps[(middle > -0.45) & (middle < -0.4)] < 0.031).all()
    assert (steps[(middle < -0.6) | (middle > 0.7)] > 0.049).all()


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


def test_point_without_a_zero_in_reach_stays_finite_and_says_so():
    distance, normal = sphere(0.1)
    points = np.array([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]])
    moved, residual = project_to_zero(distance, points, normal(points), reach=0.004)
    assert np.isfinite(moved).all() and (residual > 0.09).all()


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


def test_fine_points_get_a_finer_mesh():
    distance, normal = sphere(0.1)
    box = np.array([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1], [0.05, 0.05, 0.05]])
    found = extract(distance, normal, Hints(box, np.array([False, False, True])), GridSteps(0.01, 0.0025))
    v, f = found.mesh
    side = np.linalg.norm(v[f[:, 1]] - v[f[:, 0]], axis=1)
    centre = v[f].mean(1)
    inside = (np.abs(centre - 0.05) < 0.008).all(1)
    assert side[inside].mean() < 0.4 * side[~(np.abs(centre - 0.05) < 0.02).any(1)].mean()
