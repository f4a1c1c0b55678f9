"""Where a posed body's surface ends: of each bone's skin the points that lie farthest out.

A few thousand points stand for the whole mesh, hair and shoes included: the farthest point of the body along any
direction is one of them to within a few millimetres, in every pose. Ground and cameras are found with them.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar
from avatar.body import Body
from avatar.rotation import fibonacci_sphere
from avatar.skeleton import skin_transforms
from avatar.skinning import SkinWeights

# looked along, for each bone
DIRECTIONS = 128
# frames posed at once
BLOCK = 32
# points looked at at once
CHUNK = 8192


class BodyHull(NamedTuple):
    """The outer points of a body, in the pose it rests in."""

    points: Float[Array, "points 3"]
    skin: SkinWeights
    joints: Float[Array, "52 3"]  # in pose 0, metres
    rest: Float[Array, "52 3"]  # the pose of the points, axis-angle


def hull_of(avatar: Avatar) -> BodyHull:
    """The outer points of an avatar's finest level, which every reading of a file has."""
    level = avatar.levels[0]
    return _hull(level.positions, level.skin, avatar.joint_positions, avatar.canonical_pose)


def body_hull(body: Body) -> BodyHull:
    return _hull(body.vertices, body.skin, body.joints, np.zeros((52, 3)))


def _hull(points: Array, skin: SkinWeights, joints: Array, rest: Array) -> BodyHull:
    points = points.astype(np.float64)
    heaviest, chosen = skin.heaviest, list[Array]()
    for bone in range(52):
        mine = np.flatnonzero(heaviest == bone)
        if len(mine):
            chosen.append(mine[outermost(points[mine], DIRECTIONS)])
    outer = np.concatenate(chosen)
    # float32 weights sum to 1 within 6e-8: 6 cm of a root 1000 km away
    weights = skin.weights[outer].astype(np.float64)
    own = SkinWeights(skin.joints[outer], weights / weights.sum(1, keepdims=True))
    return BodyHull(points[outer], own, joints.astype(np.float64), rest.astype(np.float64))


def posed_hull(
    hull: BodyHull, axis_angle: Float[Array, "frames 52 3"], root: Float[Array, "frames 3"]
) -> Float[Array, "frames points 3"]:
    """The outer points in each frame, in the world: linear blend skinning."""
    out = np.zeros((len(root), len(hull.points), 3))
    for first in range(0, len(root), BLOCK):
        frames = slice(first, first + BLOCK)
        transforms = skin_transforms(axis_angle[frames], hull.joints, root[frames], rest=hull.rest)[..., :3, :]
        # joint by joint: fifty small products are faster than four gathers of thousands of matrices
        for slot in range(4):
            for bone in np.flatnonzero(np.bincount(hull.skin.joints[:, slot], minlength=52)):
                mine = np.flatnonzero(hull.skin.joints[:, slot] == bone)
                weights = hull.skin.weights[mine, slot]
                turned = hull.points[mine] @ np.swapaxes(transforms[:, bone, :, :3], -1, -2)
                out[frames, mine] += weights[:, None] * (turned + transforms[:, bone, None, :, 3])
    return out


def lowest_points(
    hull: BodyHull, axis_angle: Float[Array, "frames 52 3"], root: Float[Array, "frames 3"]
) -> Float[Array, "frames"]:
    """Height of the lowest outer point in each frame: the y of `posed_hull` alone, in an eighth of its time."""
    lowest = np.zeros(len(root))
    points = np.concatenate([hull.points, np.ones((len(hull.points), 1))], 1)
    for first in range(0, len(root), BLOCK):
        frames = slice(first, first + BLOCK)
        up = skin_transforms(axis_angle[frames], hull.joints, root[frames], rest=hull.rest)[..., 1, :]
        # what each bone makes of each point's height, picked by the point's bones
        height = up @ points.T
        picked = np.take_along_axis(height, hull.skin.joints.T[None], 1)
        lowest[frames] = (picked * hull.skin.weights.T).sum(1).min(1)
    return lowest


def outermost(points: Float[Array, "points 3"], directions: int = 512) -> Int[Array, "outer"]:
    """Indices of the points farthest along each of so many directions, spread evenly over the sphere."""
    along = fibonacci_sphere(directions)
    farthest, reached = np.zeros(directions, np.int64), np.full(directions, -np.inf)
    # a film's points by 512 directions would be a gigabyte
    for first in range(0, len(points), CHUNK):
        reach = along @ points[first : first + CHUNK].T
        best = reach.argmax(1)
        value = reach[np.arange(directions), best]
        better = value > reached
        farthest[better], reached[better] = first + best[better], value[better]
    # np.unique would load numpy.ma
    return np.flatnonzero(np.bincount(farthest, minlength=len(points)))
