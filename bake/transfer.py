"""Closest points from one mesh of a person to another, never across to the other side of a thin part."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from scipy.sparse import coo_matrix, diags
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree


class Match(NamedTuple):
    face: Integer[np.ndarray, "n"]
    barycentric: Float[np.ndarray, "n 3"]
    distance: Float[np.ndarray, "n"]  # metres
    agrees: Bool[np.ndarray, "n"]  # a triangle facing the same way was among the candidates


def closest_on_triangles(
    points: Float[np.ndarray, "n 3"], triangles: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n 3"]:
    """Barycentric coordinates of the point of each triangle closest to its point (Ericson 2004, 5.1.5).

    A triangle without area answers with the closest point of one of its edges.
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = (ab * ab).sum(1), (ab * ac).sum(1), (ac * ac).sum(1)
    d20, d21 = (ap * ab).sum(1), (ap * ac).sum(1)
    area = d00 * d11 - d01 * d01
    safe = np.where(area > 1e-30, area, 1.0)
    v, w = (d11 * d20 - d01 * d21) / safe, (d00 * d21 - d01 * d20) / safe
    inside = (area > 1e-30) & (v >= 0) & (w >= 0) & (v + w <= 1)
    best = np.stack([1 - v - w, v, w], 1)
    least = np.where(inside, -1.0, np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, side = triangles[:, i], triangles[:, j] - triangles[:, i]
        t = np.clip(((points - start) * side).sum(1) / np.maximum((side * side).sum(1), 1e-30), 0, 1)
        away = ((points - start - t[:, None] * side) ** 2).sum(1)
        closer = away < least
        least = np.where(closer, away, least)
        row = np.zeros((len(points), 3))
        row[:, i], row[:, j] = 1 - t, t
        best[closer] = row[closer]
    return best


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
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face_normals /= np.maximum(np.linalg.norm(face_normals, axis=1, keepdims=True), 1e-20)
    tree = cKDTree(corners.mean(1))
    found = _compete(points, normals, corners, face_normals, tree, min(FEW, candidates, len(faces)), cosine)
    doubtful = np.flatnonzero(~found.agrees)
    if len(doubtful) and min(candidates, len(faces)) > FEW:
        count = min(candidates, len(faces))
        again = _compete(points[doubtful], normals[doubtful], corners, face_normals, tree, count, cosine)
        for kept, better in zip(found, again, strict=True):
            kept[doubtful] = better
    return found


FEW = 6  # candidates that settle nearly every query


def _compete(
    points: np.ndarray,
    normals: np.ndarray,
    corners: np.ndarray,
    face_normals: np.ndarray,
    tree: cKDTree,
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
        bary = closest_on_triangles(points, corners[face])
        away = np.linalg.norm((bary[:, :, None] * corners[face]).sum(1) - points, axis=1)
        agrees = (face_normals[face] * normals).sum(1) > cosine
        wins = (agrees & ~best_agrees) | ((agrees == best_agrees) & (away < best))
        best_face[wins], best_bary[wins], best[wins] = face[wins], bary[wins], away[wins]
        best_agrees |= agrees
    return Match(best_face, best_bary, best, best_agrees)


def interpolate(
    values: Float[np.ndarray, "vertices channels"], faces: Integer[np.ndarray, "faces 3"], match: Match
) -> Float[np.ndarray, "n channels"]:
    return (match.barycentric[:, :, None] * values[faces[match.face]]).sum(1)


def neighbour_matrix(faces: Integer[np.ndarray, "faces 3"], count: int) -> Any:
    """Symmetric 0/1 matrix of vertices that share an edge."""
    pair = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    rows, columns = np.concatenate([pair, pair[:, ::-1]]).T
    matrix = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count)).tocsr()
    matrix.data[:] = 1.0
    return matrix


def fill_harmonic(
    values: Float[np.ndarray, "vertices channels"],
    known: Bool[np.ndarray, "vertices"],
    faces: Integer[np.ndarray, "faces 3"],
) -> Float[np.ndarray, "vertices channels"]:
    """Unknown rows become the average of their neighbours, all at once: the discrete Laplace equation with the
    known rows as its boundary. A component without any known vertex cannot be filled (ValueError)."""
    unknown = np.flatnonzero(~known)
    if len(unknown) == 0:
        return values
    if not known.any():
        raise ValueError(f"none of {len(known)} vertices is known, nothing to fill from")
    adjacency = neighbour_matrix(faces, len(values))
    degree = np.asarray(adjacency.sum(1)).reshape(-1)
    labels = connected_components(adjacency, directed=False)[1]
    anchored = np.isin(labels[unknown], labels[known])
    if not anchored.all():
        raise ValueError(f"{int((~anchored).sum())} vertices hang together with no known vertex")
    laplacian = (diags(degree) - adjacency).tocsr()[unknown]
    right = -laplacian[:, np.flatnonzero(known)] @ values[known]
    solved = splu(laplacian[:, unknown].tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0).solve(right)
    filled = values.astype(np.float64).copy()
    filled[unknown] = solved
    return filled
