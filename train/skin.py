"""Skin weights at any canonical point: what the paper takes from the closest vertex, without its jumps.

The look-up is made in the canonical pose, where the fingers stand apart: closest point of the template's visible
triangles, normals agreeing where the caller has them, at most 3 cm away, and the rest filled harmonically over
the caller's own mesh.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.skinning import SkinWeights, dense_weights, strongest_four
from capture.folder import CaptureSubject
from capture.template.surface import blend_skin, visible_faces
from geometry.closest import best_candidate
from geometry.harmonic import anchored, fill_harmonic
from geometry.mesh import vertex_normals
from geometry.sample import lattice_samples


class CanonicalSkin:
    """Look-up of skin weights on the canonical template of a subject."""

    # metres; farther than this a weight is a guess
    limit = 0.03

    def __init__(self, subject: CaptureSubject):
        visible = visible_faces(subject)
        self.vertices, self.faces, self.skin = subject.vertices, subject.faces[visible], subject.skin
        self.normals = vertex_normals(subject.vertices, subject.faces)
        on_hand = (subject.part[self.faces] >= 2).any(1)
        samples = lattice_samples(self.vertices, self.faces, np.where(on_hand, 0.0015, 0.006))
        self.face, self.tree = samples.face, KDTree(samples.on(self.vertices, self.faces))

    def lookup(self, points: Float[Array, "n 3"], normals: Float[Array, "n 3"]) -> tuple[SkinWeights, Bool[Array, "n"]]:
        """Weights of canonical points: of the triangles of the nearest samples the closest whose normals agree
        (dot > .5), else the closest. ok is false beyond the limit or where no normal agrees.
        """
        points = np.asarray(points, np.float64)
        if len(points) == 0:
            return SkinWeights(np.zeros((0, 4), int), np.zeros((0, 4), np.float32)), np.zeros(0, bool)
        rows = np.asarray(self.tree.query(points, k=6, workers=-1)[1])

        def agrees(face: Int[Array, "n"], weights: Float[Array, "n 3"]) -> Bool[Array, "n"]:
            normal = np.einsum("nk,nkc->nc", weights, self.normals[self.faces[face]])
            return (normal * normals).sum(1) > 0.5 * np.linalg.norm(normal, axis=1)

        face, weights, gap, agree = best_candidate(points, self.face[rows], self.vertices[self.faces], agrees)
        return blend_skin(self.skin, self.faces[face], weights), agree & (gap < self.limit)

    def of_mesh(
        self, vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], normals: Float[Array, "vertices 3"]
    ) -> SkinWeights:
        """Weights of a mesh's vertices: looked up where that is safe, harmonic over the edges elsewhere."""
        return harmonic_fill(*self.lookup(vertices, normals), faces)


def harmonic_fill(skin: SkinWeights, known: Bool[Array, "vertices"], faces: Int[Array, "faces 3"]) -> SkinWeights:
    """Weights of the unknown vertices from the known ones, harmonic over the edges (geometry/harmonic.py).

    Patches that touch no known vertex keep what they had.
    """
    free = ~known & anchored(known, faces)
    if not free.any():
        return skin
    filled = strongest_four(np.clip(fill_harmonic(dense_weights(skin), ~free, faces)[free], 0, None))
    joints, weights = skin.joints.copy(), skin.weights.copy()
    joints[free], weights[free] = filled.joints, filled.weights
    return SkinWeights(joints, weights)
