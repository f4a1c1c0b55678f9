"""How far each joint turns: three named anatomical angles a joint, their ranges, and clamping to them.

A joint's rotation is a twist about its bone followed by a swing of the bone (Grassia 1998; Baerlocher and Boulic
2001), the swing an exponential map in the plane across the bone:

    R = exp(f e_f + a e_a) exp(t e_t)        f flexion, a abduction, t twist, radians; e_f, e_a, e_t orthonormal

It covers every rotation and is smooth wherever the swing is below half a turn. A swing is inside when

    (f / F)^4 + (a / A)^4 <= 1               F, A the limits on the side that f and a point to

between a box, whose corners no joint reaches, and an ellipse, which cuts off too much. Clamping shortens the
swing (f, a) without turning it and cuts the twist; what is inside comes back untouched to the last bit.

Axes and ranges are given for the left side in pose 0 (T-pose); the right side is its mirror image at x -> -x, so
equal angles are equal movements. Degrees are those of healthy adults; AAOS's and AMA's are as Norkin and White,
"Measurement of joint motion", tabulate them:

    AAOS      American Academy of Orthopaedic Surgeons, "Joint motion: method of measuring and recording", 1965
    AMA       American Medical Association, "Guides to the evaluation of permanent impairment", 3rd ed., 1990
    Levangie  Levangie and Norkin, "Joint structure and function", 5th ed., 2011
    Kapandji  Kapandji, "The physiology of the joints", 6th ed., 2007
    ours      movements that anatomy has no number for, or that SMPL+H's joint shares with its neighbours; a few
              degrees are left to joints that are hinges in anatomy, because fitted poses use them

Anatomy's zero is the standing position; where it is not pose 0 the row says so.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.body import builtin_body
from avatar.constant import constant
from avatar.motion.fingers import FINGERS, MIRROR, finger_axes
from avatar.rotation import (
    axis_angle_from_quaternion,
    quaternion_from_axis_angle,
    quaternion_inverse,
    quaternion_product,
)
from avatar.skeleton import JOINTS

# exponent of the swing's outline: 2 is an ellipse, infinity a box
POWER = 4
FREE = 180.0


Freedom = tuple[str, float | int, float | int, tuple[float, float, float]]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
MINUS_X, MINUS_Y, MINUS_Z = (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)


def _trunk(
    forward: float | int, back: float | int, side: float | int, turn: float | int
) -> tuple[Freedom, Freedom, Freedom]:  # fmt: skip
    return (
        ("bend forward", -back, forward, X),
        ("bend to the left", -side, side, MINUS_Z),
        ("turn to the left", -turn, turn, Y),
    )


# Three named angles of each joint: from low to high degrees, positive about the axis (left side). The third is the
# twist, its axis the bone's.
BODY: dict[str, tuple[Freedom, Freedom, Freedom]] = {
    # the whole body in the world: no limits
    "pelvis": _trunk(FREE, FREE, FREE, FREE),
    # AAOS: flexion 120, extension 30, abduction 45, adduction 30, rotation 45 each way
    "hip": (("flexion", -30, 120, MINUS_X), ("abduction", -30, 45, Z), ("rotation outwards", -45, 45, Y)),
    # AAOS: hyperextension 10; Kapandji: flexion 150, rotation of the bent knee 30 inwards, 40 outwards; sideways ours
    "knee": (("flexion", -10, 150, X), ("sideways", -8, 8, Z), ("rotation outwards", -30, 40, Y)),
    # AAOS: dorsiflexion 20, plantar flexion 50, inversion 35, eversion 15; ours: 15 more of dorsiflexion, which the
    # body's weight adds over a bent knee, and toes in and out
    "ankle": (("toes up", -50, 35, MINUS_X), ("toes outwards", -25, 25, Y), ("sole inwards", -15, 35, MINUS_Z)),
    # AAOS, first toe joint: extension 70, flexion 45; the rest ours
    "foot": (("toes up", -45, 70, MINUS_X), ("toes outwards", -10, 10, Y), ("sole inwards", -10, 10, MINUS_Z)),
    # AAOS for the thoracic and lumbar spine: 80 forward, 30 back, 35 sideways, 45 turned; shared out by us over the
    # three joints, the turning mostly to the upper two, since lumbar vertebrae hardly turn
    "spine1": _trunk(35, 10, 12, 10),
    "spine2": _trunk(25, 10, 12, 15),
    "spine3": _trunk(20, 10, 11, 20),
    # AMA for the cervical spine: 60 forward, 75 back, 45 sideways, 80 turned; shared out by us, half of the turning
    # to the uppermost two vertebrae
    "neck": _trunk(35, 40, 28, 38),
    "head": _trunk(25, 35, 17, 42),
    # Levangie, sternoclavicular: elevation 48, depression 15, protraction 20, retraction 30, backward turn 50
    "collar": (("raise", -15, 48, Z), ("forwards", -30, 20, MINUS_Y), ("roll back", -10, 50, MINUS_X)),
    # From the horizontal arm of pose 0. AAOS: elevation 180 (90 above), adduction 0 (90 below) and, ours, 15 more
    # across the body; horizontal flexion 135, extension 45 and, ours, 15 more for the collar's part in extension;
    # rotation 70 inwards, 90 outwards
    "shoulder": (("raise", -105, 90, Z), ("forwards", -60, 135, MINUS_Y), ("rotation inwards", -90, 70, X)),
    # AAOS: flexion 150; ours: hyperextension 10; the forearm's turn is shared with the wrist: Kapandji has
    # 85 of pronation and 90 of supination in all, and pose 0 is halfway between; sideways ours
    "elbow": (("flexion", -10, 150, MINUS_Y), ("sideways", -10, 10, Z), ("palm down", -50, 50, X)),
    # AAOS: flexion 80, extension 70, towards the thumb 20, towards the little finger 30; the turn as above
    "wrist": (("flexion", -70, 80, MINUS_Z), ("towards the thumb", -30, 20, MINUS_Y), ("palm down", -40, 40, X)),
}

# low and high of flexion, sideways (positive: towards the thumb's side) and twist of the three joints of a finger.
# AAOS: first joint 90, 45 back; middle 100 (10 more, ours); last 90, 10 back. Sideways 20 each way (Kapandji: 30 in
# all, more for forefinger and little finger); the rest ours.
FINGER = (((-45, 90), (-20, 20), (-10, 10)), ((-10, 110), (-5, 5), (-5, 5)), ((-10, 90), (-5, 5), (-5, 5)))
LITTLE_FINGER = (((-45, 90), (-35, 20), (-10, 10)), *FINGER[1:])
# The thumb of pose 0 stands 45 degrees from the palm. AAOS: first joint flexion 15, extension 20, abduction 70;
# second flexion 50; last flexion 80, extension 20. Our flexion of the first joint closes the thumb over the palm, a
# mixture of AAOS's flexion and of opposition, hence wider.
THUMB = (((-30, 60), (-35, 35), (-30, 60)), ((-10, 60), (-10, 10), (-10, 10)), ((-20, 80), (-5, 5), (-5, 5)))
FINGER_NAMES = ("curl", "towards the thumb's side", "twist")
THUMB_NAMES = ("over the palm", "away from the palm", "opposition")


class Limits(NamedTuple):
    """Names, axes and ranges of all 52 joints, both sides."""

    names: tuple[tuple[str, str, str], ...]
    # rows e_f, e_a, e_t, unit, parent's frame in pose 0
    axes: Float[Array, "52 3 3"]
    low: Float[Array, "52 3"]  # radians
    high: Float[Array, "52 3"]


@constant
def limits() -> Limits:
    """The table above for every joint, worked out once."""
    names, axes, ranges = [], [], []
    for joint in JOINTS:
        side, _, part = joint.rpartition("_")
        if part in BODY:
            named, low, high, axis = zip(*BODY[part], strict=True)
            directions, ends = np.array(axis), np.stack([low, high], -1)
        else:
            finger, number = part[:-1], int(part[-1]) - 1
            named = THUMB_NAMES if finger == "thumb" else FINGER_NAMES
            directions = _finger_frame(finger, number)
            ends = np.array({"thumb": THUMB, "pinky": LITTLE_FINGER}.get(finger, FINGER)[number], np.float64)
        names.append(named)
        axes.append(directions * MIRROR if side == "right" else directions)
        ranges.append(np.radians(ends))
    low, high = np.moveaxis(np.array(ranges), -1, 0)
    return Limits(tuple(names), np.array(axes), low, high)


def _finger_frame(finger: str, number: int) -> Float[Array, "3 3"]:
    """Axes of a joint of the left hand: curl as avatar/motion/fingers.py has it, sideways towards the thumb, the bone.

    Thumbs go away from the palm, which for them is the same kind of movement.
    """
    joints = builtin_body("male").joints
    first = JOINTS.index(f"left_{finger}1")
    start = first + min(number, 1)
    bone = joints[start + 1] - joints[start]
    curl = finger_axes()[0][FINGERS.index(finger), number]
    bone = bone - curl * (bone @ curl)
    bone = bone / np.linalg.norm(bone)
    # turning about curl x bone moves the bone along (curl x bone) x bone = -curl: towards the thumb's side
    return np.stack([curl, np.cross(curl, bone), bone])


def joint_angles(axis_angle: Float[Array, "*b 52 3"]) -> Float[Array, "*b 52 3"]:
    """Flexion, abduction and twist of each joint, radians: the twist within half a turn, the swing at most that.

    A swing of exactly half a turn leaves the twist open; it is 0 then.
    """
    axes = limits().axes
    q = quaternion_from_axis_angle(np.asarray(axis_angle, np.float64))
    along = np.sum(q[..., :3] * axes[:, 2], -1)
    length = np.hypot(along, q[..., 3])
    open_twist = length < 1e-12
    scale = np.where(open_twist, 1.0, length)
    sine = np.where(open_twist, 0.0, along / scale)
    cosine = np.where(open_twist, 1.0, q[..., 3] / scale)
    twist = np.concatenate([sine[..., None] * axes[:, 2], cosine[..., None]], -1)
    swing = axis_angle_from_quaternion(quaternion_product(q, quaternion_inverse(twist)))
    angle = 2 * np.arctan2(np.where(cosine < 0, -sine, sine), np.abs(cosine))
    return np.stack([np.sum(swing * axes[:, 0], -1), np.sum(swing * axes[:, 1], -1), angle], -1)


def axis_angle_from_joint_angles(angles: Float[Array, "*b 52 3"]) -> Float[Array, "*b 52 3"]:
    """The pose that has these flexions, abductions and twists."""
    axes = limits().axes
    swing = angles[..., :1] * axes[:, 0] + angles[..., 1:2] * axes[:, 1]
    twist = angles[..., 2:] * axes[:, 2]
    return axis_angle_from_quaternion(
        quaternion_product(quaternion_from_axis_angle(swing), quaternion_from_axis_angle(twist))
    )


def swing_excess(angles: Float[Array, "*b 52 3"]) -> Float[Array, "*b 52"]:
    """How far out the swing is: at most 1 inside the limits; the factor by which it must be shortened."""
    table = limits()
    swing = angles[..., :2]
    bound = np.where(swing < 0, -table.low[:, :2], table.high[:, :2])
    return np.sum((np.abs(swing) / bound) ** POWER, -1) ** (1 / POWER)


def clamped_angles(angles: Float[Array, "*b 52 3"]) -> Float[Array, "*b 52 3"]:
    """The angles brought inside: swings shortened, twists cut. Angles inside stay as they are."""
    table = limits()
    out = np.array(angles, np.float64)
    excess = swing_excess(out)
    # the pelvis is free; its outline is no limit
    excess[..., 0] = 0.0
    out[..., :2] /= np.where(excess > 1, excess, 1.0)[..., None]
    out[..., 2] = np.clip(out[..., 2], table.low[:, 2], table.high[:, 2])
    return out


def within(axis_angle: Float[Array, "*b 52 3"], tolerance: float | int = 1e-9) -> Bool[Array, "*b 52"]:
    """Which joints are inside their limits, within `tolerance` (radians for twists, relative for swings)."""
    table = limits()
    angles = joint_angles(axis_angle)
    twist = angles[..., 2]
    inside = (twist >= table.low[:, 2] - tolerance) & (twist <= table.high[:, 2] + tolerance)
    inside &= swing_excess(angles) <= 1 + tolerance
    inside[..., 0] = True
    return inside


def clamped(axis_angle: Float[Array, "*b 52 3"]) -> Float[Array, "*b 52 3"]:
    """The pose with every joint brought inside its limits; joints inside keep their vectors to the last bit."""
    axis_angle = np.asarray(axis_angle, np.float64)
    brought = axis_angle_from_joint_angles(clamped_angles(joint_angles(axis_angle)))
    return np.where(within(axis_angle)[..., None], axis_angle, brought)


def allowed(joint: int, angles: Float[Array, "3"]) -> Float[Array, "3 2"]:
    """Lowest and highest value of each angle of a joint while its other two stay: the ends of its sliders.

    A slider that is itself outside is not left without room: its range always holds 0.
    """
    table = limits()
    out = np.stack([table.low[joint], table.high[joint]], -1)
    if joint == 0:
        return out
    for one, other in ((0, 1), (1, 0)):
        value = angles[other]
        bound = -table.low[joint, other] if value < 0 else table.high[joint, other]
        out[one] *= max(1 - (abs(value) / bound) ** POWER, 0.0) ** (1 / POWER)
    return out


def with_angle(
    axis_angle: Float[Array, "52 3"], joint: int, freedom: int, value: float | int, *, limited: bool = True
) -> Float[Array, "52 3"]:
    """The pose with one angle of one joint set, radians; `limited` keeps it in the range that the others leave."""
    angles = joint_angles(axis_angle)
    if limited:
        low, high = allowed(joint, angles[joint])[freedom]
        value = float(np.clip(value, low, high))
    angles[joint, freedom] = value
    out = np.array(axis_angle, np.float64)
    out[joint] = axis_angle_from_joint_angles(angles)[joint]
    return out


def posed(angles: dict[str, dict[str, float | int]]) -> Float[Array, "52 3"]:
    """A pose written down as degrees: {"left_elbow": {"flexion": 90}}; joints and angles left out are 0.

    Raises:
        ValueError: no such joint, or the joint has no angle of that name.
    """
    table = limits()
    values = np.zeros((52, 3))
    for joint, named in angles.items():
        if joint not in JOINTS:
            raise ValueError(f"no joint {joint!r}; there are {', '.join(JOINTS)}")
        k = JOINTS.index(joint)
        for name, degrees in named.items():
            if name not in table.names[k]:
                raise ValueError(f"{joint} has no {name!r}; it has {', '.join(table.names[k])}")
            values[k, table.names[k].index(name)] = np.radians(degrees)
    return axis_angle_from_joint_angles(values)
