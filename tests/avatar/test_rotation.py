"""Rotations: closed forms, round trips, both sides of every branch."""

import numpy as np
import pytest

from avatar.rotation import (
    axis_angle_from_matrix,
    axis_angle_from_quaternion,
    matrix_from_axis_angle,
    matrix_from_quaternion,
    nearest_axis_angle,
    nearest_rotation,
    quaternion_from_axis_angle,
    quaternion_from_matrix,
    quaternion_product,
    rotation_between,
    slerp,
)


@pytest.fixture
def random():
    return np.random.default_rng(1)


def test_matrix_product_is_quaternion_product(random):
    a, b = random.normal(size=(2, 200, 4))
    product = matrix_from_quaternion(quaternion_product(a, b))
    np.testing.assert_allclose(product, matrix_from_quaternion(a) @ matrix_from_quaternion(b), atol=1e-14)


def test_every_representation_round_trips(random):
    v = random.normal(size=(500, 3))
    v *= (random.uniform(0, np.pi, 500) / np.linalg.norm(v, axis=1))[:, None]
    np.testing.assert_allclose(axis_angle_from_matrix(matrix_from_axis_angle(v)), v, atol=2e-14)
    np.testing.assert_allclose(axis_angle_from_quaternion(quaternion_from_axis_angle(v)), v, atol=2e-14)
    R = matrix_from_axis_angle(v)
    np.testing.assert_allclose(matrix_from_quaternion(quaternion_from_matrix(R)), R, atol=1e-14)


def test_the_nearest_rotation_lays_points_over_points_and_is_never_a_mirror(random):
    R = matrix_from_axis_angle(random.normal(size=(20, 3)))
    a = random.normal(size=(20, 6, 3))
    b = a @ np.swapaxes(R, 1, 2)
    np.testing.assert_allclose(nearest_rotation(np.swapaxes(b, 1, 2) @ a), R, atol=1e-12)
    mirrored = nearest_rotation(np.diag([1.0, 1.0, -0.5]))
    np.testing.assert_allclose(mirrored, np.eye(3), atol=1e-12)


def test_slerp_runs_at_constant_speed(random):
    a, b = quaternion_from_axis_angle(random.normal(size=(2, 50, 3)))
    steps = np.stack([slerp(a, b, t) for t in np.linspace(0, 1, 9)])
    between = np.abs(np.sum(steps[1:] * steps[:-1], -1))
    np.testing.assert_allclose(between, between[0:1].repeat(8, 0), atol=1e-12)


def test_rotation_between_takes_a_to_b_even_when_opposite(random):
    a = random.normal(size=(100, 3))
    b = random.normal(size=(100, 3))
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (a, b))
    b[:10] = -a[:10]
    b[10:20] = a[10:20]
    R = rotation_between(a, b)
    np.testing.assert_allclose((R @ a[..., None])[..., 0], b, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-12)


def test_nearest_axis_angle_is_the_same_rotation_and_no_farther_than_half_a_turn(random):
    v = random.normal(size=(300, 3))
    reference = v * random.uniform(-3, 3, (300, 1)) + random.normal(size=(300, 3)) * 0.1
    near = nearest_axis_angle(v, reference)
    np.testing.assert_allclose(matrix_from_axis_angle(near), matrix_from_axis_angle(v), atol=1e-12)
    assert (np.linalg.norm(near - reference, axis=1) <= np.linalg.norm(v - reference, axis=1) + 1e-9).all()
