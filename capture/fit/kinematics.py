"""A person posed in one frame, and how its points move with pose and shape: the Jacobians of the fit.

World of the fit: the camera at the origin, looking along -z, +y up, metres.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from avatar.skeleton import DEPTHS, PARENTS
from capture.fit.joint_turns import rotations, turns
from capture.repair.increments import DESCENDS

Array = np.ndarray


class Skeleton(NamedTuple):
    """A person's bones in pose 0, and how they change with shape."""

    joints: Float[Array, "52 3"]
    directions: Float[Array, "52 3 g"]


class Posed(NamedTuple):
    """One frame: where each bone is and what turns it."""

    R: Float[Array, "52 3 3"]  # world_from_joint
    place: Float[Array, "52 3"]  # of the joints, world
    # what each of a joint's three angles turns, world; the pelvis: increments in its own frame
    axes: Float[Array, "52 3 3"]
    # how the joints' places move with shape
    shift: Float[Array, "52 3 g"]
    skeleton: Skeleton


def posed(
    skeleton: Skeleton, root: Float[Array, "3"], heading: Float[Array, "3 3"], angles: Float[Array, "52 3"]
) -> Posed:
    """Forward kinematics with derivatives; `heading` is the pelvis's rotation, angles[0] is not used."""
    local = rotations(angles)
    local[0] = heading
    joints, directions = skeleton
    R, place, shift = local.copy(), np.zeros((52, 3)), np.zeros_like(directions)
    place[0] = root
    for level in DEPTHS:
        up = PARENTS[level]
        R[level] = R[up] @ local[level]
        place[level] = place[up] + np.einsum("kij,kj->ki", R[up], joints[level] - joints[up])
        shift[level] = shift[up] + R[up] @ (directions[level] - directions[up])
    axes = turns(angles)
    axes[0] = np.eye(3)
    return Posed(R, place, R @ axes, shift, skeleton)


class SkinnedPoints(NamedTuple):
    """Points in pose 0, the bones they follow, and how they change with shape."""

    rest: Float[Array, "n 3"]
    directions: Float[Array, "n 3 g"]
    joints: Int[Array, "n s"]
    weights: Float[Array, "n s"]


def carried(frame: Posed, points: SkinnedPoints) -> Float[Array, "n s 3"]:
    """Where each bone alone takes each point."""
    k = points.joints
    arm = points.rest[:, None] - frame.skeleton.joints[k]
    return np.einsum("nsij,nsj->nsi", frame.R[k], arm) + frame.place[k]


def skinned(points: SkinnedPoints, by_bone: Float[Array, "n s 3"]) -> Float[Array, "n 3"]:
    """Posed points: the blend of what `carried` says."""
    return np.einsum("ns,nsi->ni", points.weights, by_bone)


def pose_rows(
    frame: Posed, points: SkinnedPoints, by_bone: Float[Array, "n s 3"], c: Float[Array, "n 3"], moving: Int[Array, "m"]
) -> Float[Array, "n p"]:
    """Derivative of c . x to root (3), pelvis (3) and the angles of the `moving` joints (3 each).

    dx / d angle_ji = axis_ji x sum_k w_k [k hangs from j] (x_k - place_j)
    """
    joints = np.concatenate([[0], moving])
    hangs = DESCENDS[points.joints][:, :, joints] * points.weights[:, :, None]
    arm = np.einsum("nsm,nsi->nmi", hangs, by_bone) - hangs.sum(1)[:, :, None] * frame.place[joints]
    # (a x r) . c = a . (r x c)
    turn = np.cross(arm, c[:, None])
    rows = np.einsum("nmi,mij->nmj", turn, frame.axes[joints])
    return np.concatenate([c, rows.reshape(len(c), 3 * len(joints))], 1)


def shape_rows(frame: Posed, points: SkinnedPoints, c: Float[Array, "n 3"]) -> Float[Array, "n g"]:
    """Derivative of c . x to the shape: x = sum_k w_k (R_k (v - J_k) + place_k)."""
    k = points.joints
    back = np.einsum("nsij,ni,ns->nsj", frame.R[k], c, points.weights)
    rows = np.einsum("nj,njg->ng", back.sum(1), points.directions)
    # sums over bones: each point has few, all bones are few
    of_bone = np.zeros((len(c), 52, 3))
    np.add.at(of_bone, (np.arange(len(c))[:, None], k), back)
    rows -= of_bone.reshape(len(c), 156) @ frame.skeleton.directions.reshape(156, points.directions.shape[2])
    weight = np.zeros((len(c), 52))
    np.add.at(weight, (np.arange(len(c))[:, None], k), points.weights)
    moved = (weight[:, :, None] * c[:, None]).reshape(len(c), 156)
    return rows + moved @ frame.shift.reshape(156, points.directions.shape[2])


class Lens(NamedTuple):
    """The camera of a video: square pixels, its axis through the middle of the picture."""

    focal: float  # pixels
    centre: Float[Array, "2"]  # pixels


def seen_at(lens: Lens, x: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
    """Pixels of points before the camera."""
    depth = np.maximum(-x[:, 2], 0.05)
    return lens.centre + lens.focal * np.stack([x[:, 0], -x[:, 1]], 1) / depth[:, None]


def pixel_rows(lens: Lens, x: Float[Array, "n 3"]) -> Float[Array, "n 2 3"]:
    """Derivative of the pixel to the point."""
    depth = np.maximum(-x[:, 2], 0.05)
    u, v, o = x[:, 0] / depth, -x[:, 1] / depth, np.zeros(len(x))
    one = 1 / depth
    rows = np.stack([np.stack([one, o, u * one], 1), np.stack([o, -one, v * one], 1)], 1)
    return lens.focal * rows
