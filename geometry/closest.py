"""Closest points: of one triangle, of a whole mesh, of a mesh where it faces the same way, of a line in the plane."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array
from scipy.spatial import KDTree

from geometry.mesh import check_mesh, face_normals

# point-triangle pairs held in memory
PAIRS_AT_ONCE = 500_000
POINTS_AT_ONCE = 1024
# triangles of less than a 64th of the largest one's size stand together
SIZES = 7


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


class SizeGroup(NamedTuple):
    """Triangles of about one size."""

    faces: Integer[Array, "g"]
    middles: KDTree
    # metres, from a middle to the farthest corner of its triangle
    radius: float


class TriangleIndex(NamedTuple):
    """A mesh ready to be asked for closest points many times."""

    corners: Float[Array, "faces 3 3"]
    # those of most triangles first
    groups: list[SizeGroup]


class ClosestPoints(NamedTuple):
    """For each query the closest point of a mesh."""

    point: Float[Array, "n 3"]
    distance: Float[Array, "n"]
    face: Integer[Array, "n"]


def triangle_index(vertices: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"]) -> TriangleIndex:
    """Search structure over the triangles of a mesh: trees of their middles, one for each halving of their size."""
    check_mesh(vertices, faces, "mesh to measure against")
    corners = np.asarray(vertices, np.float64)[faces]
    middles = corners.mean(1)
    radius = np.linalg.norm(corners - middles[:, None], axis=2).max(1)
    halvings = np.log2(radius.max() / np.maximum(radius, 1e-300), where=radius > 0, out=np.full(len(radius), np.inf))
    size = np.minimum(halvings, SIZES - 1).astype(np.int64)
    groups = [np.flatnonzero(size == number) for number in np.argsort(-np.bincount(size), kind="stable")]
    groups = [SizeGroup(own, KDTree(middles[own]), float(radius[own].max())) for own in groups if len(own)]
    return TriangleIndex(corners, groups)


def closest_points(points: Float[Array, "n 3"], index: TriangleIndex) -> ClosestPoints:
    """The exact closest point of a mesh to each point.

    The triangle with the nearest middle bounds the distance; of each group every triangle is tried whose middle lies
    within that bound and the group's radius.
    """
    points = np.asarray(points, np.float64)
    found = ClosestPoints(np.empty_like(points), np.full(len(points), np.inf), np.zeros(len(points), np.int64))
    for start in range(0, len(points), POINTS_AT_ONCE):
        rows = np.arange(start, min(start + POINTS_AT_ONCE, len(points)))
        for group in index.groups:
            _keep_nearer(found, points, rows, group.faces[group.middles.query(points[rows])[1]], index)
            reach = found.distance[rows] * (1 + 1e-9) + group.radius + 1e-12
            near = group.middles.query_ball_point(points[rows], reach, return_sorted=False)
            counts = np.array([len(members) for members in near])
            splits = np.flatnonzero(np.diff(np.cumsum(counts) // PAIRS_AT_ONCE)) + 1
            for piece in np.split(np.arange(len(rows)), splits):
                tried = np.concatenate([np.asarray(near[i], np.int64) for i in piece])
                _keep_nearer(found, points, np.repeat(rows[piece], counts[piece]), group.faces[tried], index)
    return found


def _keep_nearer(
    found: ClosestPoints, points: Float[Array, "n 3"], rows: Integer[Array, "k"], faces: Integer[Array, "k"],
    index: TriangleIndex,
) -> None:  # fmt: skip
    """Enter the pairs of points, by their rising `rows`, and faces that are nearer than what was found."""
    if not len(rows):
        return
    nearest, _ = closest_on_triangles(points[rows], index.corners[faces])
    distance = np.linalg.norm(nearest - points[rows], axis=1)
    first = np.flatnonzero(np.r_[True, np.diff(rows) > 0])
    least = np.repeat(np.minimum.reduceat(distance, first), np.diff(np.r_[first, len(rows)]))
    hit = np.flatnonzero(distance == least)
    row, chosen = np.unique(rows[hit], return_index=True)
    nearer = distance[hit[chosen]] < found.distance[row]
    row, hit = row[nearer], hit[chosen[nearer]]
    found.point[row], found.distance[row], found.face[row] = nearest[hit], distance[hit], faces[hit]


class Match(NamedTuple):
    """For each query, the point of a mesh that stands for it."""

    face: Integer[Array, "n"]
    barycentric: Float[Array, "n 3"]
    distance: Float[Array, "n"]  # metres
    # a triangle facing the same way was among the candidates
    agrees: Bool[Array, "n"]


def match_surface(
    points: Float[Array, "n 3"], normals: Float[Array, "n 3"], vertices: Float[Array, "vertices 3"],
    faces: Integer[Array, "faces 3"],
) -> Match:  # fmt: skip
    """Closest point of a mesh that faces the same way as the query.

    Among the triangles with the nearest centroids, those compete whose normal is less than a right angle from the
    query's; a finger's back never takes the neighbouring finger's side, an ear's front not its back. Where none agrees
    the closest of all is returned and `agrees` is False.
    """
    corners = vertices[faces]
    facing = face_normals(vertices, faces)
    tree = KDTree(corners.mean(1))

    def found_among(rows: Integer[Array, "rows"], count: int) -> Match:
        _, near = tree.query(points[rows], k=count, workers=-1)
        agrees = lambda face, _: (facing[face] * normals[rows]).sum(1) > 0
        return best_candidate(points[rows], near.reshape(len(rows), count), corners, agrees)

    found = found_among(np.arange(len(points)), min(FEW, len(faces)))
    doubtful = np.flatnonzero(~found.agrees)
    if len(doubtful) and len(faces) > FEW:
        for kept, better in zip(found, found_among(doubtful, min(MOST, len(faces))), strict=True):
            kept[doubtful] = better
    return found


# candidates that settle nearly every query, and those that the others are asked for
FEW, MOST = 6, 24


def best_candidate(
    points: Float[Array, "n 3"], candidates: Integer[Array, "n k"], corners: Float[Array, "faces 3 3"],
    agrees: Callable[[Integer[Array, "n"], Float[Array, "n 3"]], Bool[Array, "n"]],
) -> Match:  # fmt: skip
    """Of each point's candidate triangles the closest that agrees, else the closest of all.

    `agrees` is asked for one triangle a point and the barycentric coordinates of its closest place.
    """
    count = len(points)
    best = Match(candidates[:, 0].copy(), np.zeros((count, 3)), np.full(count, np.inf), np.zeros(count, bool))
    for face in candidates.T:
        nearest, weights = closest_on_triangles(points, corners[face])
        away, good = np.linalg.norm(nearest - points, axis=1), agrees(face, weights)
        wins = (good & ~best.agrees) | ((good == best.agrees) & (away < best.distance))
        for kept, found in zip(best, (face, weights, away, good), strict=True):
            kept[wins] = found[wins]
    return best


def beyond_loop(points: Float[Array, "n 2"], loop: Float[Array, "m 2"]) -> Float[Array, "n"]:
    """Distance of points from a closed line in the plane, negative inside of it."""
    start, along = loop, np.roll(loop, -1, 0) - loop
    offset = points[:, None] - start
    squared = (along**2).sum(1)
    share = np.clip((offset * along).sum(2) / np.where(squared > 0, squared, 1), 0, 1)
    away = np.linalg.norm(offset - share[..., None] * along, axis=2).min(1)
    y0, y1 = loop[:, 1], np.roll(loop[:, 1], -1)
    between = (y0 > points[:, 1:]) != (y1 > points[:, 1:])
    crossing = loop[:, 0] + (points[:, 1:] - y0) / np.where(y1 == y0, 1, y1 - y0) * along[:, 0]
    inside = (between & (points[:, :1] < crossing)).sum(1) % 2 == 1
    return np.where(inside, -away, away)
