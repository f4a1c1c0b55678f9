"""Distances between surfaces in centimetres, per region, on what can be seen from outside.

    P2S  = mean over samples of the reconstruction of the distance to the true surface
    back = mean over samples of the true surface of the distance to the reconstruction: what is missing counts
    CD   = (P2S + back) / 2
    F(t) = harmonic mean of the shares of either surface's samples that are nearer than t to the other (Knapitsch et
           al. 2017, section 4)

Vertices are metres. Samples are drawn once per mesh, uniform by area in its rest shape and seeded, and ride
on their triangles when the mesh is posed: each piece of skin counts the same in every pose.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

CENTIMETRES = 100.0  # per metre


class SurfaceDistance(NamedTuple):
    """Of one region, centimetres and shares of 1; None: without samples."""

    p2s: float | None  # from the reconstruction to the truth
    back: float | None = None  # the other way
    back_95: float | None = None  # its 95th percentile
    chamfer: float | None = None
    f_5mm: float | None = None
    f_1cm: float | None = None


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
    """Scores from distances in metres; None where there are no samples."""
    p2s = CENTIMETRES * float(to_truth.mean()) if len(to_truth) else None
    if len(to_reconstruction) == 0:
        return SurfaceDistance(p2s)
    back, back_95 = (CENTIMETRES * float(f(to_reconstruction)) for f in (np.mean, lambda d: np.percentile(d, 95)))
    if p2s is None:
        return SurfaceDistance(None, back, back_95)
    f_scores = [f_score(to_truth, to_reconstruction, within) for within in (0.005, 0.01)]
    return SurfaceDistance(p2s, back, back_95, 0.5 * (p2s + back), *f_scores)


def f_score(to_truth: Float[np.ndarray, "n"], to_reconstruction: Float[np.ndarray, "m"], within: float) -> float:
    """F at a distance in metres, 0 to 1."""
    precision, recall = float((to_truth < within).mean()), float((to_reconstruction < within).mean())
    return 2 * precision * recall / max(precision + recall, 1e-12)
