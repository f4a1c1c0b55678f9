"""Rotations: closed forms, round trips, both sides of every branch; derivatives against finite differences."""

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
from avatar.rotation import (
    axis_angle_from_matrix,
    axis_angle_from_quaternion,
    fibonacci_sphere,
    left_up_frame,
    matrix_from_axis_angle,
    matrix_from_quaternion,
    nearest_rotation,
    palm_frame,
    quaternion_from_axis_angle,
    quaternion_from_matrix,
    quaternion_product,
    rotation_between,
    slerp,
)
from avatar.skinning import skin_points
from experiments.builtin_motions import nearest_axis_angle


@pytest.fixture
def random():
    return np.random.default_rng(1)


def test_products_agree_and_every_representation_round_trips(random):
    a, b = random.normal(size=(2, 200, 4))
    product = matrix_from_quaternion(quaternion_product(a, b))
    np.testing.assert_allclose(product, matrix_from_quaternion(a) @ matrix_from_quaternion(b), atol=1e-14)
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


def test_slerp_runs_at_constant_speed_and_rotation_between_takes_a_to_b_even_when_opposite(random):
    a, b = quaternion_from_axis_angle(random.normal(size=(2, 50, 3)))
    steps = np.stack([slerp(a, b, t) for t in np.linspace(0, 1, 9)])
    between = np.abs(np.sum(steps[1:] * steps[:-1], -1))
    np.testing.assert_allclose(between, between[0:1].repeat(8, 0), atol=1e-12)
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


def test_points_and_joints_move_with_the_increments_of_the_chain(pose):
    body, rng = builtin_body("male"), np.random.default_rng(1)
    chosen, c = rng.choice(len(body.vertices), 40, replace=False), rng.standard_normal((40, 3))
    rest, skin = body.vertices[chosen], body.skin.of(chosen)
    rows = increment_rows(posed_canonical(pose[0], body.joints, pose[1]), rest, skin, c, MOVING)
    numeric = slopes(pose, body.joints, lambda frame: (c * skin_points(rest, skin, frame.transforms)).sum(1))
    np.testing.assert_allclose(rows, numeric, rtol=0, atol=1e-6)  # weights are float32
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


def test_pixels_move_with_points_as_their_rows_say_and_before_the_camera_where_points_lie_behind_it():
    camera = Camera(pinhole((200, 120), 0.6), look_at([0.3, 0.2, 3], [0, 0, 0]), (200, 120))
    x = np.random.default_rng(4).uniform(-1, 1, (20, 3))
    at, rows = pixel_rows(camera, x)
    np.testing.assert_allclose(at, project(camera, x)[0], atol=1e-9)
    for k, axis in enumerate(np.eye(3)):
        seen = (pixel_rows(camera, x + 1e-6 * axis)[0] - pixel_rows(camera, x - 1e-6 * axis)[0]) / 2e-6
        np.testing.assert_allclose(seen, rows[:, :, k], rtol=1e-6, atol=1e-5)
    camera = Camera(pinhole((200, 120), 0.6), np.eye(4), (200, 120))
    at, rows = pixel_rows(camera, np.array([[0.01, 0.02, -3.0], [0.01, 0.02, NEAREST]]))
    np.testing.assert_array_equal(at[0], at[1])
    np.testing.assert_array_equal(rows[0], rows[1])


def test_frames_keep_one_direction_and_a_sphere_is_even(random):
    kept, other = random.normal(size=(2, 20, 3))
    unit = kept / np.linalg.norm(kept, axis=1, keepdims=True)
    for frame, own, near in ((left_up_frame(other, kept), 1, 0), (palm_frame(kept, other), 0, 2)):
        np.testing.assert_allclose(frame.transpose(0, 2, 1) @ frame, np.tile(np.eye(3), (20, 1, 1)), atol=1e-12)
        assert np.linalg.det(frame) == pytest.approx(np.ones(20))
        np.testing.assert_allclose(frame[..., own], unit, atol=1e-12)
        # the other lies in the plane of the two
        assert ((frame[..., near] * other).sum(1) > 0).all()
        np.testing.assert_allclose(np.abs((frame[..., 3 - own - near] * other).sum(1)), 0, atol=1e-12)
    points = fibonacci_sphere(400)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1, atol=1e-12)
    cosine = points @ points.T - 2 * np.eye(400)
    assert np.abs(points.mean(0)).max() < 2e-3
    assert np.arccos(cosine.max(1)).min() > 0.14 and np.arccos(cosine.max(1)).max() < 0.19
