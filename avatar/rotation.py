"""Rotations as axis-angle vectors, quaternions (xyzw) and matrices: finite and right for every angle.

All functions work on the last axis (or the last two), any number of leading ones, in float64 inside.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array


def matrix_from_axis_angle(axis_angle: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Rotation matrix of an axis-angle vector (Rodrigues' formula).

        R = I + a K + b K^2    with t = |axis_angle|, a = sin t / t, b = (1 - cos t) / t^2

    Below t = 0.01 the coefficients are Taylor series in t^2; above, b goes through the half angle, because
    1 - cos t loses half its digits when t is small.
    """
    v = np.asarray(axis_angle, np.float64)
    t2 = np.sum(v * v, -1)
    near_zero = t2 < 1e-4
    t = np.sqrt(np.where(near_zero, 1.0, t2))
    half_sine = np.sin(0.5 * t) / t
    a = np.where(near_zero, 1 - t2 / 6 + t2 * t2 / 120, np.sin(t) / t)
    b = np.where(near_zero, 0.5 - t2 / 24 + t2 * t2 / 720, 2 * half_sine * half_sine)
    K = cross_matrix(v)
    return np.eye(3) + a[..., None, None] * K + b[..., None, None] * (K @ K)


def cross_matrix(v: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """The matrix K with K u = v x u."""
    x, y, z = np.moveaxis(v, -1, 0)
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(*v.shape[:-1], 3, 3)


def quaternion_from_axis_angle(axis_angle: Float[Array, "*b 3"]) -> Float[Array, "*b 4"]:
    """Unit quaternion of an axis-angle vector: (v sin(t/2)/t, cos(t/2))."""
    v = np.asarray(axis_angle, np.float64)
    t2 = np.sum(v * v, -1)
    near_zero = t2 < 1e-4
    t = np.sqrt(np.where(near_zero, 1.0, t2))
    scale = np.where(near_zero, 0.5 - t2 / 48 + t2 * t2 / 3840, np.sin(0.5 * t) / t)
    w = np.where(near_zero, 1 - t2 / 8 + t2 * t2 / 384, np.cos(0.5 * t))
    return np.concatenate([v * scale[..., None], w[..., None]], -1)


def axis_angle_from_quaternion(quaternion: Float[Array, "*b 4"]) -> Float[Array, "*b 3"]:
    """Axis-angle vector of a unit quaternion, of length at most pi.

    atan2 of vector and scalar part keeps all digits at 0 and at pi, where arccos of w loses half of them.
    """
    q = normalised_quaternion(quaternion)
    q = np.where(q[..., 3:] < 0, -q, q)
    s = np.linalg.norm(q[..., :3], axis=-1)
    near_zero = s < 1e-8
    angle = 2 * np.arctan2(s, q[..., 3])
    scale = np.where(near_zero, 2.0, angle / np.where(near_zero, 1.0, s))
    return q[..., :3] * scale[..., None]


def quaternion_from_matrix(matrix: Float[Array, "*b 3 3"]) -> Float[Array, "*b 4"]:
    """Unit quaternion of a rotation matrix, w >= 0 (Shepperd 1978: divide by the largest component)."""
    m = np.asarray(matrix, np.float64)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    xy, yz, zx = m[..., 1, 0] + m[..., 0, 1], m[..., 2, 1] + m[..., 1, 2], m[..., 0, 2] + m[..., 2, 0]
    xw, yw, zw = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    # 4 q q^T: each row is the quaternion, times four times one of its numbers
    rows = [
        1 + xx - yy - zz, xy, zx, xw,
        xy, 1 - xx + yy - zz, yz, yw,
        zx, yz, 1 - xx - yy + zz, zw,
        xw, yw, zw, 1 + xx + yy + zz,
    ]  # fmt: skip
    candidates = np.stack(rows, -1).reshape(*m.shape[:-2], 4, 4)
    best = np.argmax(np.stack([xx, yy, zz, xx + yy + zz], -1), -1)
    q = np.take_along_axis(candidates, best[..., None, None], -2)[..., 0, :]
    q = normalised_quaternion(q)
    return np.where(q[..., 3:] < 0, -q, q)


def matrix_from_quaternion(quaternion: Float[Array, "*b 4"]) -> Float[Array, "*b 3 3"]:
    """Rotation matrix of a quaternion of any non-zero length."""
    x, y, z, w = np.moveaxis(normalised_quaternion(quaternion), -1, 0)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(rows, -1).reshape(*np.shape(quaternion)[:-1], 3, 3)


def axis_angle_from_matrix(matrix: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """Axis-angle vector of a rotation matrix, of length at most pi."""
    return axis_angle_from_quaternion(quaternion_from_matrix(matrix))


def normalised_quaternion(quaternion: Float[Array, "*b 4"]) -> Float[Array, "*b 4"]:
    """Quaternion scaled to length one.

    Raises:
        ValueError: a quaternion is zero or not finite; it has no direction to keep.
    """
    q = np.asarray(quaternion, np.float64)
    largest = np.max(np.abs(q), -1, keepdims=True)  # scaling first keeps 1e-200 and 1e200 from under- or overflow
    if not np.all(np.isfinite(largest)) or not np.all(largest > 0):
        raise ValueError("a quaternion is zero or not finite")
    q = q / largest
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def quaternion_product(a: Float[Array, "*b 4"], b: Float[Array, "*b 4"]) -> Float[Array, "*b 4"]:
    """The quaternion of rotation a after rotation b: R(a b) = R(a) R(b)."""
    a, b = np.broadcast_arrays(np.asarray(a, np.float64), np.asarray(b, np.float64))
    av, aw, bv, bw = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    vector = aw * bv + bw * av + np.cross(av, bv)
    scalar = aw * bw - np.sum(av * bv, -1, keepdims=True)
    return np.concatenate([vector, scalar], -1)


def quaternion_inverse(quaternion: Float[Array, "*b 4"]) -> Float[Array, "*b 4"]:
    return np.asarray(quaternion, np.float64) * np.array([-1.0, -1, -1, 1])


def slerp(a: Float[Array, "*b 4"], b: Float[Array, "*b 4"], t: Float[Array, "*b"] | float) -> Float[Array, "*b 4"]:
    """Constant-speed interpolation from a (t = 0) to b (t = 1) on the shorter arc (Shoemake 1985).

    The angle comes from atan2(|a - b|, |a + b|), exact for nearly equal and nearly opposite rotations alike;
    below 1e-7 rad the weights become linear. For exactly opposite quaternions b = -a the rotations are equal.
    """
    a, b = normalised_quaternion(a), normalised_quaternion(b)
    b = np.where(np.sum(a * b, -1, keepdims=True) < 0, -b, b)
    half = np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    angle = 2 * half
    t = np.asarray(t, np.float64)
    small = angle < 1e-7
    sine = np.sin(np.where(small, 1.0, angle))
    wa = np.where(small, 1 - t, np.sin((1 - t) * angle) / sine)
    wb = np.where(small, t, np.sin(t * angle) / sine)
    return normalised_quaternion(wa[..., None] * a + wb[..., None] * b)


def rotation_part_way(
    a: Float[Array, "*b 3 3"], b: Float[Array, "*b 3 3"], part: Float[Array, "*b"] | float
) -> Float[Array, "*b 3 3"]:
    """The rotation a part of the way from a to b, by `slerp`."""
    return matrix_from_quaternion(slerp(quaternion_from_matrix(a), quaternion_from_matrix(b), part))


def between(a: Float[Array, "*b 3"], b: Float[Array, "*b 3"], part: Float[Array, "*b"] | float) -> Float[Array, "*b 3"]:
    """The vector of the rotation a share `part` of the way from a to b, on the shorter arc."""
    return axis_angle_from_quaternion(slerp(quaternion_from_axis_angle(a), quaternion_from_axis_angle(b), part))


def nearest_rotation(matrix: Float[Array, "*b 3 3"]) -> Float[Array, "*b 3 3"]:
    """The rotation R nearest to a matrix, never a mirror: min |R - M|^2 (Kabsch 1976).

    Of M = sum_i b_i a_i^T it is the one for which R a_i lies nearest to b_i, both about their means.
    """
    u, _, vt = np.linalg.svd(np.asarray(matrix, np.float64))
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]
    return u @ vt


def rotation_between(a: Float[Array, "*b 3"], b: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """The smallest rotation that takes unit vector a to unit vector b.

    Opposite vectors have no smallest rotation: a half turn about some axis orthogonal to a is returned.
    """
    a, b = np.broadcast_arrays(np.asarray(a, np.float64), np.asarray(b, np.float64))
    cross = np.cross(a, b)
    sine, cosine = np.linalg.norm(cross, axis=-1, keepdims=True), np.sum(a * b, -1, keepdims=True)
    least = np.eye(3)[np.argmin(np.abs(a), -1)]
    orthogonal = np.cross(a, least)
    orthogonal = orthogonal / np.linalg.norm(orthogonal, axis=-1, keepdims=True)
    usable = sine > 1e-12
    axis = np.where(usable, cross / np.where(usable, sine, 1.0), orthogonal)
    return matrix_from_axis_angle(axis * np.arctan2(sine, cosine))


def unit_or_zero(v: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Unit vectors; those without length stay 0."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(length > 0, length, 1)


def left_up_frame(left: Float[Array, "*b 3"], up: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Rotations with columns left, up, forward; up is kept, left made square to it."""
    up = unit_or_zero(up)
    left = unit_or_zero(left - up * np.sum(left * up, -1, keepdims=True))
    return np.stack([left, up, np.cross(left, up)], -1)


def palm_frame(along: Float[Array, "*b 3"], across: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Rotations with x from the wrist to the middle finger (`along`) and z towards the forefinger's side (`across`)."""
    x = unit_or_zero(along)
    z = unit_or_zero(across - x * np.sum(x * across, -1, keepdims=True))
    return np.stack([x, np.cross(z, x), z], -1)


def affine(A: Float[Array, "*b 3 3"], t: Float[Array, "*b 3"]) -> Float[Array, "*b 4 4"]:
    """The transform x -> A x + t."""
    out = np.zeros((*A.shape[:-2], 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = A, t, 1
    return out


def fibonacci_sphere(count: int) -> Float[Array, "count 3"]:
    """Unit directions spread evenly over the sphere (the golden spiral)."""
    i = np.arange(count) + 0.5
    y, angle = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(angle), y, r * np.sin(angle)], 1)


def axis_name(direction: Float[Array, "3"]) -> str:
    """ "+x", "-z" ...: the axis that a direction lies along."""
    axis = int(np.argmax(np.abs(direction)))
    return "+-"[int(direction[axis] < 0)] + "xyz"[axis]


def turned(axis_angle: Float[Array, "*b 3"], turn: Float[Array, "4"]) -> Float[Array, "*b 3"]:
    """Each rotation followed by `turn`, a quaternion."""
    q = quaternion_from_axis_angle(axis_angle)
    return axis_angle_from_quaternion(quaternion_product(np.broadcast_to(turn, q.shape), q))
