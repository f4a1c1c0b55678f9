"""Hard cases: rotations at zero, at every branch, at pi and far beyond, against mpmath and closed forms."""

import mpmath
import numpy as np
import pytest

from avatar.rotation import (
    axis_angle_from_matrix,
    axis_angle_from_quaternion,
    matrix_from_axis_angle,
    normalised_quaternion,
    quaternion_from_axis_angle,
    slerp,
)
from experiments.builtin_motions import nearest_axis_angle

AXES = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, -2, 3], [1e-3, 1, -1e-3], [-1, -1, -1], [1, 1, 0]])
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
PI = np.pi
# zero, denormal, both sides of the series branch (t = 0.01), both sides of a half turn, a full turn, many turns
ANGLES = [0.0, 1e-300, 1e-30, 1e-8, 0.0099999, 0.0100001, 1.0, PI - 1e-9, PI, PI + 1e-9, 2 * PI, 1000 * PI]


def exact_rotation(v: np.ndarray) -> np.ndarray:
    """Rodrigues' formula in 60 digits; independent of the code under test."""
    with mpmath.workdps(60):
        x, y, z = (mpmath.mpf(float(c)) for c in v)
        t = mpmath.sqrt(x * x + y * y + z * z)
        K = mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        a = mpmath.sin(t) / t if t else mpmath.mpf(1)
        b = (1 - mpmath.cos(t)) / t**2 if t else mpmath.mpf("0.5")
        R = mpmath.eye(3) + a * K + b * K * K
        return np.array([[float(R[i, j]) for j in range(3)] for i in range(3)])


@pytest.mark.parametrize("angle", ANGLES)
def test_matrix_equals_the_60_digit_rotation(angle, within):
    exact = np.stack([exact_rotation(axis * angle) for axis in AXES])
    within(matrix_from_axis_angle(AXES * angle) - exact, 5e-15 + 4e-16 * angle)  # the angle carries one rounding


@pytest.mark.parametrize("angle", ANGLES)
def test_quaternion_is_unit_and_the_same_rotation(angle):
    q = quaternion_from_axis_angle(AXES * angle)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1, atol=1e-13)
    back = matrix_from_axis_angle(axis_angle_from_quaternion(q))
    np.testing.assert_allclose(back, matrix_from_axis_angle(AXES * angle), atol=1e-12)


@pytest.mark.parametrize("angle", ANGLES)
def test_float32_input_stays_finite_and_close(angle):
    v = (AXES * angle).astype(np.float32)
    R = matrix_from_axis_angle(v)
    np.testing.assert_allclose(R, matrix_from_axis_angle(v.astype(np.float64)), atol=1e-12)
    assert np.isfinite(R).all()


@pytest.mark.parametrize("gap", [1e-3, 1e-6, 1e-9, 1e-12, 0.0])
def test_log_keeps_its_digits_near_pi_in_every_axis_direction(gap, within):
    v = AXES * (PI - gap)
    back = axis_angle_from_matrix(matrix_from_axis_angle(v))
    same = np.minimum(np.linalg.norm(back - v, axis=1), np.linalg.norm(back + AXES * (PI + gap), axis=1))
    within(same, 2e-8, "rad")  # at exactly pi both axes are the rotation


def test_log_of_tiny_rotations_keeps_relative_precision():
    for length in (1e-30, 1e-12, 1e-9, 3e-8):
        back = axis_angle_from_quaternion(quaternion_from_axis_angle(AXES * length))
        np.testing.assert_allclose(back, AXES * length, rtol=1e-12)


def test_axis_sign_is_stable_between_neighbouring_frames_through_pi():
    angles = np.linspace(PI - 0.3, PI + 0.3, 61)
    frames = axis_angle_from_matrix(matrix_from_axis_angle(AXES[3] * angles[:, None]))
    assert np.abs(np.diff(frames, axis=0)).max() > 3  # the raw logarithm does jump
    for i in range(1, len(frames)):
        frames[i] = nearest_axis_angle(frames[i], frames[i - 1])
    assert np.abs(np.diff(frames, axis=0)).max() < 0.02


@pytest.mark.parametrize("gap", [0.0, 1e-16, 1e-9, 1e-4])
def test_slerp_of_nearly_equal_and_nearly_opposite(gap):
    a = quaternion_from_axis_angle(AXES[3:4] * 1.0)
    for sign in (1, -1):  # -q is the same rotation and must not change the path
        b = sign * quaternion_from_axis_angle(AXES[3:4] * (1.0 + gap))
        for t in (0.0, 0.3, 1.0):
            expected = matrix_from_axis_angle(AXES[3:4] * (1.0 + t * gap))
            got = matrix_from_axis_angle(axis_angle_from_quaternion(slerp(a, b, t)))
            np.testing.assert_allclose(got, expected, atol=1e-14)


def test_slerp_across_a_half_turn_is_finite_unit_and_keeps_both_ends(within):
    a, b = np.array([0, 0, 0, 1.0]), np.array([1.0, 0, 0, 0])
    path = np.stack([slerp(a, b, t) for t in np.linspace(0, 1, 11)])
    within(np.linalg.norm(path, axis=1) - 1, 1e-15)
    np.testing.assert_allclose(np.abs(path[[0, -1]] @ np.stack([a, b]).T), np.eye(2), atol=1e-15)


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 0]])
def test_a_quaternion_without_direction_is_refused(bad):
    with pytest.raises(ValueError, match="zero or not finite"):
        normalised_quaternion(np.array(bad, float))


@pytest.mark.parametrize("scale", [1e-200, 1e-20, 3.0, 1e200])
def test_a_quaternion_of_any_length_is_normalised(scale):
    q = normalised_quaternion(np.array([0.1, -0.2, 0.3, 0.4]) * scale)
    np.testing.assert_allclose(q, np.array([0.1, -0.2, 0.3, 0.4]) / np.sqrt(0.3), rtol=1e-14)


def test_a_quaternion_and_its_negative_are_one_vector_of_at_most_half_a_turn():
    q = np.random.default_rng(3).normal(size=(200, 4))
    vector = axis_angle_from_quaternion(q)
    np.testing.assert_allclose(axis_angle_from_quaternion(-q), vector, rtol=0, atol=1e-12)
    assert np.linalg.norm(vector, axis=1).max() <= np.pi
