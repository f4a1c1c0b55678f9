"""Fingers: curl and spread of each, and whole hand shapes by name.

A finger's curl bends its three joints together in the proportions of a closing hand (avatar/motion/fingers.py): 0 is
straight, 1 closed. Its spread turns the first joint away from the middle finger, the thumb's away from the palm,
radians. The thumb can also be opposed: turned about itself so that its pad meets the others.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.limits import axis_angle_from_joint_angles, clamped_angles, joint_angles
from avatar.motion.fingers import FINGERS, JOINT_SHARE
from avatar.skeleton import LEFT_HAND, RIGHT_HAND

Side = Literal["left", "right"]

HANDS: dict[str, slice] = {"left": LEFT_HAND, "right": RIGHT_HAND}
# index, middle, pinky, ring, thumb: which way is away from the middle finger, as the limits count sideways
AWAY = np.array([1.0, 1.0, -1.0, -1.0, 1.0])
CURL_RANGE = (-0.2, 1.15)
SPREAD_RANGE = (-0.35, 0.6)


@dataclass(frozen=True)
class HandShape:
    """A hand described by few numbers; fingers in SMPL+H's order: index, middle, pinky, ring, thumb."""

    curl: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    spread: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    opposition: float | int = 0.0  # the thumb's, radians


PRESETS: dict[str, HandShape] = {
    "flat": HandShape(),
    "relaxed": HandShape((0.24, 0.29, 0.36, 0.33, 0.18), (-0.06, 0.0, -0.12, -0.06, 0.0)),
    "open": HandShape((-0.02, -0.03, -0.02, -0.03, -0.15), (0.16, 0.0, 0.3, 0.15, 0.15)),
    "fist": HandShape((1.06, 1.08, 1.06, 1.08, 0.55), (-0.05, 0.0, -0.1, -0.05, 0.13), 0.23),
    "point": HandShape((0.0, 1.06, 1.06, 1.08, 0.6), (0.0, 0.0, -0.1, -0.05, 0.1), 0.23),
    "peace": HandShape((0.0, 0.0, 1.06, 1.08, 0.75), (0.18, -0.14, -0.1, -0.05, 0.1), 0.25),
    # thumb and forefinger meet within 5 mm on both built-in bodies
    "ok": HandShape((0.65, 0.16, 0.04, 0.1, 0.45), (0.0, 0.0, 0.2, 0.08, 0.36), 0.29),
    "thumbs up": HandShape((1.06, 1.08, 1.06, 1.08, -0.22), (-0.05, 0.0, -0.1, -0.05, 0.0)),
}


def with_hand(axis_angle: Float[Array, "52 3"], side: Side, shape: HandShape) -> Float[Array, "52 3"]:
    """The pose with one hand in this shape, inside the joints' limits."""
    angles = np.zeros((52, 3))
    # finger, joint, (flexion, sideways, twist)
    hand = angles[HANDS[side]].reshape(5, 3, 3)
    hand[:, :, 0] = np.array(shape.curl)[:, None] * JOINT_SHARE
    hand[:, 0, 1] = np.array(shape.spread) * AWAY
    hand[4, 0, 2] = shape.opposition
    out = np.array(axis_angle, np.float64)
    out[HANDS[side]] = axis_angle_from_joint_angles(clamped_angles(angles))[HANDS[side]]
    return out


def hand_shape(axis_angle: Float[Array, "52 3"], side: Side) -> HandShape:
    """The shape nearest to what a hand does: a finger's curl is the least-squares one of its three bends."""
    angles = joint_angles(axis_angle)[HANDS[side]].reshape(5, 3, 3)
    curl = np.sum(angles[:, :, 0] * JOINT_SHARE, 1) / np.sum(JOINT_SHARE**2, 1)
    spread = angles[:, 0, 1] * AWAY
    return HandShape(tuple(float(v) for v in curl), tuple(float(v) for v in spread), float(angles[4, 0, 2]))


def with_finger(
    axis_angle: Float[Array, "52 3"], side: Side, finger: int, *, curl: float | None = None,
    spread: float | None = None, limited: bool = True,
) -> Float[Array, "52 3"]:  # fmt: skip
    """One finger curled anew, or spread, radians; what its joints differ from an even curl stays."""
    joints = np.arange(52)[HANDS[side]].reshape(5, 3)[finger]
    angles, now = joint_angles(axis_angle), hand_shape(axis_angle, side)
    if curl is not None:
        angles[joints, 0] += (curl - now.curl[finger]) * JOINT_SHARE[finger]
    if spread is not None:
        angles[joints[0], 1] += (spread - now.spread[finger]) * AWAY[finger]
    if limited:
        angles = clamped_angles(angles)
    out = np.array(axis_angle, np.float64)
    out[joints] = axis_angle_from_joint_angles(angles)[joints]
    return out


def finger_name(finger: int) -> str:
    return {"pinky": "little finger"}.get(FINGERS[finger], FINGERS[finger])
