"""Body and finger poses from points in space, as detectors of landmarks give them: 33 of the body, 21 of each hand.

Points say where a bone leads, not how it is turned about itself. What decides the turn:

    pelvis, chest   the line of the hips, of the shoulders, and the way between them; the spine in between evenly
    head            eyes, ears, nose and mouth, laid over those of a face (least squares; Kabsch 1976)
    thigh, arm      the plane in which knee or elbow bends, fully from a bend of 30 degrees on; below 10 the turn that
                    the limb has when it swings out of the trunk the shortest way
    foot            heel to toe, rolled with the knee
    hand            its own palm (wrist, forefinger, middle and little finger); without it the hand is straight
    forearm         shares the turn of the hand evenly with the wrist
    fingers         bending and spreading within the joints' limits (avatar/limits.py); no turn about themselves

All points are in our axes (y up); lengths do not matter. Limbs' directions are kept exactly, wrists and fingers as
far as the limits let them.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.limits import axis_angle_from_joint_angles, clamped_angles, joint_angles, limits
from avatar.motion.fingers import FINGERS
from avatar.motion.mhr_rig import ELBOW_SHARE, rest_palm, twist_about
from avatar.motion.rest_pose import hinge
from avatar.rotation import (
    axis_angle_from_matrix,
    left_up_frame,
    matrix_from_axis_angle,
    nearest_rotation,
    palm_frame,
    rotation_between,
    rotation_part_way,
    unit_or_zero,
)
from avatar.skeleton import JOINT_NUMBERS as J
from avatar.skeleton import LEFT_HAND, RIGHT_HAND, pose_of_rotations

BODY_POINTS, HAND_POINTS = 33, 21
# MediaPipe's numbers of the body's points: the left one, the right one
PAIRS = {"shoulder": (11, 12), "elbow": (13, 14), "wrist": (15, 16), "hip": (23, 24), "knee": (25, 26),
         "ankle": (27, 28), "heel": (29, 30), "toe": (31, 32)}  # fmt: skip
# nose, left and right eye, left and right ear, left and right corner of the mouth; metres from the tip of the nose
FACE = (0, 2, 5, 7, 8, 9, 10)
FACE_AT_REST = np.array([
    [0, 0, 0], [0.034, 0.036, -0.03], [-0.034, 0.036, -0.03], [0.078, 0.005, -0.115], [-0.078, 0.005, -0.115],
    [0.025, -0.035, -0.015], [-0.025, -0.035, -0.015]])  # fmt: skip
# a hand's points: wrist 0, then four a finger from the thumb
HAND_STARTS = {"thumb": 1, "index": 5, "middle": 9, "ring": 13, "pinky": 17}
# sines of a bend: below the first it says nothing of the hinge, above the second everything
BENDS = (np.sin(np.radians(10)), np.sin(np.radians(30)))


class Points(NamedTuple):
    """What was seen, in our axes; NaN where nothing was."""

    body: Float[Array, "frames 33 3"]
    left_hand: Float[Array, "frames 21 3"]
    right_hand: Float[Array, "frames 21 3"]
    # which of the body's 33 points are seen
    seen: Bool[Array, "33"]


def pose_from_points(points: Points, ours: Float[Array, "52 3"]) -> Float[Array, "frames 52 3"]:
    """Axis-angle vectors of all joints for a skeleton with these rest places.

    Frames without a body are in T-pose, hands that are not there straight; limbs whose ends are not `seen` hang as in
    T-pose on what carries them.
    """
    R = np.tile(np.eye(3), (len(points.body), 52, 1, 1))
    there = np.asarray(np.isfinite(points.body).all((1, 2)))
    if there.any():
        R[there] = _body(points.body[there], ours, points.seen)
    for side, hand, fingers in (("left", points.left_hand, LEFT_HAND), ("right", points.right_hand, RIGHT_HAND)):
        R[:, J[f"{side}_wrist"]] = R[:, J[f"{side}_elbow"]]
        R[:, fingers] = R[:, J[f"{side}_elbow"], None]
        held = np.isfinite(hand).all((1, 2))
        if bool(np.any(held)):
            with_hand = R[held]
            _hand(with_hand, hand[held], side, ours, carried=there[held])
            R[held] = with_hand
    return pose_of_rotations(R)


def curl_sign(hand: Float[Array, "frames 21 3"]) -> float:
    """Which side the fingers bend to, as a right hand's or (negative) a left hand's; near 0 for straight fingers.

    Mean, over fingers and frames, of what the way from knuckle to tip has along the palm's normal, in lengths of the
    palm; the normal is that which points out of the palm of a left hand.
    """
    normal = np.cross(hand[:, 5] - hand[:, 0], hand[:, 17] - hand[:, 0])
    length = np.linalg.norm(hand[:, 9] - hand[:, 0], axis=-1, keepdims=True)
    tips = (hand[:, [8, 12, 16, 20]] - hand[:, [5, 9, 13, 17]]) / np.where(length > 0, length, 1)[:, None]
    # the fingers' mean, so that one that is bent aside does not decide
    return float(np.mean(np.sum(tips * unit_or_zero(normal)[:, None], -1)))


def _body(P: Float[Array, "frames 33 3"], ours: Array, seen: Bool[Array, "33"]) -> Float[Array, "frames 52 3 3"]:
    """World rotations of the 22 joints of the body; fingers stay as the identity."""
    at = {name: (P[:, left], P[:, right]) for name, (left, right) in PAIRS.items()}
    rest = {name: (ours[J[f"left_{name}"]], ours[J[f"right_{name}"]]) for name in ("hip", "shoulder")}
    up, rest_up = (np.mean(pair["shoulder"], axis=0) - np.mean(pair["hip"], axis=0) for pair in (at, rest))

    def trunk(name: str) -> Array:
        seen = left_up_frame(at[name][0] - at[name][1], up)
        return seen @ left_up_frame(rest[name][0] - rest[name][1], rest_up).T

    R = np.tile(np.eye(3), (len(P), 52, 1, 1))
    bottom, top = trunk("hip"), trunk("shoulder")
    R[:, 0], R[:, J["spine3"]] = bottom, top
    for name, part in (("spine1", 1 / 3), ("spine2", 2 / 3)):
        R[:, J[name]] = rotation_part_way(bottom, top, part)
    R[:, J["head"]] = top
    if seen[list(FACE)].all():
        # the rotation that lays a face at rest best over the points
        face = P[:, FACE] - P[:, FACE].mean(1, keepdims=True)
        R[:, J["head"]] = nearest_rotation(np.swapaxes(face, -1, -2) @ (FACE_AT_REST - FACE_AT_REST.mean(0)))
    R[:, J["neck"]] = rotation_part_way(top, R[:, J["head"]], 0.5)
    for n, side in enumerate(("left", "right")):
        R[:, J[f"{side}_collar"]] = top
        for chain, base in ((("hip", "knee", "ankle"), bottom), (("shoulder", "elbow", "wrist"), top)):
            names = [f"{side}_{name}" for name in chain]
            upper, lower = (ours[J[b]] - ours[J[a]] for a, b in zip(names, names[1:], strict=False))
            ways = [at[b][n] - at[a][n] for a, b in zip(chain, chain[1:], strict=False)]
            have = [bool(seen[PAIRS[name][n]]) for name in chain]
            first, second = _limb(base, (upper, lower), ways, hinge(names[0]), have=have, one_sided=chain[0] == "hip")
            R[:, J[names[0]]], R[:, [J[name] for name in names[1:]]] = first, second[:, None]
        ankle, foot = J[f"{side}_ankle"], J[f"{side}_foot"]
        if seen[[PAIRS["heel"][n], PAIRS["toe"][n]]].all():
            way = at["toe"][n] - at["heel"][n]
            across = R[:, J[f"{side}_knee"], :, 0]
            R[:, ankle] = left_up_frame(across, way) @ left_up_frame(np.array([1.0, 0, 0]), np.array([0, 0, 1.0])).T
        R[:, foot] = R[:, ankle]
    return R


def _limb(
    base: Float[Array, "frames 3 3"], bones: tuple[Float[Array, "3"], Float[Array, "3"]],
    ways: list[Float[Array, "frames 3"]], axis: Float[Array, "3"], *, have: list[bool], one_sided: bool,
) -> tuple[Float[Array, "frames 3 3"], Float[Array, "frames 3 3"]]:  # fmt: skip
    """World rotations of the upper and the lower bone of an arm or a leg.

    `axis` is the limb's hinge. `one_sided`: what bends against it is noise (knees), rather than a limb that is turned
    half round (arms).
    """
    if not (have[0] and have[1]):
        return base, base
    upper, lower = (unit_or_zero(way) for way in ways)
    first = rotation_between(base @ unit_or_zero(bones[0]), upper) @ base
    if not have[2]:
        return first, first
    bend = np.cross(upper, lower)
    sine = np.linalg.norm(bend, axis=-1)
    swung = first @ axis
    swung = unit_or_zero(swung - upper * np.sum(swung * upper, -1, keepdims=True))
    angle = np.arctan2(np.sum(np.cross(swung, bend) * upper, -1), np.sum(swung * bend, -1))
    weight = np.clip((sine - BENDS[0]) / (BENDS[1] - BENDS[0]), 0, 1)
    # a folded limb has a small sine as well
    weight = np.where(np.sum(upper * lower, -1) < 0, 1.0, weight) * (sine > 1e-6)
    if one_sided:
        weight = np.where(np.abs(angle) > np.pi / 2, 0.0, weight)
    first = matrix_from_axis_angle(upper * (weight * angle)[:, None]) @ first
    return first, rotation_between(first @ unit_or_zero(bones[1]), lower) @ first


def _hand(
    R: Array, hand: Float[Array, "frames 21 3"], side: str, ours: Array, *, carried: Bool[Array, "frames"]
) -> None:
    """Turn wrist, forearm and fingers as the hand's points say; in place.

    Hands that no body carries keep their wrist straight.
    """
    wrist, elbow = J[f"{side}_wrist"], J[f"{side}_elbow"]
    starts = HAND_STARTS
    palm = palm_frame(hand[:, starts["middle"]] - hand[:, 0], hand[:, starts["index"]] - hand[:, starts["pinky"]])
    turned = palm @ rest_palm(ours, side).T
    bone = unit_or_zero(ours[wrist] - ours[elbow])
    relative = np.swapaxes(R[:, elbow], -1, -2) @ turned
    twist = twist_about(relative, bone) * carried
    R[:, elbow] = R[:, elbow] @ matrix_from_axis_angle(ELBOW_SHARE * twist[:, None] * bone)
    local = _limited(np.swapaxes(R[:, elbow], -1, -2) @ turned, wrist)
    # the fingers are seen from the palm as it was, whatever the wrist's limits make of it
    R[:, wrist] = np.where(carried[:, None, None], R[:, elbow] @ local, R[:, elbow])
    for finger in FINGERS:
        base, start = turned, starts[finger]
        mine = R[:, wrist]
        for n in (1, 2, 3):
            joint = J[f"{side}_{finger}{n}"]
            way = np.swapaxes(base, -1, -2) @ unit_or_zero(hand[:, start + n] - hand[:, start + n - 1])[..., None]
            begin = J[f"{side}_{finger}{min(n, 2)}"]
            rest = np.broadcast_to(unit_or_zero(ours[begin + 1] - ours[begin]), (len(R), 3))
            local = _limited(rotation_between(rest, way[..., 0]), joint, twist=0.0)
            base, mine = base @ local, mine @ local
            R[:, joint] = mine


def _limited(R: Float[Array, "frames 3 3"], joint: int, *, twist: float = 1.0) -> Float[Array, "frames 3 3"]:
    """Rotations of one joint inside its limits, and so much of its twist.

    Each angle is cut by itself first, so that a finger seen bent aside stays bent forward.
    """
    pose, table = np.zeros((len(R), 52, 3)), limits()
    pose[:, joint] = axis_angle_from_matrix(R)
    angles = joint_angles(pose)
    angles[:, joint, 2] *= twist
    inside = clamped_angles(np.clip(angles, table.low, table.high))
    return matrix_from_axis_angle(axis_angle_from_joint_angles(inside))[:, joint]
