"""Skin weights at any canonical point: what the paper takes from the closest vertex, without its jumps.

The look-up is made in the canonical pose, where the fingers stand apart: closest point of the template's visible
triangles, normals agreeing where the caller has them, at most 3 cm away, and the rest filled harmonically over
the caller's own mesh.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from avatar.skinning import SkinWeights, dense_weights, strongest_four
from train.capture import Subject
from train.template import blend_skin, sample_faces, vertex_normals, visible_faces

Array = np.ndarray


def closest_on_triangles(
    points: Float[Array, "n 3"], corners: Float[Array, "n 3 3"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Closest point of one triangle per row, and its barycentric coordinates (Ericson 2004, section 5.1.5).

    A triangle without area gives a point of its longest edge.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    d1, d2 = (ab * ap).sum(1), (ac * ap).sum(1)
    aa, cc, ac_ab = (ab * ab).sum(1), (ac * ac).sum(1), (ab * ac).sum(1)
    area = aa * cc - ac_ab**2
    safe = np.where(area > 1e-30, area, 1.0)
    v, w = (cc * d1 - ac_ab * d2) / safe, (aa * d2 - ac_ab * d1) / safe
    inside = (v >= 0) & (w >= 0) & (v + w <= 1) & (area > 1e-30)
    best = np.stack([1 - v - w, v, w], 1)
    shortest = np.where(inside, 0.0, np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        edge = corners[:, j] - corners[:, i]
        length = (edge * edge).sum(1)
        t = np.clip(((points - corners[:, i]) * edge).sum(1) / np.where(length > 0, length, 1.0), 0, 1)
        gap = ((points - corners[:, i] - t[:, None] * edge) ** 2).sum(1)
        nearer = ~inside & (gap < shortest)
        shortest = np.where(nearer, gap, shortest)
        on_edge = np.zeros_like(best)
        on_edge[:, i], on_edge[:, j] = 1 - t, t
        best = np.where(nearer[:, None], on_edge, best)
    return np.einsum("nk,nkc->nc", best, corners), best


class CanonicalSkin:
    """Look-up of skin weights on the canonical template of a subject."""

    limit = 0.03  # metres; farther than this a weight is a guess

    def __init__(self, subject: Subject):
        visible = visible_faces(subject)
        self.vertices, self.faces, self.skin = subject.vertices, subject.faces[visible], subject.skin
        self.normals = vertex_normals(subject.vertices, subject.faces)
        on_hand = (subject.part[self.faces] >= 2).any(1)
        self.face, barycentric = sample_faces(self.vertices, self.faces, np.where(on_hand, 0.0015, 0.006))
        self.tree = cKDTree(np.einsum("sk,skc->sc", barycentric, self.vertices[self.faces[self.face]]))

    def closest(
        self, points: Float[Array, "n 3"], normals: Float[Array, "n 3"] | None = None, candidates: int = 6
    ) -> tuple[Int[Array, "n"], Float[Array, "n 3"], Float[Array, "n"], Bool[Array, "n"]]:
        """Closest visible triangle: face, barycentric coordinates, distance, and whether the normals agree (dot > .5).

        Among the triangles of the nearest samples the closest that agrees is taken, else the closest of all.
        """
        _, rows = self.tree.query(points, k=candidates, workers=-1)
        best_face = np.zeros(len(points), int)
        best_weights = np.zeros((len(points), 3))
        shortest = np.full(len(points), np.inf)
        agreeing = np.zeros(len(points), bool)
        for k in range(candidates):
            face = self.face[rows[:, k]]
            corners = self.faces[face]
            nearest, weights = closest_on_triangles(points, self.vertices[corners])
            gap = np.linalg.norm(points - nearest, axis=1)
            agrees = np.ones(len(points), bool)
            if normals is not None:
                normal = np.einsum("nk,nkc->nc", weights, self.normals[corners])
                agrees = (normal * normals).sum(1) > 0.5 * np.linalg.norm(normal, axis=1)
            take = (agrees & ~agreeing) | ((agrees == agreeing) & (gap < shortest))
            best_face[take], best_weights[take] = face[take], weights[take]
            shortest[take], agreeing[take] = gap[take], agrees[take]
        return best_face, best_weights, shortest, agreeing

    def lookup(
        self, points: Float[Array, "n 3"], normals: Float[Array, "n 3"] | None = None
    ) -> tuple[SkinWeights, Bool[Array, "n"]]:
        """Weights of canonical points; ok is false beyond the limit or where no normal agrees."""
        points = np.asarray(points, np.float64)
        if len(points) == 0:
            return SkinWeights(np.zeros((0, 4), int), np.zeros((0, 4), np.float32)), np.zeros(0, bool)
        face, weights, gap, agrees = self.closest(points, normals)
        return blend_skin(self.skin, self.faces[face], weights), agrees & (gap < self.limit)

    def of_mesh(
        self, vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], normals: Float[Array, "v 3"] | None = None
    ) -> SkinWeights:
        """Weights of a mesh's vertices: looked up where that is safe, harmonic over the edges elsewhere."""
        skin, ok = self.lookup(vertices, vertex_normals(vertices, faces) if normals is None else normals)
        return harmonic_fill(skin, ok, faces)


def harmonic_fill(skin: SkinWeights, known: Bool[Array, "v"], faces: Int[Array, "f 3"]) -> SkinWeights:
    """Weights of the unknown vertices from the known ones: L w = 0 with the uniform graph Laplacian.

    Patches that touch no known vertex keep what they had.
    """
    count = len(known)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ones = np.ones(2 * len(edges))
    both = np.concatenate([edges, edges[:, ::-1]])
    adjacency = sparse.csr_matrix((ones, (both[:, 0], both[:, 1])), (count, count))
    adjacency.data[:] = 1
    _, component = sparse.csgraph.connected_components(adjacency, directed=False)
    reachable = np.zeros(component.max() + 1, bool)
    reachable[component[known]] = True
    free = np.flatnonzero(~known & reachable[component])
    if len(free) == 0:
        return skin
    fixed = np.flatnonzero(known)
    rows = adjacency[free]
    laplacian = sparse.diags(np.asarray(rows.sum(1)).ravel()) - rows[:, free]
    dense = dense_weights(skin)
    dense[free] = np.clip(splu(laplacian.tocsc()).solve(rows[:, fixed] @ dense[fixed]), 0, None)
    filled = strongest_four(dense[free])
    joints, weights = skin.joints.copy(), skin.weights.copy()
    joints[free], weights[free] = filled.joints, filled.weights
    return SkinWeights(joints, weights)
