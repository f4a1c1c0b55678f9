"""From numbers to colors, and the legend that says which is which; a color is written as #rrggbb."""

import colorsys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from PIL import ImageColor

# ends and stops of a ramp from dark to light, equally far apart to the eye
SEQUENTIAL = ("#2c1160", "#5b2a86", "#9c3a7c", "#d9545f", "#f68f46", "#fcd43f")
DIVERGING = ("#2b5fb3", "#8fb7e0", "#f4f4f2", "#eba58a", "#b3202c")
ABSENT = "#e100e1"  # nothing is known here
PART_COLORS = ("#8aa6c1", "#e0b354", "#5fae8b", "#c9746d")


class Legend(NamedTuple):
    """A ramp with its ticks, or named colors."""

    stops: tuple[str, ...] = ()
    ticks: tuple[str, ...] = ()  # evenly along the ramp
    named: tuple[tuple[str, str], ...] = ()  # (color, name)


class Ramp(NamedTuple):
    """Numbers from low to high as colors along the stops."""

    low: float
    high: float
    # behind the numbers of its legend
    unit: str = ""
    stops: tuple[str, ...] = SEQUENTIAL

    def colors(self, values: Float[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
        """Beyond the ends the end's own, NaN is ABSENT."""
        at = np.linspace(self.low, self.high, len(self.stops))
        out = np.stack([np.interp(values, at, channel) for channel in rgb(self.stops).T], 1)
        out[~np.isfinite(values)] = rgb([ABSENT])
        return np.round(out).astype(np.uint8)

    def legend(self, *named: tuple[str, str]) -> Legend:
        """The ramp with five ticks, and other colors with their names."""
        return Legend(
            self.stops, tuple(f"{tick:.3g}{self.unit}" for tick in np.linspace(self.low, self.high, 5)), named
        )


def rgb(colors: Sequence[str]) -> Float[np.ndarray, "n 3"]:
    """Numbers from 0 to 255."""
    return np.array([ImageColor.getrgb(color) for color in colors], np.float64)


def categorical(count: int) -> list[str]:
    """Colors of joints: hues a golden section apart, so that numbers near each other differ much."""
    hues = (np.arange(count) * 0.61803398875) % 1
    colors = [colorsys.hsv_to_rgb(hue, 0.55 + 0.3 * (i % 2), 0.95) for i, hue in enumerate(hues)]
    return ["#" + "".join(f"{round(255 * value):02x}" for value in color) for color in colors]
