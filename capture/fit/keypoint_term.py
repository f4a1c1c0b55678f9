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


def projected(estimate: Estimate, footage: Footage, frame: Posed) -> Float[Array, "points 2"]:
    """Pixels of the named points."""
    points = estimate.markers(footage)
    return pixel_rows(estimate.camera(footage), skinned(frame, points))[0]


def add_keypoints(
    equations: NormalEquations, estimate: Estimate, footage: Footage, frames: list[Posed], cut: float
) -> float:
    """Add the term with c = `cut` standard deviations; returns its cost."""
    layout, camera, points = shared_layout(estimate, footage), estimate.camera(footage), estimate.markers(footage)
    cost = 0.0
    for f, frame in enumerate(frames):
        sure = footage.sure[f]
        x = skinned(frame, points)
        at, moves = pixel_rows(camera, x)
        r = footage.pixels[f] - at
        e = (r**2).sum(1) * sure**2
        weight = sure**2 * robust_weight(e, cut)
        cost += float(robust_cost(e, cut).sum())
        for axis in range(2):
            c = moves[:, axis]
            shared = np.zeros((len(x), layout.count))
            shared[:, layout.g] = shape_rows(frame, points, c)
            own = np.einsum("ni,nij->nj", c, frame.R[points.joints[:, 0]])
            index = layout.bias.start + 3 * np.arange(len(x))
            for i in range(3):
                shared[np.arange(len(x)), index + i] = own[:, i]
            shared[:, layout.focal] = at[:, axis] - footage.centre[axis]
            rows = pose_rows(frame, points, c, footage.turning)
            equations.add(f, rows, r[:, axis], weight, shared)
    return cost
