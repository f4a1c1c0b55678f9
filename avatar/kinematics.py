"""A pose in one frame, and how points and pixels move with pose and shape: the Jacobians of every fit.

Increments d turn joints in their own frames (R_j exp d_j) and shift the root. Where joint angles are the unknowns, a
change of the angles is such a turn to first order. avatar/limits.py has them: R = exp(s) exp(t e_t), s = f e_f + a e_a,

    d = exp(-t e_t) J(s) (df e_f + da e_a) + dt e_t        J(s) = I - (1 - cos |s|)/|s|^2 K + (|s| - sin |s|)/|s|^3 K^2
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.camera import Camera
from avatar.limits import axis_angle_from_joint_angles, limits
from avatar.rotation import affine, axis_angle_from_matrix, cross_matrix, matrix_from_axis_angle
from avatar.skeleton import BIG_POSE, DEPTHS, DESCENDS, PARENTS, joint_transforms
from avatar.skinning import SkinWeights

# metres: what lies nearer to a camera, or behind it, is projected as if it lay there
NEAREST = 0.05


class ShapedSkeleton(NamedTuple):
    """Bones in the rest pose, and how they change with shape."""

    joints: Float[Array, "52 3"]
    directions: Float[Array, "52 3 g"]


class Posed(NamedTuple):
    """One frame, or many: where each bone is and what turns it."""

    R: Float[Array, "*f 52 3 3"]  # world from rest pose
    place: Float[Array, "*f 52 3"]  # world; the joints'
    # what each of a joint's three unknowns turns, world
    axes: Float[Array, "*f 52 3 3"]
    # how the joints' places move with shape
    shift: Float[Array, "*f 52 3 g"]
    skeleton: ShapedSkeleton

    @property
    def each(self) -> list["Posed"]:
        return [Posed(*frame, self.skeleton) for frame in zip(self.R, self.place, self.axes, self.shift)]

    @property
    def transforms(self) -> Float[Array, "*f 52 4 4"]:
        """Where each bone takes points of the rest pose."""
        return affine(self.R, self.place - np.einsum("...kij,kj->...ki", self.R, self.skeleton.joints))


def posed(
    skeleton: ShapedSkeleton, root: Float[Array, "*f 3"], heading: Float[Array, "*f 3 3"],
    angles: Float[Array, "*f 52 3"],
) -> Posed:  # fmt: skip
    """Forward kinematics of joint angles with derivatives, rest pose 0; `heading` is the pelvis's rotation.

    angles[..., 0, :] is not used: the pelvis's unknowns are increments.
    """
    local = matrix_from_axis_angle(axis_angle_from_joint_angles(angles))
    local[..., 0, :, :] = heading
    joints, directions = skeleton
    R, place, shift = local.copy(), np.zeros_like(angles), np.zeros((*angles.shape[:-2], *directions.shape))
    place[..., 0, :] = root
    for level in DEPTHS:
        up = PARENTS[level]
        R[..., level, :, :] = R[..., up, :, :] @ local[..., level, :, :]
        place[..., level, :] = place[..., up, :] + np.einsum(
            "...kij,kj->...ki", R[..., up, :, :], joints[level] - joints[up]
        )
        shift[..., level, :, :] = shift[..., up, :, :] + R[..., up, :, :] @ (directions[level] - directions[up])
    axes = turns(angles)
    axes[..., 0, :, :] = np.eye(3)
    return Posed(R, place, R @ axes, shift, skeleton)


def posed_canonical(
    axis_angle: Float[Array, "52 3"], joints: Float[Array, "52 3"], root: Float[Array, "3"],
    rest: Float[Array, "52 3"] = BIG_POSE,
) -> Posed:  # fmt: skip
    """Forward kinematics of points given in the pose `rest`, under a pose whose unknowns are increments.

    `joints` lie as in pose 0, metres; shape is not free.
    """
    G, given = joint_transforms(axis_angle, joints, root), joint_transforms(rest, joints)
    R, nothing = G[:, :3, :3] @ np.swapaxes(given[:, :3, :3], 1, 2), np.zeros((52, 3, 0))
    return Posed(R, G[:, :3, 3], G[:, :3, :3], nothing, ShapedSkeleton(given[:, :3, 3], nothing))


class SkinnedPoints(NamedTuple):
    """Points in the rest pose, the bones they follow, and how they change with shape."""

    rest: Float[Array, "n 3"]
    directions: Float[Array, "n 3 g"]
    joints: Int[Array, "n s"]
    weights: Float[Array, "n s"]


def _carried(frame: Posed, points: SkinnedPoints) -> Float[Array, "*f n s 3"]:
    """Where each bone alone takes each point."""
    k = points.joints
    arm = points.rest[:, None] - frame.skeleton.joints[k]
    return (frame.R[..., k, :, :] @ arm[..., None])[..., 0] + frame.place[..., k, :]


def skinned(frame: Posed, points: SkinnedPoints) -> Float[Array, "*f n 3"]:
    return np.einsum("ns,...nsi->...ni", points.weights, _carried(frame, points))


def pose_rows(
    frame: Posed, points: SkinnedPoints, c: Float[Array, "*f n 3"], moving: Int[Array, "m"]
) -> Float[Array, "*f n p"]:
    """Derivative of c . x to the root (3) and the unknowns of the `moving` joints (3 each).

    dx / d unknown_ji = axis_ji x sum_k w_k [k hangs from j] (x_k - place_j)
    """
    hangs = DESCENDS[points.joints][:, :, moving] * points.weights[:, :, None]
    arm = np.swapaxes(hangs, 1, 2) @ _carried(frame, points)
    arm -= hangs.sum(1)[:, :, None] * frame.place[..., None, moving, :]
    # (a x r) . c = a . (r x c)
    x, y, z = np.moveaxis(arm, -1, 0)
    cx, cy, cz = np.moveaxis(c[..., None, :], -1, 0)
    turn = np.stack([y * cz - z * cy, z * cx - x * cz, x * cy - y * cx], -1)
    rows = (turn[..., None, :] @ frame.axes[..., None, moving, :, :])[..., 0, :]
    return np.concatenate([c, rows.reshape(*c.shape[:-1], 3 * len(moving))], -1)


def increment_rows(
    frame: Posed, rest: Float[Array, "n 3"], skin: SkinWeights, c: Float[Array, "n 3"], moving: Int[Array, "m"]
) -> Float[Array, "n p"]:
    """`pose_rows` of points whose shape is known."""
    return pose_rows(frame, SkinnedPoints(rest, np.zeros((len(rest), 3, 0)), skin.joints, skin.weights), c, moving)


def shape_rows(frame: Posed, points: SkinnedPoints, c: Float[Array, "*f n 3"]) -> Float[Array, "*f n g"]:
    """Derivative of c . x to the shape: x = sum_k w_k (R_k (v - J_k) + place_k)."""
    k, every, g = points.joints, np.arange(len(points.joints)), points.directions.shape[2]
    back = (np.swapaxes(frame.R[..., k, :, :], -1, -2) @ c[..., None, :, None])[..., 0] * points.weights[..., None]
    rows = (back.sum(-2)[..., None, :] @ points.directions)[..., 0, :]
    # sums over bones: each point has few, all bones are few
    of_bone, weight = np.zeros((*c.shape[:-1], 52, 3)), np.zeros((len(k), 52))
    for slot in range(k.shape[1]):
        of_bone[..., every, k[:, slot], :] += back[..., slot, :]
        weight[every, k[:, slot]] += points.weights[:, slot]
    rows -= of_bone.reshape(*c.shape[:-1], 156) @ frame.skeleton.directions.reshape(156, g)
    moved = (weight[:, :, None] * c[..., None, :]).reshape(*c.shape[:-1], 156)
    return rows + moved @ frame.shift.reshape(*c.shape[:-2], 156, g)


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


def turned(R: Float[Array, "*m 3 3"], increments: Float[Array, "*m 3"]) -> Float[Array, "*m 3 3"]:
    """Rotations after increments in their own frames: R exp d."""
    return R @ matrix_from_axis_angle(increments)


def second_turns(
    R: Float[Array, "frames m 3 3"],
) -> tuple[Float[Array, "inner m 3"], list[Float[Array, "inner m 3 3"]]]:
    """Second differences of rotations in time, and their derivatives to the increments of three frames each.

    a_f = v_f - v_(f-1), v_f = log(R_f^T R_(f+1)): an increment d_f turns v_f by -R_(f,f+1)^T d_f and v_(f-1) by d_f.
    """
    between = np.swapaxes(R[:-1], -1, -2) @ R[1:]
    v = axis_angle_from_matrix(between)
    back = np.swapaxes(between, -1, -2)
    eye = np.broadcast_to(np.eye(3), back[1:].shape)
    return v[1:] - v[:-1], [back[:-1], -back[1:] - eye, eye]


def pixel_rows(
    camera: Camera, points: Float[Array, "*f n 3"]
) -> tuple[Float[Array, "*f n 2"], Float[Array, "*f n 2 3"]]:
    """Pixels of world points, and their derivative to the points; lens distortion left out."""
    R = camera.camera_from_world[:3, :3]
    x, y, z = np.moveaxis(points @ R.T + camera.camera_from_world[:3, 3], -1, 0)
    z = np.maximum(z, NEAREST)
    o = np.zeros_like(z)
    fx, fy, skew = camera.K[0, 0], camera.K[1, 1], camera.K[0, 1]
    rows = np.stack([np.stack([fx / z, skew / z, -(fx * x + skew * y) / z**2], -1),
                     np.stack([o, fy / z, -fy * y / z**2], -1)], -2)  # fmt: skip
    return camera.K[:2, 2] + np.stack([(fx * x + skew * y) / z, fy * y / z], -1), rows @ R
