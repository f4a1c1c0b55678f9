"""Where garments end, as signed distances on the naked body: metres, positive inside the garment.

Frame: pose 0, pelvis at the origin, metres.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from experiments.builtin.looks import Looks

Array = np.ndarray

# width of the band that closes a hem towards the skin
LIP = 0.003
BELT_WIDTH = 0.035


class Hems(NamedTuple):
    """How far points lie inside each edge of the shirt."""

    neck: Float[Array, "n"]  # below the collar
    # short of the sleeves' hems
    arm: Float[Array, "n"]
    # above the shirt's hem or the belt; 1 on the arms
    waist: Float[Array, "n"]


def neckline(points: Float[Array, "n 3"], joints: Float[Array, "52 3"], looks: Looks) -> Float[Array, "n"]:
    """Below the collar: a plane round the neck that drops to the front; 0.3 away from the neck."""
    neck = np.array([joints[0, 0], joints[13:15, 1].mean(), joints[13:15, 2].mean()])
    up = np.array([0.0, 1.0, looks.neckline])
    up /= np.linalg.norm(up)
    centre = neck + np.array([0, looks.collar, 0.0])
    distance = (centre - points) @ up
    near = np.hypot(points[:, 0] - neck[0], points[:, 2] - neck[2])
    return np.where((points[:, 1] > neck[1] - 0.12) & (near < 0.20), distance, 0.3)


def sleeves(points: Float[Array, "n 3"], joints: Float[Array, "52 3"], looks: Looks) -> Float[Array, "n"]:
    """Along the arms, to the hem; 0.3 where there is no arm."""
    out = np.full(len(points), 0.3)
    for shoulder, elbow, wrist in ((16, 18, 20), (17, 19, 21)):
        side = np.sign(joints[shoulder, 0])
        upper = abs(joints[elbow, 0] - joints[shoulder, 0])
        lower = abs(joints[wrist, 0] - joints[elbow, 0])
        reach = upper * min(looks.sleeve, 1.0) + lower * max(looks.sleeve - 1.0, 0.0)
        along = side * (points[:, 0] - joints[shoulder, 0])
        arm = points[:, 1] > joints[0, 1] + 0.25
        out = np.where(arm & (along > -0.02), np.minimum(out, reach - along), out)
    return out


def hem_height(joints: Float[Array, "52 3"], looks: Looks) -> float:
    """Where the shirt ends: at the belt when tucked in, else across the hips; y in metres."""
    return joints[0, 1] + (0.085 if looks.tucked else -0.035)


def ankle_level(joints: Float[Array, "52 3"]) -> float:
    """The height of the trouser hem, y in metres."""
    return float(joints[7:9, 1].mean() + 0.004)


def waist(
    points: Float[Array, "n 3"], arm: Float[Array, "n"], joints: Float[Array, "52 3"], looks: Looks
) -> Float[Array, "n"]:
    """Above the shirt's hem, or the belt's lower edge; 1 on the arms, where `arm` says that there is one."""
    return np.where(arm < 0.29, 1.0, points[:, 1] - hem_height(joints, looks))


def hems_at(points: Float[Array, "n 3"], joints: Float[Array, "52 3"], looks: Looks) -> Hems:
    """All three distances."""
    arm = sleeves(points, joints, looks)
    return Hems(neckline(points, joints, looks), arm, waist(points, arm, joints, looks))


def waist_levels(looks: Looks) -> list[tuple[float, float]]:
    """Values of `waist` along which the surface is cut, each with its `snap` (see cut_along)."""
    if looks.tucked:
        return [(0.0, 0.2), (BELT_WIDTH, 0.2), (LIP, 0.0), (BELT_WIDTH + LIP, 0.0)]
    return [(0.0, 0.2), (-LIP, 0.0)]
