"""What of a close-up's mask is the part that is filmed.

Head and hands are fitted alone: where the rest of the person is in their videos is unknown. A pixel of the person
away from the part becomes a mixture that supervises nothing, neither the part nor the empty room.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.camera import Camera
from avatar.similarity import similarity_from_landmarks
from avatar.skeleton import PARTS, skin_transforms
from avatar.skinning import skin_points
from capture.raw.scan import FittedVideo
from capture.read.template import TemplateMesh
from geometry.cells import distance_to
from geometry.rasterise import rasterise

# metres of forearm that belong to a hand, and beside a part's outline that may be it; hair stands off a head farther,
# as far as it lies over the chin: what hangs lower is the body's video's, and so is the neck, from which the head turns
FOREARM, BESIDE, HAIR = 0.07, 0.02, 0.12
# a mixture (capture/folder.py, MIXED) that counts as no person
UNKNOWN = 120


class PartMasks:
    """One part of a template as its own video shows it."""

    def __init__(self, template: TemplateMesh, part: str, landmarks: Mapping[str, tuple[Float[Array, "3"], int]]):
        self.template, self.part = template, part
        members = template.part == PARTS.index(part)
        away = KDTree(template.vertices[members]).query(template.vertices)[0]
        reach = 0.0 if part == "head" else FOREARM
        self.faces = template.faces[(away[template.faces] <= reach).all(1)]
        places = np.array([point for point, _ in landmarks.values()])
        rest = template.vertices[[vertex for _, vertex in landmarks.values()]]
        self.head_from_rest = similarity_from_landmarks(rest, places).transform
        self.unit = float(np.cbrt(np.linalg.det(self.head_from_rest[:3, :3]))) if part == "head" else 1.0

    def mask(
        self, mask: UInt8[Array, "height width"], camera: Camera, fit: FittedVideo, i: int
    ) -> UInt8[Array, "height width"]:
        """The mask of frame i with what is away from the part unknown."""
        vertices = self.placed(fit, i)
        # a quarter of the rows is enough for a margin of centimetres
        step = max(1, mask.shape[0] // 270)
        small = camera.resized((mask.shape[1] // step, mask.shape[0] // step))
        drawn = rasterise(vertices, self.faces, small)
        if not (drawn.face >= 0).any():
            return np.where(mask > 0, UNKNOWN, 0).astype(np.uint8)
        depth = float(np.median(drawn.depth[drawn.face >= 0]))
        metre = self.unit * small.K[0, 0] / depth
        away = distance_to(drawn.face >= 0)
        near = away <= BESIDE * metre
        if self.part == "head":
            chin = int(np.flatnonzero((drawn.face >= 0).any(1))[-1])
            near[:chin] |= away[:chin] <= HAIR * metre
        rows, columns = (np.minimum(np.arange(n) // step, m - 1) for n, m in zip(mask.shape, near.shape))
        return np.where(near[rows][:, columns] | (mask == 0), mask, UNKNOWN).astype(np.uint8)

    def placed(self, fit: FittedVideo, i: int) -> Float[Array, "vertices 3"]:
        """The template's vertices in the frame of the video's cameras."""
        template = self.template
        if fit.axis_angle is None or fit.root is None:
            return template.vertices @ self.head_from_rest[:3, :3].T + self.head_from_rest[:3, 3]
        B = skin_transforms(fit.axis_angle[i], template.joints, fit.root[i], rest=np.zeros((52, 3)))
        return skin_points(template.vertices, template.skin, B)
