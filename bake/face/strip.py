"""Rows below a level's atlas for what it did not have: the mouth's inside and the eyeballs.

The atlas itself keeps its texels; only the texture coordinates' v shrinks. A sixteenth of more rows halves as evenly as
the atlas does for the first mips.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.baked_avatar import Level
from avatar.texture import bytes_of

# rows of the atlas for one more below it
SHARE = 16


class StripPart(NamedTuple):
    """A picture's place in the strip, in shares of its width and height."""

    left: float
    right: float


MOUTH, LEFT_EYE, RIGHT_EYE = StripPart(0.0, 0.25), StripPart(0.25, 0.3125), StripPart(0.3125, 0.375)
# texels round a picture that repeat its edge: coarse mips read there
GUTTER = 4


def size_in(place: StripPart, texels: int) -> tuple[int, int]:
    """Width and height of a picture in the strip of an atlas of so many texels a side."""
    return int((place.right - place.left) * texels) - 2 * GUTTER, texels // SHARE - 2 * GUTTER


def uv_in(place: StripPart, uv: Float[Array, "n 2"], texels: int) -> Float[Array, "n 2"]:
    """Places in a picture as texture coordinates of the level, whose own atlas has `texels` a side."""
    width, height = size_in(place, texels)
    corner = np.array([int(place.left * texels) + GUTTER, texels + GUTTER])
    return (corner + uv * [width, height]) / [texels, texels + texels // SHARE]


def with_strip(level: Level, pictures: dict[StripPart, Float[Array, "height width 3"]]) -> Level:
    """The level with a strip that holds pictures, [0, 1] sRGB; it changes with the view nowhere."""
    texels = len(level.base_color)
    strip = np.zeros((texels // SHARE, texels, 3))
    for place, picture in pictures.items():
        grown = np.pad(picture, ((GUTTER, GUTTER), (GUTTER, GUTTER), (0, 0)), mode="edge")
        left = int(place.left * texels)
        strip[:, left : left + grown.shape[1]] = grown
    uv = level.uv * np.array([1, SHARE / (SHARE + 1)], np.float32)
    features = level.features
    if features is not None:
        features = np.concatenate([features, np.zeros_like(features[: len(features) // SHARE])])
    return replace(level, uv=uv, base_color=np.concatenate([level.base_color, bytes_of(strip)]), features=features)
