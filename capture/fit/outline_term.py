"""The template's outline lies on the masks' outline.

    w sum over frames and silhouette vertices  rho((n . (q - pi(x)))^2 / s^2)      q the mask's outline nearest to x

s is .7 pixels of a picture whose shorter side is 512. The weight w is small: outlines err together (clothes, masks a
pixel too large), and a template that lacks clothes would bend its legs to fill them. Pairs are found again between
steps.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from capture.fit.contours import Contour, mask_contour, silhouette
from capture.fit.equations import Equations
from capture.fit.footage import Estimate, Footage
from capture.fit.kinematics import Posed, carried, pixel_rows, pose_rows, seen_at, shape_rows, skinned
from capture.fit.priors import shared_layout
from capture.fit.solve import posed_frames

Array = np.ndarray

# of a picture whose shorter side is 512, pixels
SIGMA = 0.7
# a normal turned by a radian counts as that many pixels of a picture whose shorter side is 512
BEND = 20.0
# standard deviations from which on a pair says little
CUT = 12.0


@dataclass(frozen=True)
class Pairs:
    """Silhouette vertices of one frame, and the places of the mask's outline that stand for them."""

    vertices: Int[Array, "n"]
    at: Float[Array, "n 2"]
    normals: Float[Array, "n 2"]


class Outlines:
    """The masks' outlines of a video."""

    def __init__(self, footage: Footage):
        self.scale = min(footage.size) / 512
        self.contours: list[Contour] = [mask_contour(mask, BEND * self.scale) for mask in footage.masks]

    def pairs(self, estimate: Estimate, footage: Footage, chosen: Bool[Array, "vertices"]) -> list[Pairs]:
        """Pairs of all frames at an estimate; `chosen` vertices alone."""
        points, lens, faces = estimate.skin(), estimate.lens(footage), estimate.person.body.faces
        found = []
        for frame, contour in zip(posed_frames(estimate), self.contours):
            x = skinned(points, carried(frame, points))
            rim = silhouette(x, faces, lens, footage.size, chosen)
            index, length = contour.nearest(rim.at, rim.normals, BEND * self.scale)
            good = (length < 40 * self.scale) & ((rim.normals * contour.normals[index]).sum(1) > 0.5)
            found.append(Pairs(rim.vertices[good], contour.at[index[good]], contour.normals[index[good]]))
        return found

    def term(self, pairs: list[Pairs], weight: float):
        """The term for given pairs."""
        sigma = SIGMA * self.scale

        def add(equations: Equations, estimate: Estimate, footage: Footage, frames: list[Posed]) -> float:
            layout, lens, cost = shared_layout(estimate, footage), estimate.lens(footage), 0.0
            for f, (frame, pair) in enumerate(zip(frames, pairs)):
                points = estimate.skin(pair.vertices)
                by_bone = carried(frame, points)
                x = skinned(points, by_bone)
                at = seen_at(lens, x)
                r = ((pair.at - at) * pair.normals).sum(1)
                e = r**2 / sigma**2
                w = weight / sigma**2 / (1 + e / CUT**2) ** 2
                cost += weight * float((CUT**2 * e / (CUT**2 + e)).sum())
                c = np.einsum("ni,nij->nj", pair.normals, pixel_rows(lens, x))
                shared = np.zeros((len(x), layout.count))
                shared[:, layout.g] = shape_rows(frame, points, c)
                shared[:, layout.focal] = ((at - lens.centre) * pair.normals).sum(1)
                equations.add(f, pose_rows(frame, points, by_bone, c, footage.moving), shared, r, w)
            return cost

        return add
