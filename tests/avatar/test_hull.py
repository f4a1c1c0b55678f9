"""Outer points of a body: the farthest along every direction, found in little memory."""

import numpy as np
from memory_use import at_most

from avatar.body import builtin_body
from avatar.hull import CHUNK, body_hull, lowest_points, outermost, posed_hull
from avatar.rotation import fibonacci_sphere


def test_outermost_points_are_those_of_one_product_however_many_there_are():
    points = np.random.default_rng(0).normal(size=(2 * CHUNK + 100, 3))
    chosen = outermost(points, 64)
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # 64 directions leave gaps of 20 degrees: what is cut off is small beside the cloud
    missed = (points @ directions.T).max(0) - (points[chosen] @ directions.T).max(0)
    assert missed.min() >= 0 and missed.max() < 0.8
    assert set(np.argmax(points @ fibonacci_sphere(64).T, axis=0)) == set(chosen)


def test_the_points_of_a_long_film_take_little_memory():
    points = np.random.default_rng(0).normal(size=(500_000, 3))
    with at_most(150e6):
        outermost(points)


def test_heights_alone_are_those_of_the_posed_points():
    hull = body_hull(builtin_body("male"))
    rng = np.random.default_rng(0)
    pose, root = rng.normal(size=(40, 52, 3)), rng.normal(size=(40, 3))
    expected = posed_hull(hull, pose, root)[..., 1].min(1)
    np.testing.assert_allclose(lowest_points(hull, pose, root), expected, rtol=0, atol=1e-12)
