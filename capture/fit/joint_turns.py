"""Joint angles as unknowns: the rotation that they make, and how it turns when they change.

avatar/limits.py has the three angles of a joint: R = exp(s) exp(t e_t), s = f e_f + a e_a. To first order a change of
the angles is a turn d of the joint in its own frame, R exp(d):

    d = exp(-t e_t) J(s) (df e_f + da e_a) + dt e_t        J(s) = I - (1 - cos |s|)/|s|^2 K + (|s| - sin |s|)/|s|^3 K^2
"""

import numpy as np
from jaxtyping import Float

from avatar.limits import limits
from avatar.rotation import cross_matrix, matrix_from_axis_angle

Array = np.ndarray


def rotations(angles: Float[Array, "*b 52 3"]) -> Float[Array, "*b 52 3 3"]:
    """Local rotation of each joint."""
    axes = limits().axes
    swing = angles[..., :1] * axes[:, 0] + angles[..., 1:2] * axes[:, 1]
    return matrix_from_axis_angle(swing) @ matrix_from_axis_angle(angles[..., 2:] * axes[:, 2])


def turns(angles: Float[Array, "*b 52 3"]) -> Float[Array, "*b 52 3 3"]:
    """Turn of each joint in its own frame by each of its angles: columns f, a, t."""
    axes = limits().axes
    swing = angles[..., :1] * axes[:, 0] + angles[..., 1:2] * axes[:, 1]
    back = matrix_from_axis_angle(-angles[..., 2:] * axes[:, 2])
    of_swing = back @ right_jacobian(swing) @ np.swapaxes(axes[:, :2], 1, 2)
    of_twist = np.broadcast_to(axes[:, 2, :, None], (*of_swing.shape[:-1], 1))
    return np.concatenate([of_swing, of_twist], -1)


def right_jacobian(axis_angle: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """J with exp(v + dv) = exp(v) exp(J dv) to first order (Chirikjian 2011, section 10.6)."""
    t2 = (axis_angle**2).sum(-1)
    near_zero = t2 < 1e-4
    t = np.sqrt(np.where(near_zero, 1.0, t2))
    half = np.sin(0.5 * t) / t
    a = np.where(near_zero, 0.5 - t2 / 24, 2 * half * half)
    b = np.where(near_zero, 1 / 6 - t2 / 120, (t - np.sin(t)) / t**3)
    K = cross_matrix(axis_angle)
    return np.eye(3) - a[..., None, None] * K + b[..., None, None] * (K @ K)
