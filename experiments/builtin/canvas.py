"""What the painters share: the facts they may ask of a texel, and their strokes.

Every texel is colored by where it lies on the person, not by where it lies in the picture, so that seams do not
show and both sexes share the code. Colors are sRGB, 0 to 1. Frame: pose 0, pelvis at the origin, metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from experiments.builtin.noise import noise
from synth.people.mesh import smoothstep

Array = np.ndarray


@dataclass(frozen=True)
class Canvas:
    """What the painters may ask about the texels they color."""

    p: Float[Array, "n 3"]  # on the naked body
    q: Float[Array, "n 3"]  # on the dressed person
    # normal of the dressed person
    n: Float[Array, "n 3"]
    uv: Float[Array, "n 2"]  # the body's own texture coordinates, v down
    hair: Float[Array, "n"]  # metres inside the hairline
    collar: Float[Array, "n"]  # metres from the collar's edge
    light: Float[Array, "n"]  # 0 to 1
    opened: Float[Array, "n"]  # 0 to 1
    # negative in creases, positive on ridges
    cavity: Float[Array, "n"]

    def at(self, rows: Int[Array, "M"]) -> "Canvas":
        """The texels of these rows alone."""
        return Canvas(*(value[rows] for value in vars(self).values()))


def srgb(rgb: tuple[int, int, int]) -> Float[Array, "3"]:
    """A color of 0 to 255 as one of 0 to 1."""
    return np.array(rgb, np.float32) / 255


def mixed(
    a: Float[Array, "#n 3"], b: Float[Array, "#n 3"] | Float[Array, "3"], t: Float[Array, "n"]
) -> Float[Array, "n 3"]:
    """From `a` where t is 0 to `b` where it is 1; t is clipped."""
    t = np.clip(t, 0, 1)[:, None]
    return a * (1 - t) + b * t


def spot(
    points: Float[Array, "n 3"],
    centre: Float[Array, "3"] | Sequence[float],
    radius: Float[Array, "3"] | Sequence[float] | float,
) -> Float[Array, "n"]:
    """A Gaussian spot of the given radii, metres: 1 at its centre."""
    return np.exp(-((((points - centre) / radius) ** 2).sum(1)))


def shaded(
    color: Float[Array, "n 3"],
    c: Canvas,
    strength: float,
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Float[Array, "n 3"]:
    """Color under the baked sky; what is dark takes the tint (light that bled through skin)."""
    dark = np.clip(1 - strength * (1 - c.light / 0.86), 0.12, 1.06)[:, None]
    return color * dark ** (1 / np.array(tint, np.float32))


def weave(points: Float[Array, "n 3"], seed: int, fine: int = 900) -> Float[Array, "n"]:
    """The grain of cloth in -1 to 1, `fine` threads a metre."""
    return 0.5 * noise(points * fine, seed) + 0.5 * noise(points * (0.31 * fine), seed + 1)


def stitches(
    distance: Float[Array, "n"], along: Float[Array, "n"], width: float = 0.0010, stitch: float = 0.0042
) -> Float[Array, "n"]:
    """A stitched line: dashes of thread along a seam, 0 to 1; from the line and along it in metres."""
    return np.exp(-((distance / width) ** 2)) * smoothstep(0.22, 0.34, np.abs((along / stitch) % 1 - 0.5) * -1 + 0.62)
