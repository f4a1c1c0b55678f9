"""Which joints belong together, and left and right exchanged: the mirror image of a pose, or of one side of it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.motion.fingers import MIRROR
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS
from player.pose.fingers import HANDS, Side

LEG = ("hip", "knee", "ankle", "foot")


def _partner(name: str) -> int:
    side, _, part = name.partition("_")
    other = {"left": "right", "right": "left"}
    return JOINTS.index(f"{other[side]}_{part}" if side in other else name)


# the joint on the other side; itself in the middle
PARTNER = np.array([_partner(name) for name in JOINTS])
PARTNER.setflags(write=False)


def mirrored(axis_angle: Float[Array, "*b 52 3"]) -> Float[Array, "*b 52 3"]:
    """The pose seen in a mirror at x = 0 of the world: sides exchanged, (x, y, z) to (x, -y, -z). Exact both ways."""
    return np.asarray(axis_angle, np.float64)[..., PARTNER, :] * MIRROR


def mirrored_in_place(axis_angle: Float[Array, "52 3"]) -> Float[Array, "52 3"]:
    """The pose mirrored in the upright plane that runs through the pelvis the way it faces.

    Place and heading stay: who bows to the left with the left arm raised bows to the right with the right one. A
    body that faces straight up or down has no heading and is mirrored at x = 0.
    """
    out = mirrored(axis_angle)
    forward = matrix_from_axis_angle(axis_angle[0])[:, 2]
    if np.hypot(forward[0], forward[2]) < 1e-6:
        return out
    heading = np.arctan2(forward[0], forward[2])
    # the mirror at x = 0 turned heading to -heading
    back = matrix_from_axis_angle(np.array([0.0, 2 * heading, 0.0]))
    out[0] = axis_angle_from_matrix(back @ matrix_from_axis_angle(out[0]))
    return out


def onto_other_side(axis_angle: Float[Array, "52 3"], joints: Sequence[int]) -> Float[Array, "52 3"]:
    """The pose with these joints' mirror images put on their partners: "what the left hand does, the right one too"."""
    out = np.array(axis_angle, np.float64)
    chosen = np.asarray(joints, int)
    out[PARTNER[chosen]] = np.asarray(axis_angle)[chosen] * MIRROR
    return out


def limb_of(joint: int) -> tuple[int, ...]:
    """The joints that belong to one as its limb: arm with hand, leg with foot, trunk with neck and head."""
    name = JOINTS[joint]
    if not name.startswith(("left", "right")):
        return tuple(k for k, other in enumerate(JOINTS) if not other.startswith(("left", "right")) and k)
    side, part = name.split("_", 1)
    return tuple(
        k
        for k, other in enumerate(JOINTS)
        if other.startswith(side) and (other.split("_", 1)[1] in LEG) == (part in LEG)
    )


def hand_joints(side: Side) -> tuple[int, ...]:
    return tuple(range(52)[HANDS[side]])
