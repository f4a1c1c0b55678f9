"""Derivatives of posed points and pixels against finite differences."""

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.camera import Camera, look_at, pinhole, project
from avatar.kinematics import (
    NEAREST,
    SkinnedPoints,
    increment_rows,
    pixel_rows,
    pose_rows,
    posed_canonical,
    right_jacobian,
    second_turns,
    turned,
    turns,
)
from avatar.limits import axis_angle_from_joint_angles
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skinning import skin_points

MOVING = np.array([0, 3, 13, 16, 18, 20, 22, 23])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.0099, 0.0101, 1.0, 3.0])
def test_right_jacobian_turns_as_the_exponential_does(angle):
    v = angle * np.array([0.6, -0.64, 0.48])
    for axis in np.eye(3):
        moved = matrix_from_axis_angle(-v) @ matrix_from_axis_angle(v + 1e-6 * axis)
        np.testing.assert_allclose(axis_angle_from_matrix(moved) / 1e-6, right_jacobian(v) @ axis, atol=5e-6)


def test_joint_angles_turn_their_joints_as_told():
    rng = np.random.default_rng(0)
    angles = rng.normal(0, 0.5, (52, 3))
    told = turns(angles)
    rotations = lambda a: matrix_from_axis_angle(axis_angle_from_joint_angles(a))
    for k in range(3):
        changed = angles.copy()
        changed[:, k] += 1e-6
        seen = axis_angle_from_matrix(np.swapaxes(rotations(angles), 1, 2) @ rotations(changed)) / 1e-6
        np.testing.assert_allclose(seen, told[:, :, k], atol=5e-6)


@pytest.fixture(scope="module")
def pose():
    rng = np.random.default_rng(0)
    return 0.4 * rng.standard_normal((52, 3)), rng.standard_normal(3)


def slopes(pose, joints, value):
    """Differences of `value` of the frame along the increments of root and MOVING."""

    axis_angle, root = pose

    def at(d):
        R = matrix_from_axis_angle(axis_angle)
        R[MOVING] = turned(R[MOVING], d[3:].reshape(-1, 3))
        return value(posed_canonical(axis_angle_from_matrix(R), joints, root + d[:3]))

    return np.stack([(at(1e-6 * e) - at(-1e-6 * e)) / 2e-6 for e in np.eye(3 + 3 * len(MOVING))], 1)


def test_skinned_points_move_with_the_increments_of_the_kinematic_chain(pose):
    body, rng = builtin_body("male"), np.random.default_rng(1)
    chosen, c = rng.choice(len(body.vertices), 40, replace=False), rng.standard_normal((40, 3))
    rest, skin = body.vertices[chosen], body.skin.of(chosen)
    rows = increment_rows(posed_canonical(pose[0], body.joints, pose[1]), rest, skin, c, MOVING)
    numeric = slopes(pose, body.joints, lambda frame: (c * skin_points(rest, skin, frame.transforms)).sum(1))
    np.testing.assert_allclose(rows, numeric, rtol=0, atol=1e-6)  # weights are float32


def test_joints_move_with_the_increments_of_the_kinematic_chain(pose):
    joints, c = builtin_body("male").joints, np.random.default_rng(2).standard_normal((52, 3))
    frame = posed_canonical(pose[0], joints, pose[1])
    points = SkinnedPoints(frame.skeleton.joints, frame.shift, np.arange(52)[:, None], np.ones((52, 1)))
    rows = pose_rows(frame, points, c, MOVING)
    numeric = slopes(pose, joints, lambda frame: (c * frame.place).sum(1))
    np.testing.assert_allclose(rows, numeric, rtol=0, atol=1e-6)


def test_second_differences_of_turns_change_with_increments_as_their_rows_say():
    rng = np.random.default_rng(3)
    R = matrix_from_axis_angle(np.cumsum(0.01 * rng.standard_normal((5, 2, 3)), 0))
    d = rng.standard_normal((5, 2, 3))
    a, rows = second_turns(R)
    seen = (second_turns(turned(R, 1e-6 * d))[0] - second_turns(turned(R, -1e-6 * d))[0]) / 2e-6
    told = sum(np.einsum("fmij,fmj->fmi", row, d[i : 3 + i]) for i, row in enumerate(rows))
    # a small turn's logarithm changes with an increment by the increment, to first order in the turn
    np.testing.assert_allclose(seen, told, atol=0.06)
    assert a.shape == (3, 2, 3)


def test_pixels_move_with_points_as_their_rows_say():
    camera = Camera(pinhole((200, 120), 0.6), look_at([0.3, 0.2, 3], [0, 0, 0]), (200, 120))
    x = np.random.default_rng(4).uniform(-1, 1, (20, 3))
    at, rows = pixel_rows(camera, x)
    np.testing.assert_allclose(at, project(camera, x)[0], atol=1e-9)
    for k, axis in enumerate(np.eye(3)):
        seen = (pixel_rows(camera, x + 1e-6 * axis)[0] - pixel_rows(camera, x - 1e-6 * axis)[0]) / 2e-6
        np.testing.assert_allclose(seen, rows[:, :, k], rtol=1e-6, atol=1e-5)


def test_points_behind_the_camera_are_projected_as_if_they_lay_just_before_it():
    camera = Camera(pinhole((200, 120), 0.6), np.eye(4), (200, 120))
    at, rows = pixel_rows(camera, np.array([[0.01, 0.02, -3.0], [0.01, 0.02, NEAREST]]))
    np.testing.assert_array_equal(at[0], at[1])
    np.testing.assert_array_equal(rows[0], rows[1])
