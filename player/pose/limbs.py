"""Which joints belong together: a limb, a hand."""

from avatar.skeleton import JOINTS, LEFT_HAND, RIGHT_HAND
from player.pose.fingers import Side

LEG = ("hip", "knee", "ankle", "foot")


def limb_of(joint: int) -> tuple[int, ...]:
    """The joints that are copied with one as its limb: arm with hand, leg with foot, trunk with neck and head."""
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
    """The fingers' joints of one hand."""
    return tuple(range(52)[LEFT_HAND if side == "left" else RIGHT_HAND])
