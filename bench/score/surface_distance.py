"""Distances between surfaces in centimetres: P2S and Chamfer, per region, on what can be seen from outside.

    P2S = mean over samples of the reconstruction of the distance to the true surface
    CD  = (P2S + mean over samples of the true surface of the distance to the reconstruction) / 2

Vertices are metres. Samples are drawn once per mesh, uniform by area in its rest shape and seeded, and ride
on their triangles when the mesh is posed: each piece of skin counts the same in every pose.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

CENTIMETRES = 100.0  # per metre


class SurfaceDistance(NamedTuple):
    """Centimetres; p2s from the reconstruction to the truth, completeness the other way."""

    p2s: float | None
    completeness: float | None
    chamfer: float | None


def check_same_unit(truth: Float[np.ndarray, "vertices 3"], other: Float[np.ndarray, "w 3"]) -> None:
    """Refuse metres against centimetres: a person is 0.3 to 3.5 m across, and two of one person are alike."""
    spans = [float(np.ptp(points, axis=0).max()) for points in (truth, other)]
    for name, span in zip(("truth", "reconstruction"), spans, strict=True):
        if not 0.05 <= span <= 3.5:
            raise ValueError(f"{name} spans {span:g}; expected a person or part of one in metres (0.05 to 3.5)")
    ratio = spans[1] / spans[0]
    if not 1 / 5 < ratio < 5:
        raise ValueError(f"reconstruction spans {spans[1]:g}, truth {spans[0]:g}: the units differ (both in metres?)")


def surface_distance(to_truth: Float[np.ndarray, "n"], to_reconstruction: Float[np.ndarray, "m"]) -> SurfaceDistance:
    """Scores in centimetres from distances in metres; None where there are no samples."""
    p2s = CENTIMETRES * float(to_truth.mean()) if len(to_truth) else None
    completeness = CENTIMETRES * float(to_reconstruction.mean()) if len(to_reconstruction) else None
    both = None if p2s is None or completeness is None else 0.5 * (p2s + completeness)
    return SurfaceDistance(p2s, completeness, both)
