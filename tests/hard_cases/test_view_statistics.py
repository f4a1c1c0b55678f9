"""Eq. 14's statistics where they are thin, contradictory or many."""

import numpy as np
import pytest

from train.views import add_views, fused_statistics, no_views, statistics

PAIRS = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]


def _matrix(six):
    out = np.zeros((3, 3))
    for value, (i, j) in zip(six, PAIRS):
        out[i, j] = out[j, i] = value
    return out


def _directions(count: int, spread: float, seed: int = 0) -> np.ndarray:
    d = np.random.default_rng(seed).normal([0.2, -0.1, 1.0], spread, (count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_statistics_equal_a_loop_over_the_definition():
    rng = np.random.default_rng(3)
    vertex, directions = rng.integers(0, 9, 400), _directions(400, 0.4)
    sums = no_views(10)
    for start in range(0, 400, 37):
        add_views(sums, vertex[start : start + 37], directions[start : start + 37])
    table = statistics(sums)
    for v in range(10):
        seen = directions[vertex == v]
        assert table.count[v] == len(seen)
        if len(seen) == 0:
            continue
        mean = seen.mean(0)
        unit = mean / np.linalg.norm(mean)
        tangent = seen - (seen @ unit)[:, None] * unit
        np.testing.assert_allclose(table.mean[v], mean, atol=1e-12)
        np.testing.assert_allclose(_matrix(table.covariance[v]), tangent.T @ tangent / len(seen), atol=1e-12)


def test_a_vertex_never_seen_has_zeros():
    table = statistics(no_views(2))
    assert not table.count.any() and not table.mean.any() and not table.covariance.any()


def test_a_vertex_seen_once_has_its_direction_and_no_spread():
    sums, d = no_views(1), _directions(1, 0.3)
    add_views(sums, np.array([0]), d)
    table = statistics(sums)
    np.testing.assert_allclose(table.mean[0], d[0], atol=1e-15)
    np.testing.assert_allclose(table.covariance[0], 0, atol=1e-15)


def test_opposite_directions_leave_no_mean_and_the_whole_spread():
    sums, d = no_views(1), _directions(1, 0.3)
    add_views(sums, np.array([0, 0]), np.concatenate([d, -d]))
    table = statistics(sums)
    assert np.linalg.norm(table.mean[0]) < 1e-15
    np.testing.assert_allclose(_matrix(table.covariance[0]), d.T @ d, atol=1e-15)


def test_a_million_float32_observations_keep_their_mean():
    d = _directions(1_000_000, 0.05).astype(np.float32)
    sums = no_views(1)
    for piece in np.array_split(d, 7):
        add_views(sums, np.zeros(len(piece), int), piece)
    table = statistics(sums)
    np.testing.assert_allclose(table.mean[0], d.astype(np.float64).mean(0), atol=1e-12)
    assert np.linalg.eigvalsh(_matrix(table.covariance[0])).min() > -1e-12


@pytest.mark.parametrize("spread", [0.0, 1e-6, 0.5, 5.0])
def test_covariance_lies_across_the_mean_and_is_positive(spread):
    sums = no_views(1)
    add_views(sums, np.zeros(300, int), _directions(300, spread))
    table = statistics(sums)
    C = _matrix(table.covariance[0])
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
