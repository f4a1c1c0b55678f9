"""From numbers to colors, and the legend that says which is which."""

import colorsys
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

# ends and stops of a ramp from dark to light, equally far apart to the eye
SEQUENTIAL = ("#2c1160", "#5b2a86", "#9c3a7c", "#d9545f", "#f68f46", "#fcd43f")
PALE = ("#fffdf0", "#fddaa3", "#f99b5f", "#d6452f", "#8c0f22")  # under dark lines
DIVERGING = ("#2b5fb3", "#8fb7e0", "#f4f4f2", "#eba58a", "#b3202c")
ABSENT = "#e100e1"  # nothing is known here
PART_COLORS = ("#8aa6c1", "#e0b354", "#5fae8b", "#c9746d")


@dataclass(frozen=True)
class Legend:
    """A ramp with its ticks, or named colors."""

    stops: tuple[str, ...] = ()
    ticks: tuple[str, ...] = ()  # evenly along the ramp
    named: tuple[tuple[str, str], ...] = ()  # (color, name)


def rgb(color: str) -> Float[np.ndarray, "3"]:
    """#rrggbb as numbers from 0 to 255."""
    return np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)], float)


def ramp(
    values: Float[np.ndarray, "n"], low: float, high: float, stops: tuple[str, ...] = SEQUENTIAL
) -> UInt8[np.ndarray, "n 3"]:
    """Colors along the stops; beyond the ends the end's own, NaN is ABSENT."""
    table = np.stack([rgb(stop) for stop in stops])
    known = np.isfinite(values)
    place = np.clip((np.where(known, values, low) - low) / (high - low), 0, 1) * (len(stops) - 1)
    first = np.minimum(place.astype(np.int64), len(stops) - 2)
    part = (place - first)[:, None]
    out = (1 - part) * table[first] + part * table[first + 1]
    out[~known] = rgb(ABSENT)
    return np.round(out).astype(np.uint8)


def categorical(count: int) -> UInt8[np.ndarray, "count 3"]:
    """Colors of joints: hues a golden section apart, so that numbers near each other differ much."""
    hues = (np.arange(count) * 0.61803398875) % 1
    return np.array(
        [[round(255 * x) for x in colorsys.hsv_to_rgb(h, 0.55 + 0.3 * (i % 2), 0.95)] for i, h in enumerate(hues)],
        np.uint8,
    )


def part_colors(part: Int[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
    return np.stack([rgb(color) for color in PART_COLORS]).astype(np.uint8)[part]


def ticks(low: float, high: float, count: int = 5, suffix: str = "") -> tuple[str, ...]:
    return tuple(f"{value:.3g}{suffix}" for value in np.linspace(low, high, count))


def hexadecimal(color: UInt8[np.ndarray, "3"]) -> str:
    return "#" + "".join(f"{int(value):02x}" for value in color)
