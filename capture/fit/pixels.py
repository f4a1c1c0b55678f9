"""What a picture says of how what is drawn should move: image alignment (Lucas and Kanade 1981).

Moving what is drawn by m pixels changes it by -gradient . m, so that seen - drawn = -gradient . m is one equation for
each pixel; pixels that differ for another reason lose their weight (Geman and McClure 1985).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Num
from numpy import ndarray as Array
from scipy import ndimage

from geometry.least_squares import robust_cost, robust_weight


def bilinear(image: Num[Array, "height width c"], pixels: Float[Array, "n 2"]) -> Float[Array, "n c"]:
    """What a picture shows at places between its pixels."""
    place = (pixels[:, ::-1] - 0.5).T
    channels = np.moveaxis(image, 2, 0)
    read = lambda one: ndimage.map_coordinates(one, place, np.float64, order=1, mode="nearest")
    return np.stack([read(one) for one in channels], 1)


class PixelEquations(NamedTuple):
    """slope . m = residual, of some pixels."""

    slope: Float[Array, "n 2"]
    residual: Float[Array, "n"]
    weight: Float[Array, "n"]  # 1 of small residuals
    cost: float  # sum of rho


def compare_pixels(
    drawn: Float[Array, "height width"],
    seen: Float[Array, "height width"],
    at: tuple[Int[Array, "n"], Int[Array, "n"]],
    outlier: float,
) -> PixelEquations:
    """The equations of pixels `at` (rows, columns); residuals beyond `outlier` count little."""
    slope_y, slope_x = np.gradient(drawn)
    residual = (seen - drawn)[at]
    slope = -np.stack([slope_x[at], slope_y[at]], 1)
    cost = float(robust_cost(residual**2, outlier).sum())
    return PixelEquations(slope, residual, robust_weight(residual**2, outlier), cost)
