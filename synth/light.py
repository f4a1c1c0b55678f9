"""What colour a point shows: base colour, light, and a sheen that depends on the view.

Light multiplies sRGB values as they are shown, not linear ones: the learner sees display values, and the modes
then mean what their numbers say (DESIGN.md, Commands; how much each costs the learner: docs/decisions.md).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from avatar.camera import direction
from synth.room import ROOM, Room


@dataclass(frozen=True)
class StudioLight:
    """A light that stands still in the world while the person moves."""

    ambient: float
    # ambient + key = 1: a point that faces the key light shows its base colour
    key: float
    direction: tuple[float, float, float]  # world, towards the light; of any length
    specular: float = 0.0


FilmLight = StudioLight | Room
FRONT = (0.45, 0.65, 0.6)
STILL = {
    "even": StudioLight(1.0, 0.0, FRONT),
    "soft": StudioLight(0.75, 0.25, FRONT),
    "fixed": StudioLight(0.45, 0.55, FRONT, specular=0.1),
    "room": ROOM,
}


def light_of(mode: str, video: str, seed: int) -> FilmLight:
    """The light of one video in a mode of synth/options.py: "varied" gives each another, the others share one."""
    if mode != "varied":
        return STILL[mode]
    rng = np.random.default_rng([seed, *video.encode()])
    x, y, z = direction(rng.uniform(-1.2, 1.2), rng.uniform(0.2, 1.0)).tolist()
    ambient = float(rng.uniform(0.45, 0.8))
    return StudioLight(ambient, 1 - ambient, (x, y, z), 0.05)


def shade(
    base: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    towards_eye: Float[np.ndarray, "n 3"],
    light: StudioLight,
    sheen: float,
) -> Float[np.ndarray, "n 3"]:
    """Shown colour, 0-255, of points with base colour `base` (0-255); normals and directions are unit vectors.

        c = base (ambient + key max(n.l, 0)) + 255 specular max(n.h, 0)^20 + 255 sheen (.30 (n.v)^24 + .35 (1 - n.v)^3)

    Blinn-Phong (Blinn 1977) for the light; the sheen, a highlight that follows the eye and a brighter rim,
    depends on the angle between normal and view only: it is a property of the surface, the same in every pose.
    Surfaces are two-sided: a normal that points away from the eye is turned.
    """
    facing = (normals * towards_eye).sum(1)
    normals = np.where(facing[:, None] < 0, -normals, normals)
    facing = np.abs(facing)
    towards_light = np.array(light.direction) / np.linalg.norm(light.direction)
    lit = light.ambient + light.key * np.maximum(normals @ towards_light, 0)
    half = towards_eye + towards_light
    half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
    added = light.specular * np.maximum((normals * half).sum(1), 0) ** 20
    added = added + sheen_of(facing, sheen)
    return base * lit[:, None] + 255 * added[:, None]


def sheen_of(facing: Float[np.ndarray, "n"], sheen: float) -> Float[np.ndarray, "n"]:
    """What a sheen adds to shown values of 0 to 1, where the cosine between normal and view is `facing`."""
    return sheen * (0.30 * facing**24 + 0.35 * (1 - facing) ** 3)
