"""Closest points: of one triangle, of a whole mesh, and of a mesh where it faces the same way."""

from typing import Any, NamedTuple

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Integer
from scipy.spatial import KDTree

from geometry.mesh import check_mesh, face_normals

Array = np.ndarray

# point-triangle pairs held in memory
PAIRS_AT_ONCE = 500_000


def closest_on_triangles(
    points: Float[Array, "n 3"], corners: Float[Array, "n 3 3"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Closest point of one triangle per row, and its barycentric coordinates (Ericson 2004, section 5.1.5).

    The foot on the plane competes with the closest points of the three edges, so that a sliver, whose plane hangs
    on rounding, is measured by its edges. (trimesh.triangles.closest_point compares areas with fixed tolerances:
    triangles of millimetres, given in metres, are up to 9 micrometres off.)
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    d1, d2 = (ab * ap).sum(1), (ac * ap).sum(1)
    aa, cc, ac_ab = (ab * ab).sum(1), (ac * ac).sum(1), (ab * ac).sum(1)
    area = aa * cc - ac_ab**2
    safe = np.where(area > 0, area, 1.0)
    v, w = (cc * d1 - ac_ab * d2) / safe, (aa * d2 - ac_ab * d1) / safe
    inside = (v >= 0) & (w >= 0) & (v + w <= 1) & (area > 0)
    best = np.stack([1 - v - w, v, w], 1)
    foot = ap - v[:, None] * ab - w[:, None] * ac
    shortest = np.where(inside, (foot * foot).sum(1), np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        edge = corners[:, j] - corners[:, i]
        length = (edge * edge).sum(1)
        t = np.clip(((points - corners[:, i]) * edge).sum(1) / np.where(length > 0, length, 1.0), 0, 1)
        gap = ((points - corners[:, i] - t[:, None] * edge) ** 2).sum(1)
        nearer = gap < shortest
        shortest = np.where(nearer, gap, shortest)
        on_edge = np.zeros_like(best)
        on_edge[:, i], on_edge[:, j] = 1 - t, t
        best = np.where(nearer[:, None], on_edge, best)
    return np.einsum("nk,nkc->nc", best, corners), best


class TriangleIndex(NamedTuple):
    """A mesh ready to be asked for closest points many times."""

    corners: Float[Array, "faces 3 3"]
    vertices: KDTree  # those that a face names
    boxes: Any  # rtree.index.Index: bounding boxes of the faces


class ClosestPoints(NamedTuple):
    """For each query the closest point of a mesh."""

    point: Float[Array, "n 3"]
    distance: Float[Array, "n"]
    face: Integer[Array, "n"]


def triangle_index(vertices: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"]) -> TriangleIndex:
    """Search structure over the triangles of a mesh."""
    check_mesh(vertices, faces, "mesh to measure against")
    vertices = np.asarray(vertices, np.float64)
    corners = vertices[faces]
    return TriangleIndex(corners, KDTree(vertices[np.unique(faces)]), trimesh.triangles.bounds_tree(corners))


def closest_points(points: Float[Array, "n 3"], index: TriangleIndex) -> ClosestPoints:
    """The exact closest point of a mesh to each point.

    The nearest vertex bounds the distance; every face whose box reaches into the cube of that size is tried, as
    trimesh.proximity does, here for many points at once and in bounded memory.
    """
    points = np.asarray(points, np.float64)
    found = ClosestPoints(np.empty_like(points), np.empty(len(points)), np.empty(len(points), np.int64))
    bound = index.vertices.query(points)[0] * (1 + 1e-9) + 1e-12
    # near points first: the number of faces in a cube grows slowly from one group to the next
    order = np.argsort(bound, kind="stable")
    start, size = 0, 1024
    while start < len(points):
        rows = order[start : start + size]
        reach = bound[rows, None]
        faces, counts = (
            a.astype(np.int64) for a in index.boxes.intersection_v(points[rows] - reach, points[rows] + reach)
        )
        ends = np.cumsum(counts)
        for piece in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(ends // PAIRS_AT_ONCE)) + 1):
            of = np.repeat(rows[piece], counts[piece])
            tried = faces[ends[piece[0]] - counts[piece[0]] : ends[piece[-1]]]
            nearest, _ = closest_on_triangles(points[of], index.corners[tried])
            distance = np.linalg.norm(nearest - points[of], axis=1)
            first = np.cumsum(counts[piece]) - counts[piece]
            least = np.repeat(np.minimum.reduceat(distance, first), counts[piece])
            hit = np.flatnonzero(distance == least)
            # the first of faces that are equally near
            row, chosen = np.unique(of[hit], return_index=True)
            best = hit[chosen]
            found.point[row], found.distance[row], found.face[row] = nearest[best], distance[best], tried[best]
        start += size
        size = int(np.clip(PAIRS_AT_ONCE // max(counts.mean(), 1), 1, 1 << 14))
    return found


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
