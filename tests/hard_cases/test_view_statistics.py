"""Eq. 14's statistics where they are thin, contradictory or many."""

import numpy as np
import pytest

from bake.cone import ViewCone, clamped_tangent, cone_direction, interpolated, matrix_from_six, view_cone
from capture.template.views import add_views, fused_statistics, no_views, statistics


def _directions(count: int, spread: float, seed: int = 0) -> np.ndarray:
    d = np.random.default_rng(seed).normal([0.2, -0.1, 1.0], spread, (count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_statistics_equal_a_loop_over_the_definition():
    """Vertex 9 is never seen, 10 once, 11 from exactly opposite sides: no mean, and the whole spread."""
    rng = np.random.default_rng(3)
    vertex, directions = np.append(rng.integers(0, 9, 400), [10, 11, 11]), _directions(403, 0.4)
    directions[402] = -directions[401]
    sums = no_views(12)
    for start in range(0, 403, 37):
        add_views(sums, vertex[start : start + 37], directions[start : start + 37])
    table = statistics(sums)
    assert not table.mean[9].any() and not table.covariance[9].any() and np.linalg.norm(table.mean[11]) < 1e-15
    for v in range(12):
        seen = directions[vertex == v]
        assert table.count[v] == len(seen)
        if len(seen) == 0:
            continue
        mean = seen.mean(0)
        unit = mean / np.linalg.norm(mean) if mean.any() else mean
        tangent = seen - (seen @ unit)[:, None] * unit
        np.testing.assert_allclose(table.mean[v], mean, atol=1e-12)
        np.testing.assert_allclose(matrix_from_six(table.covariance[v]), tangent.T @ tangent / len(seen), atol=1e-12)


def test_a_million_float32_observations_keep_their_mean():
    d = _directions(1_000_000, 0.05).astype(np.float32)
    sums = no_views(1)
    for piece in np.array_split(d, 7):
        add_views(sums, np.zeros(len(piece), int), piece)
    table = statistics(sums)
    np.testing.assert_allclose(table.mean[0], d.astype(np.float64).mean(0), atol=1e-12)
    assert np.linalg.eigvalsh(matrix_from_six(table.covariance[0])).min() > -1e-12


@pytest.mark.parametrize("spread", [0.0, 1e-6, 0.5, 5.0])
def test_covariance_lies_across_the_mean_and_is_positive(spread):
    sums = no_views(1)
    add_views(sums, np.zeros(300, int), _directions(300, spread))
    table = statistics(sums)
    C = matrix_from_six(table.covariance[0])
    np.testing.assert_allclose(C @ table.mean[0], 0, atol=1e-12)
    assert np.linalg.eigvalsh(C).min() > -1e-12


def test_fusion_asks_only_parts_that_saw_the_vertex():
    body, head = no_views(3), no_views(3)
    add_views(body, np.array([0, 0, 1]), np.array([[0, 0, 1.0], [0, 0, 1.0], [0, 1.0, 0]]))
    add_views(head, np.array([1]), np.array([[1.0, 0, 0]]))
    shares = np.array([[0.0, 1, 0, 0], [0.5, 0.5, 0, 0], [1, 0, 0, 0]])
    table = fused_statistics([statistics(s) for s in (body, head, no_views(3), no_views(3))], shares)
    assert table.count.tolist() == [0, 1, 0]  # vertex 0 belongs to the head, which never saw it
    np.testing.assert_allclose(table.mean[1], [0.5, 0.5, 0])


def cone_of(*observed):
    """The cones of vertices of a fan of triangles, each seen along its own directions, at most six times."""
    count = len(observed)
    sums = no_views(count)
    for vertex, directions in enumerate(observed):
        add_views(sums, np.full(len(directions), vertex), np.asarray(directions, float).reshape(-1, 3))
    table = statistics(sums)
    normals = np.tile([0.0, 0.0, -1.0], (count, 1))
    faces = np.array([[0, i, i + 1] for i in range(1, count - 1)])
    return view_cone(table.count.astype(float), table.mean, table.covariance, normals, faces)


AHEAD = [0.0, 0.0, 1.0]
THIN = {
    "never seen": np.zeros((0, 3)),
    "seen once": [AHEAD],
    "from opposite sides": [[0.6, 0, 0.8], [-0.6, 0, -0.8]] * 50,
    "all from one place": [AHEAD] * 100,
    "from everywhere": _directions(100, 50.0),
}


@pytest.mark.parametrize("case", THIN)
def test_thin_and_contradictory_statistics_give_a_usable_cone(case, within):
    """Direction unit, Q finite and positive, v in [0, 1]; what was not looked at from somewhere definite has v = 0
    and shows the paper's colour from everywhere."""
    cone = cone_of([AHEAD] * 100, THIN[case], [AHEAD] * 100, [AHEAD] * 100)
    within(np.linalg.norm(cone.direction, axis=1) - 1, 1e-12)
    Q = matrix_from_six(cone.metric)
    assert np.isfinite(Q).all() and np.linalg.eigvalsh(Q).min() > -1e-9 * np.abs(Q).max()
    seen = {"never seen": 0.0, "seen once": 0.0, "from opposite sides": 0.0, "all from one place": 1.0}
    if case in seen:
        assert cone.seen[1] == seen[case]
        within(cone.direction[1] - AHEAD, 1e-9)  # its own, or its neighbours'
    d = _directions(2000, 50.0, seed=1)
    tangent = clamped_tangent(d, ViewCone(*(np.repeat(part[1:2], 2000, 0) for part in cone)))
    assert (np.linalg.norm(tangent, axis=1) <= cone.seen[1]).all()
    if case == "all from one place":  # the cone keeps its least width, 3 degrees of spread
        within(np.maximum(np.degrees(np.arcsin(np.linalg.norm(tangent, axis=1))) - 1.6 * 3.01, 0), 1e-9, "degrees")


def six_of(*axes):
    return sum(np.outer(a, a) for a in axes)[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


X, Y = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
EDGES = {  # the two axes of the cone at both ends of an edge
    "of opposite sign": ((4 * X, Y), (-4 * X, -Y)),
    "swapped": ((4 * X, Y), (Y, 4 * X)),
    "of zero length": ((0 * X, 0 * Y), (0 * X, 0 * Y)),
    "zero at one end": ((30 * X, 30 * Y), (0 * X, 0 * Y)),
    "turned by a quarter": ((4 * X, 0.1 * Y), (4 * Y, -0.1 * X)),
}


@pytest.mark.parametrize("case", EDGES)
def test_the_bound_of_the_cone_holds_between_vertices(case, within):
    """Q is interpolated, not its axes: along an edge |t'| lies between its values at the ends, for every direction."""
    one, other = (six_of(*axes) for axes in EDGES[case])
    if case in ("of opposite sign", "swapped"):
        assert np.array_equal(one, other)  # axes have no sign and no order
    ends = ViewCone(np.array([AHEAD, AHEAD]), np.array([one, other]), np.ones(2))
    d = _directions(500, 50.0, seed=2)
    at_ends = [np.linalg.norm(clamped_tangent(d, interpolated_at(ends, s, 500)), axis=1) for s in (0.0, 1.0)]
    low, high = np.minimum(*at_ends), np.maximum(*at_ends)
    for s in np.linspace(0, 1, 21):
        between = interpolated_at(ends, s, 500)
        tangent = clamped_tangent(d, between)
        length = np.linalg.norm(tangent, axis=1)
        within(np.maximum(low - length, 0) + np.maximum(length - high, 0), 1e-12)
        within(np.linalg.norm(cone_direction(tangent, between), axis=1) - 1, 1e-12)


def interpolated_at(ends, share, count):
    weights = np.tile([1 - share, share, 0.0], (count, 1))
    return interpolated(ends, np.tile([0, 1, 0], (count, 1)), weights)


@pytest.mark.parametrize("sign", [1, -1])
def test_along_the_global_direction_and_against_it_there_is_no_tangent(sign, within):
    mean = _directions(2000, 50.0, seed=3)
    cone = ViewCone(mean, np.tile(six_of(3 * X, Y), (2000, 1)), np.ones(2000))
    tangent = clamped_tangent(sign * mean, cone)
    within(tangent, 1e-15)
    within(cone_direction(tangent, cone) - mean, 1e-15)


def test_across_the_global_direction_the_tangent_is_as_long_as_the_cone_allows(within):
    """d orthogonal to d̄: t = d, so |t'| = v / sqrt(1 + d^T Q d) exactly, and d' stays in front."""
    cone = ViewCone(np.array([AHEAD]), six_of(3 * X, 0.5 * Y)[None], np.array([0.7]))
    for angle in np.linspace(0, 2 * np.pi, 17):
        d = np.array([[np.cos(angle), np.sin(angle), 0.0]])
        expected = 0.7 / np.sqrt(1 + 9 * d[0, 0] ** 2 + 0.25 * d[0, 1] ** 2)
        tangent = clamped_tangent(d, cone)
        within(np.linalg.norm(tangent) - expected, 1e-15)
        assert cone_direction(tangent, cone)[0, 2] > 0
