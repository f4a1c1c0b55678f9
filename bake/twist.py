"""Skin weights for helper joints: bend joints take their share first (bake/bend.py), then what a joint has of a vertex
goes to the one or two twist joints beside its place."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar, Level, TwistSkin
from avatar.bend import BENDS
from avatar.kinematics import DESCENDS
from avatar.skeleton import JOINTS, joint_transforms
from avatar.twist import SEGMENTS, Segment
from bake.bend import bend_skin, fitted_push, with_room

# share of a vertex that other limbs must hold to count for the ends of a segment
NOTICED = 0.1
# percentile of the vertices that others hold, at which a segment's twist begins and ends: stray ones do not count
STRAY = 3.0
# share of a segment's length: twist is never spread over less
LEAST = 0.2


def with_twist(avatar: Avatar) -> Avatar:
    """The avatar with weights for twist and bend joints on all levels.

    Counted for the joints that carry them they are the 52 joints' weights to the last bit. These stay as they are but
    in one row in a hundred, at the shoulders, where the weakest joins the strongest (`with_room`).
    """
    canonical = joint_transforms(avatar.canonical_pose.astype(np.float64), avatar.joint_positions.astype(np.float64))
    levels = tuple(_twisted(level, canonical, avatar.joint_positions) for level in avatar.levels)
    avatar = replace(avatar, levels=levels, bend=np.zeros(len(BENDS)))
    return replace(avatar, bend=fitted_push(avatar))


def _twisted(level: Level, canonical: Float[Array, "52 4 4"], joints_rest: Float[Array, "52 3"]) -> Level:
    """Row by row the same weights, a joint's divided linearly between the twist joints before and behind the vertex.

    The twist runs from where what lies before a segment lets go of the surface to where what lies behind it takes
    hold: there sections turn as one piece. A row that has no slot left gives all to the nearer of the two.
    """
    level = with_room(level)
    joints, weights = bend_skin(level, canonical, joints_rest)
    first_joints, first_weights = joints.copy(), weights.copy()
    number = len(JOINTS)
    for segment in SEGMENTS.values():
        place = _place(level, segment, canonical[:, :3, 3])
        steps = len(segment.shares) - segment.carried
        position = place * steps
        low = np.minimum(np.floor(position).astype(np.int64), steps - 1)
        behind = position - low
        # behind the last of an upper arm or thigh is the joint itself
        bones = np.array([*(number + k for k in range(len(segment.shares))), segment.joint])[: steps + 1]
        for slot in range(4):
            # slots that were given away hold twist joints by now
            rows = np.flatnonzero((first_joints[:, slot] == segment.joint) & (first_weights[:, slot] > 0))
            _divide(joints, weights, rows, slot, bones[low[rows]], bones[low[rows] + 1], behind[rows])
        number += len(segment.shares)
    return replace(level, twist=TwistSkin(joints, weights))


def _divide(
    joints: UInt8[Array, "n 4"], weights: UInt8[Array, "n 4"], rows: Array, slot: int,
    before: Array, after: Array, share: Float[Array, "rows"],
) -> None:  # fmt: skip
    """Give a slot's weight to two bones: the heavier takes the slot, the other the next free one of the row."""
    whole = weights[rows, slot].astype(np.int64)
    second = np.rint(whole * share).astype(np.int64)
    heavy, light = np.maximum(second, whole - second), np.minimum(second, whole - second)
    nearer, farther = np.where(2 * second > whole, after, before), np.where(2 * second > whole, before, after)
    # behind it, so that both are the joint's again when twist joints are folded
    free = (weights[rows] == 0) & (np.arange(4) > slot)
    split = free.any(1) & (light > 0)
    weights[rows, slot] = np.where(split, heavy, whole)
    joints[rows, slot] = nearer
    at = free.argmax(1)[split]
    weights[rows[split], at], joints[rows[split], at] = light[split], farther[split]


def _place(level: Level, segment: Segment, at: Float[Array, "52 3"]) -> Float[Array, "vertices"]:
    """0 to 1 along the part of a segment that twists."""
    along = at[segment.child] - at[segment.joint]
    length2 = float(along @ along)
    if length2 < 1e-12:
        return np.zeros(len(level.positions))
    share = (level.positions.astype(np.float64) - at[segment.joint]) @ along / length2
    held = level.weights.astype(np.float64) / 255
    own = (held * (level.joints == segment.joint)).sum(1)
    behind = (held * DESCENDS[level.joints, segment.child]).sum(1)
    before = 1 - own - behind
    start, end = share[(before > NOTICED) & (own > NOTICED)], share[(behind > NOTICED) & (own > NOTICED)]
    low = float(np.clip(np.percentile(start, 100 - STRAY), 0, 1)) if len(start) else 0.0
    high = float(np.clip(np.percentile(end, STRAY), 0, 1)) if len(end) else 1.0
    if high - low < LEAST:
        middle = float(np.clip(0.5 * (low + high), 0.5 * LEAST, 1 - 0.5 * LEAST))
        low, high = middle - 0.5 * LEAST, middle + 0.5 * LEAST
    return np.clip((share - low) / (high - low), 0, 1)
