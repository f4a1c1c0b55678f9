"""Named points, projected, lie where the detector saw them.

sum over frames and points  rho(|p - pi(x)|^2 / s^2)        rho(e) = c^2 e / (c^2 + e), Geman and McClure (1987)
"""

import numpy as np
from jaxtyping import Float

from capture.fit.equations import Equations
from capture.fit.footage import Estimate, Footage
from capture.fit.kinematics import Posed, carried, pixel_rows, pose_rows, seen_at, shape_rows, skinned
from capture.fit.priors import shared_layout

Array = np.ndarray


def projected(estimate: Estimate, footage: Footage, frame: Posed) -> Float[Array, "points 2"]:
    """Pixels of the named points."""
    points = estimate.markers(footage)
    return seen_at(estimate.lens(footage), skinned(points, carried(frame, points)))


def add_keypoints(equations: Equations, estimate: Estimate, footage: Footage, frames: list[Posed], cut: float) -> float:
    """Add the term with c = `cut` standard deviations; returns its cost."""
    layout, lens, points = shared_layout(estimate, footage), estimate.lens(footage), estimate.markers(footage)
    cost = 0.0
    for f, frame in enumerate(frames):
        sure = footage.sure[f]
        by_bone = carried(frame, points)
        x = skinned(points, by_bone)
        at = seen_at(lens, x)
        r = footage.pixels[f] - at
        e = (r**2).sum(1) * sure**2
        weight = sure**2 / (1 + e / cut**2) ** 2
        cost += float((cut**2 * e / (cut**2 + e)).sum())
        moves = pixel_rows(lens, x)
        for axis in range(2):
            c = moves[:, axis]
            shared = np.zeros((len(x), layout.count))
            shared[:, layout.g] = shape_rows(frame, points, c)
            own = np.einsum("ni,nij->nj", c, frame.R[points.joints[:, 0]])
            index = layout.bias.start + 3 * np.arange(len(x))
            for i in range(3):
                shared[np.arange(len(x)), index + i] = own[:, i]
            shared[:, layout.focal] = at[:, axis] - lens.centre[axis]
            rows = pose_rows(frame, points, by_bone, c, footage.moving)
            equations.add(f, rows, shared, r[:, axis], weight)
    return cost
