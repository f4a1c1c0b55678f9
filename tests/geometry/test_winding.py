"""Winding numbers of sampled surfaces, whole and with holes."""

import numpy as np
import pytest

from avatar.rotation import fibonacci_sphere
from geometry.winding import winding_grid

RADIUS, CELL = 0.1, 0.01
AREA = 4 * np.pi * RADIUS**2


def around(low: np.ndarray, count: int = 4000, keep=lambda d: np.ones(len(d), bool), shape=(41, 41, 41)):
    """Winding number of a sphere's samples at the origin, and each node's way from its middle."""
    d = fibonacci_sphere(count)
    d = d[keep(d)]
    grid = winding_grid(RADIUS * d, AREA / count * d, low, shape, CELL)
    nodes = low + CELL * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1)
    return grid, np.linalg.norm(nodes, axis=-1), nodes


def test_a_sphere_winds_once_round_its_inside_and_never_round_its_outside():
    grid, away, _ = around(np.full(3, -0.203))
    assert np.abs(grid[away < RADIUS - 2 * CELL] - 1).max() < 0.02
    assert np.abs(grid[away > RADIUS + 2 * CELL]).max() < 0.02


def test_samples_beyond_the_box_count():
    whole, _, _ = around(np.full(3, -0.203))
    cut, _, _ = around(np.full(3, -0.203) + CELL * np.array([20, 5, 0]), shape=(8, 10, 12))
    np.testing.assert_allclose(cut, whole[20:28, 5:15, :12], atol=0.01)


def test_a_hole_leaves_signs_as_they_are_away_from_it():
    grid, away, nodes = around(np.full(3, -0.203), keep=lambda d: d[:, 1] < 0.8)
    below = nodes[..., 1] < 0.02
    assert grid[below & (away < RADIUS - 2 * CELL)].min() > 0.75
    assert grid[away > RADIUS + 4 * CELL].max() < 0.25


def test_one_turned_normal_in_twenty_opens_nothing():
    count, rng = 4000, np.random.default_rng(0)
    d = fibonacci_sphere(count)
    turned = np.where(rng.random(count) < 0.05, -1.0, 1.0)[:, None] * d
    low = np.full(3, -0.203)
    grid = winding_grid(RADIUS * d, AREA / count * turned, low, (41, 41, 41), CELL)
    away = around(low)[1]
    assert grid[away < RADIUS - 3 * CELL].min() > 0.75
    assert grid[away > RADIUS + 3 * CELL].max() == pytest.approx(0, abs=0.25)
