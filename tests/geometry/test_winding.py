"""Winding numbers of sampled surfaces, whole and with holes."""

import numpy as np
import pytest

from avatar.rotation import fibonacci_sphere
from geometry.winding import winding_grid

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
