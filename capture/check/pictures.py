"""The pictures themselves: blurred, burnt out or repeated frames."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array
from scipy import ndimage

# frames on either side that a frame's sharpness is compared with
AROUND = 4
# Share of their median under which a frame counts as blurred. Measured on three people: the least sharp frame of a
# clean video 0.36 to 0.90, any frame blurred by a Gaussian of one pixel 0.27 at most.
BLURRED = 0.3
# mean difference of two frames, of 255, under which they are the same picture
REPEATED = 0.05
# out of 255, in every channel: beyond it the sensor has nothing left to say
BRIGHT, DARK = 254, 2


class Clipping(NamedTuple):
    """Shares of the person's pixels."""

    burnt: float
    black: float


def sharpness(
    images: UInt8[Array, "frames height width 3"], masks: Bool[Array, "frames height width"]
) -> Float[Array, "frames"]:
    """Variance of the Laplacian over that of the gradient, of the grey picture well inside the person.

    The Laplacian by itself follows the texture that happens to be in view: of the palm it has a quarter of that of
    the back of the hand. Against the gradient it says how fine the finest detail is. nan where nothing is seen.
    """
    out = np.full(len(images), np.nan)
    for i, (image, mask) in enumerate(zip(images, masks)):
        inside = np.asarray(ndimage.binary_erosion(mask, iterations=3), bool)
        if inside.any():
            grey = image.astype(np.float32).mean(-1)
            down, across = np.gradient(grey)
            slope = (down[inside] ** 2 + across[inside] ** 2).mean()
            out[i] = ndimage.laplace(grey)[inside].var() / max(slope, 1e-6)
    return out


def blurred(sharp: Float[Array, "frames"]) -> list[int]:
    """Frames much less sharp than those just before and after: the far side of a person may have less to show."""
    found = []
    for i in np.flatnonzero(np.isfinite(sharp)):
        near = np.delete(sharp[max(i - AROUND, 0) : i + AROUND + 1], min(i, AROUND))
        near = near[np.isfinite(near)]
        if len(near) and sharp[i] < BLURRED * np.median(near):
            found.append(int(i))
    return found


def repeated(images: UInt8[Array, "frames height width 3"]) -> list[int]:
    """Frames that are the picture before them once more."""
    differs = [np.abs(images[i].astype(np.int16) - images[i - 1]).mean() for i in range(1, len(images))]
    return [i + 1 for i, difference in enumerate(differs) if difference < REPEATED]


def exposure(images: UInt8[Array, "frames height width 3"], masks: Bool[Array, "frames height width"]) -> Clipping:
    """How much of the person is clipped, over all frames."""
    pixels = images[masks]
    if len(pixels) == 0:
        return Clipping(0.0, 0.0)
    return Clipping(float((pixels.min(1) >= BRIGHT).mean()), float((pixels.max(1) <= DARK).mean()))
