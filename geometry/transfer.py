"""Closest points from one mesh of a person to another, never across to the other side of a thin part."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from scipy.spatial import KDTree

from geometry.closest import closest_on_triangles
from geometry.mesh import face_normals


class Match(NamedTuple):
    """For each query, the point of a mesh that stands for it."""

    face: Integer[np.ndarray, "n"]
    barycentric: Float[np.ndarray, "n 3"]
    distance: Float[np.ndarray, "n"]  # metres
    # a triangle facing the same way was among the candidates
    agrees: Bool[np.ndarray, "n"]


def match_surface(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Integer[np.ndarray, "faces 3"],
    *,
    candidates: int = 24,
    cosine: float = 0.0,
) -> Match:
    """Closest point of a mesh that faces the same way as the query.

    Among the triangles with the nearest centroids, those whose normal has a cosine above `cosine` with the
    query's compete; a finger's back never takes the neighbouring finger's side, an ear's front not its back.
    Where none agrees the closest of all is returned and `agrees` is False.
    """
    corners = vertices[faces]
    facing = face_normals(vertices, faces)
    tree = KDTree(corners.mean(1))
    found = _compete(points, normals, corners, facing, tree, min(FEW, candidates, len(faces)), cosine)
    doubtful = np.flatnonzero(~found.agrees)
    if len(doubtful) and min(candidates, len(faces)) > FEW:
        count = min(candidates, len(faces))
        again = _compete(points[doubtful], normals[doubtful], corners, facing, tree, count, cosine)
        for kept, better in zip(found, again, strict=True):
            kept[doubtful] = better
    return found


# candidates that settle nearly every query
FEW = 6


def _compete(
    points: np.ndarray,
    normals: np.ndarray,
    corners: np.ndarray,
    facing: np.ndarray,
    tree: KDTree,
    count: int,
    cosine: float,
) -> Match:
    _, near = tree.query(points, k=count, workers=-1)
    near = near.reshape(len(points), count)
    best_face = near[:, 0].copy()
    best_bary = np.zeros((len(points), 3))
    best = np.full(len(points), np.inf)
    best_agrees = np.zeros(len(points), bool)
    for k in range(count):
        face = near[:, k]
        nearest, bary = closest_on_triangles(points, corners[face])
        away = np.linalg.norm(nearest - points, axis=1)
        agrees = (facing[face] * normals).sum(1) > cosine
        wins = (agrees & ~best_agrees) | ((agrees == best_agrees) & (away < best))
        best_face[wins], best_bary[wins], best[wins] = face[wins], bary[wins], away[wins]
        best_agrees |= agrees
    return Match(best_face, best_bary, best, best_agrees)
