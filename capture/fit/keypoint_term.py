"""Named points, projected, lie where the detector saw them.

sum over frames and points  rho(|p - pi(x)|^2 / s^2)        rho(e) = c^2 e / (c^2 + e), Geman and McClure (1985)
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.kinematics import Posed, pixel_rows, pose_rows, shape_rows, skinned
from capture.fit.footage import Estimate, Footage
from capture.fit.priors import shared_layout
from geometry.least_squares import NormalEquations, robust_cost, robust_weight


def projected(estimate: Estimate, footage: Footage, frames: Posed) -> Float[Array, "*f points 2"]:
    """Pixels of the named points."""
    return pixel_rows(estimate.camera(footage), skinned(frames, estimate.markers(footage)))[0]


def add_keypoints(
    equations: NormalEquations, estimate: Estimate, footage: Footage, frames: Posed, cut: float
) -> float:
    """Add the term with c = `cut` standard deviations; returns its cost."""
    layout, points, sure = shared_layout(estimate, footage), estimate.markers(footage), footage.sure
    at, moves = pixel_rows(estimate.camera(footage), skinned(frames, points))
    r = footage.pixels - at
    e = (r**2).sum(-1) * sure**2
    weight = sure**2 * robust_weight(e, cut)
    every, count = np.arange(len(points.rest)), len(points.rest)
    for axis in range(2):
        c = moves[..., axis, :]
        shared = np.zeros((*e.shape, layout.count))
        shared[..., layout.g] = shape_rows(frames, points, c)
        own = (c[..., None, :] @ frames.R[:, points.joints[:, 0]])[..., 0, :]
        bias = np.zeros((*e.shape, count, 3))
        bias[:, every, every] = own
        shared[..., layout.bias] = bias.reshape(*e.shape, 3 * count)
        shared[..., layout.focal] = at[..., axis] - footage.centre[axis]
        for f, rows in enumerate(pose_rows(frames, points, c, footage.turning)):
            equations.add(f, rows, r[f, :, axis], weight[f], shared[f])
    return float(robust_cost(e, cut).sum())
