"""The template's outline lies on the masks' outline.

    w sum over frames and silhouette vertices  rho((n . (q - pi(x)))^2 / s^2)      q the mask's outline nearest to x

s is .7 pixels of a picture whose shorter side is 512. The weight w is small: outlines err together (clothes, masks a
pixel too large), and a template that lacks clothes would bend its legs to fill them. Pairs are found again between
steps.
"""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.kinematics import Posed, pixel_rows, pose_rows, shape_rows, skinned
from capture.fit.contours import Contour, Silhouette, mask_contour, silhouette
from capture.fit.footage import Estimate, Footage
from capture.fit.priors import Priors, shared_layout
from capture.fit.solve import posed_frames, solve
from geometry.least_squares import NormalEquations, robust_cost, robust_weight

# pixels in a picture whose shorter side is 512, pixels
SIGMA = 0.7
# a normal turned by a radian counts as that many pixels of a picture whose shorter side is 512
BEND = 20.0
# standard deviations from which on a pair says little
CUT = 12.0
# an outline farther off than so many times what may stand off a vertex is that of something else
SLACK = 1.5


class Outlines:
    """The masks' outlines of a video.

    `standoff`: metres by which they may be off each vertex (standoff.py); None: anything near.
    """

    def __init__(self, footage: Footage, standoff: Float[Array, "vertices"] | None = None):
        self.standoff = standoff
        self.scale = min(footage.size) / 512
        self.contours: list[Contour] = [mask_contour(mask) for mask in footage.masks]

    def pairs(self, estimate: Estimate, footage: Footage, chosen: Bool[Array, "vertices"]) -> list[Silhouette]:
        """The silhouettes of all frames at an estimate on the masks' outlines; `chosen` vertices alone."""
        points, camera, faces = estimate.skin(), estimate.camera(footage), estimate.person.body.faces
        found = []
        for frame, contour in zip(posed_frames(estimate).each, self.contours):
            x = skinned(frame, points)
            rim = silhouette(x, faces, camera, chosen)
            index, length = contour.nearest(rim.at, rim.normals, BEND * self.scale)
            good = (length < 40 * self.scale) & ((rim.normals * contour.normals[index]).sum(1) > 0.5)
            if self.standoff is not None:
                pixels = camera.K[0, 0] / np.maximum(-x[rim.vertices, 2], 1e-3)
                good &= length < SLACK * pixels * self.standoff[rim.vertices]
            found.append(Silhouette(rim.vertices[good], contour.at[index[good]], contour.normals[index[good]]))
        return found

    def fit(
        self, estimate: Estimate, footage: Footage, priors: Priors, chosen: Bool[Array, "vertices"],
        weights: tuple[float, ...], *, cut: float, rounds: int = 3,
    ) -> Estimate:  # fmt: skip
        """Keypoints and outlines, weighted more and more; pairs are found again for each weight."""
        for weight in weights:
            term = self.term(self.pairs(estimate, footage, chosen), weight)
            estimate = solve(estimate, footage, priors, cuts=(cut,), rounds=rounds, terms=(term,))
        return estimate

    def term(self, pairs: list[Silhouette], weight: float):
        """The term for given pairs."""
        sigma = SIGMA * self.scale

        def add(equations: NormalEquations, estimate: Estimate, footage: Footage, frames: Posed) -> float:
            """Adds the pairs' weighted rows to the equations; returns their robust cost."""
            layout, camera, cost = shared_layout(estimate, footage), estimate.camera(footage), 0.0
            for f, (frame, pair) in enumerate(zip(frames.each, pairs)):
                points = estimate.skin(pair.vertices)
                x = skinned(frame, points)
                at, moves = pixel_rows(camera, x)
                r = ((pair.at - at) * pair.normals).sum(1)
                e = r**2 / sigma**2
                w = weight / sigma**2 * robust_weight(e, CUT)
                cost += weight * float(robust_cost(e, CUT).sum())
                c = np.einsum("ni,nij->nj", pair.normals, moves)
                shared = np.zeros((len(x), layout.count))
                shared[:, layout.g] = shape_rows(frame, points, c)
                shared[:, layout.focal] = ((at - footage.centre) * pair.normals).sum(1)
                equations.add(f, pose_rows(frame, points, c, footage.turning), r, w, shared)
            return cost

        return add
