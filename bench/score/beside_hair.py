"""Where hair meets skin: the true skin beside it, and edges of the reconstruction that a pose stretches there.

Hair that is one sheet with neck or shoulder shows twice: the skin beside it is painted on a lid centimetres off, and
the sheet stretches when the head turns against the shoulders.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.skeleton import JOINTS, PARTS
from bench.score.true_mesh import TrueMesh
from geometry.closest import closest_points, triangle_index
from geometry.mesh import half_edges
from geometry.sample import stratified_samples

BESIDE = 0.04  # metres from hair
SAMPLES = 1500
FARTHEST = 0.1  # metres
# times its rest length: a longer edge is a sheet between two things that move apart
STRETCHED = 2.0
# metres, at least: marching cubes leave slivers of hundredths of a millimetre, whose doubling cannot be seen
LONGER = 0.002


def hair_faces(truth: TrueMesh) -> Bool[Array, "faces"]:
    """True faces that are hair: at least two of their corners are."""
    return truth.hair[truth.faces].sum(1) >= 2


def skin_beside_hair(truth: TrueMesh) -> Bool[Array, "faces"]:
    """True visible faces of head and neck within BESIDE of visible hair, hair apart; canonical pose."""
    middle = truth.canonical()[truth.faces].mean(1)
    hair = hair_faces(truth)
    chosen = truth.visible & ~hair & _head_or_neck(truth)
    if not (hair & truth.visible).any() or not chosen.any():
        return np.zeros(len(truth.faces), bool)
    away = KDTree(middle[hair & truth.visible]).query(middle[chosen])[0]
    chosen[chosen] = away < BESIDE
    return chosen


def _head_or_neck(truth: TrueMesh) -> Bool[Array, "faces"]:
    bones = [JOINTS.index("neck"), JOINTS.index("head")]
    own = (truth.part == PARTS.index("head")) | np.isin(truth.skin.heaviest, bones)
    return own[truth.faces].any(1)


def skin_to_surface(truth: TrueMesh, vertices: Float[Array, "w 3"], faces: Int[Array, "g 3"]) -> float | None:
    """Metres, mean from the true skin beside hair to the nearest surface of a canonical reconstruction, also to what
    hair hides of it: skin that was kept under the hair counts. None: no such skin."""
    canonical, chosen = truth.canonical(), truth.faces[skin_beside_hair(truth)]
    if len(chosen) == 0:
        return None
    points = stratified_samples(canonical, chosen, SAMPLES, seed=0).on(canonical, chosen)
    low, high = points.min(0) - FARTHEST, points.max(0) + FARTHEST
    corners = vertices[faces]
    near = ((corners > low) & (corners < high)).any(1).all(1)
    if not near.any():
        return FARTHEST
    return float(closest_points(points, triangle_index(vertices, faces[near])).distance.mean())


def edges_at_hair(truth: TrueMesh, vertices: Float[Array, "w 3"], faces: Int[Array, "g 3"]) -> Int[Array, "edges 2"]:
    """Edges of a canonical reconstruction of which at least one end lies on true hair, each once.

    On hair: the nearest visible true face is hair, not farther than BESIDE.
    """
    seen = np.flatnonzero(truth.visible)
    away, nearest = KDTree(truth.canonical()[truth.faces[seen]].mean(1)).query(vertices)
    on_hair = hair_faces(truth)[seen[nearest]] & (away < BESIDE)
    edges = np.unique(np.sort(half_edges(faces[on_hair[faces].any(1)]), axis=1), axis=0)
    return edges[on_hair[edges].any(1)]


def stretched_edges(
    edges: Int[Array, "edges 2"], rest: Float[Array, "w 3"], posed: Iterable[Float[Array, "w 3"]]
) -> int:
    """How many edges are longer than STRETCHED times their rest length, and by LONGER, in any of the poses."""
    lengths = lambda vertices: np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    before, stretched = lengths(rest), np.zeros(len(edges), bool)
    for vertices in posed:
        stretched |= lengths(vertices) > np.maximum(STRETCHED * before, before + LONGER)
    return int(stretched.sum())
