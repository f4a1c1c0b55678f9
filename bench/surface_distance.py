"""Distances between surfaces in centimetres: P2S and Chamfer, per region, on what can be seen from outside.

    P2S = mean over samples of the reconstruction of the distance to the true surface
    CD  = (P2S + mean over samples of the true surface of the distance to the reconstruction) / 2

Vertices are metres. Samples are drawn once per mesh, uniform by area in its rest shape and seeded, and ride
on their triangles when the mesh is posed: each piece of skin counts the same in every pose.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

CENTIMETRES = 100.0  # per metre
# point-triangle pairs held in memory
PAIRS_AT_ONCE = 1_000_000
# face centres tried for every point before the search by reach
NEAREST = 16


class SurfaceSamples(NamedTuple):
    face: Int[np.ndarray, "n"]
    barycentric: Float[np.ndarray, "n 3"]

    def on(self, values: Float[np.ndarray, "v c"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "n c"]:
        """Vertex values interpolated to the samples; with posed vertices, the posed sample points."""
        return np.einsum("ni,nic->nc", self.barycentric, values[faces[self.face]])


class ClosestPoints(NamedTuple):
    distance: Float[np.ndarray, "n"]
    face: Int[np.ndarray, "n"]


class SurfaceDistance(NamedTuple):
    """Centimetres; p2s from the reconstruction to the truth, completeness the other way."""

    p2s: float | None
    completeness: float | None
    chamfer: float | None


def check_mesh(vertices: np.ndarray, faces: np.ndarray, name: str) -> None:
    """Refuse a mesh without faces, with indices beyond its vertices, or with vertices that are not finite."""
    if len(faces) == 0:
        raise ValueError(f"{name}: a mesh with no faces has no surface to measure")
    low, high = int(faces.min()), int(faces.max())
    if low < 0 or high >= len(vertices):
        raise ValueError(f"{name}: faces name vertices {low}..{high}, the mesh has {len(vertices)}")
    if not np.isfinite(vertices).all():
        raise ValueError(f"{name}: vertices are not finite")


def check_same_unit(truth: Float[np.ndarray, "v 3"], other: Float[np.ndarray, "w 3"]) -> None:
    """Refuse metres against centimetres: a person is 0.3 to 3.5 m across, and two of one person are alike."""
    spans = [float(np.ptp(points, axis=0).max()) for points in (truth, other)]
    for name, span in zip(("truth", "reconstruction"), spans, strict=True):
        if not 0.05 <= span <= 3.5:
            raise ValueError(f"{name} spans {span:g}; expected a person or part of one in metres (0.05 to 3.5)")
    ratio = spans[1] / spans[0]
    if not 1 / 5 < ratio < 5:
        raise ValueError(f"reconstruction spans {spans[1]:g}, truth {spans[0]:g}: the units differ (both in metres?)")


def sample_surface(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    count: int,
    *,
    seed: int,
    keep: Bool[np.ndarray, "f"] | None = None,
) -> SurfaceSamples:
    """`count` seeded points, uniform by area over the faces kept."""
    check_mesh(vertices, faces, "mesh to sample")
    area = face_areas(vertices, faces)
    if keep is not None:
        area = np.where(keep, area, 0.0)
    if not area.sum() > 0:
        raise ValueError("mesh to sample: no face that is kept has any area")
    rng = np.random.default_rng(seed)
    # stratified in area: one sample in each of `count` equal slices, so few samples already cover small parts
    level = (np.arange(count) + rng.random(count)) / count * area.sum()
    face = np.minimum(np.searchsorted(np.cumsum(area), level, side="right"), len(faces) - 1)
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    return SurfaceSamples(face.astype(np.int64), np.stack([1 - u, u * (1 - v), u * v], -1))


def face_areas(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "f"]:
    a, b, c = np.asarray(vertices, np.float64)[faces.T]
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=-1)


def nearest_on_triangles(
    points: Float[np.ndarray, "n 3"],
    a: Float[np.ndarray, "n 3"],
    b: Float[np.ndarray, "n 3"],
    c: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Closest point of triangle abc to each point (Ericson 2005, 5.1.5); slivers act as segments."""
    ab, ac = b - a, c - a
    d1, d2 = dot(ab, points - a), dot(ac, points - a)
    d3, d4 = dot(ab, points - b), dot(ac, points - b)
    d5, d6 = dot(ab, points - c), dot(ac, points - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    area = va + vb + vc
    scale = dot(ab, ab) * dot(ac, ac)
    inside = (va > 0) & (vb > 0) & (vc > 0) & (area > 1e-14 * scale)
    w = np.where(inside, area, 1.0)
    interior = a + (vb / w)[:, None] * ab + (vc / w)[:, None] * ac
    # outside the face's prism the closest point lies on an edge: the best of three clamped projections
    best = nearest_on_segment(points, a, b)
    for p, q in ((b, c), (c, a)):
        other = nearest_on_segment(points, p, q)
        nearer = dot(points - other, points - other) < dot(points - best, points - best)
        best = np.where(nearer[:, None], other, best)
    return np.where(inside[:, None], interior, best)


def nearest_on_segment(points: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    along, length = dot(points - p, q - p), dot(q - p, q - p)
    t = np.clip(along / np.where(length > 0, length, 1.0), 0.0, 1.0)
    return p + t[:, None] * (q - p)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ni,ni->n", a, b)


class TriangleIndex(NamedTuple):
    """A posed mesh, ready to be asked for closest points many times."""

    corners: Float[np.ndarray, "f 3 3"]
    centre: Float[np.ndarray, "f 3"]
    normal: Float[np.ndarray, "f 3"]  # unit; 0 where the triangle has no area
    # of the sphere about `centre` that holds the triangle
    radius: Float[np.ndarray, "f"]
    classes: list[tuple[Int[np.ndarray, "members"], KDTree]]  # faces of like radius, the usual ones first


def triangle_index(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> TriangleIndex:
    """Search structure over the triangles of a mesh; faces are kept in classes of like size, so that one long
    triangle does not widen the search for all."""
    check_mesh(vertices, faces, "mesh to measure against")
    corners = np.asarray(vertices, np.float64)[faces]
    centre = (corners[:, 0] + corners[:, 1] + corners[:, 2]) / 3
    offset = corners - centre[:, None]
    radius = np.sqrt(np.einsum("fkc,fkc->fk", offset, offset).max(-1))
    usual = max(2 * float(np.median(radius)), 1e-9)
    size = np.ceil(np.log2(np.maximum(radius / usual, 1.0)))
    members = [np.flatnonzero(size == level) for level in np.unique(size)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    normal /= np.where(length > 0, length, 1.0)
    return TriangleIndex(corners, centre, normal, radius, [(m, centre_tree(centre[m])) for m in members])


def may_be_nearer(
    best: ClosestPoints, points: np.ndarray, index: TriangleIndex, row: np.ndarray, face: np.ndarray
) -> Bool[np.ndarray, "pairs"]:
    """Pairs whose triangle may come nearer than the best so far: the disc of its radius in its own plane does."""
    offset = points[row] - index.centre[face]
    height = dot(offset, index.normal[face]) * (1 - 1e-9)
    along = np.maximum(dot(offset, offset) - height * height, 0)
    bound = best.distance[row]
    room = np.sqrt(np.maximum(bound * bound - height * height, 0)) + index.radius[face] + 1e-9
    return (np.abs(height) < bound) & (along < room * room)


def centre_tree(points: Float[np.ndarray, "n 3"]) -> KDTree:
    """Midpoint splits: built three times as fast as the balanced tree, for queries as fast on a surface."""
    return KDTree(points, leafsize=24, balanced_tree=False, compact_nodes=False)


def closest_points(points: Float[np.ndarray, "n 3"], index: TriangleIndex) -> ClosestPoints:
    """Exact distance of each point to a mesh, and the face that has it.

    The exact distance to the usual faces with the nearest centres bounds the answer; then every face whose
    bounding sphere reaches into that bound is tried. Most points are done after the first step: the last of
    their NEAREST centres is already too far for its face to matter.
    """
    points = np.asarray(points, np.float64)
    best = ClosestPoints(np.full(len(points), np.inf), np.zeros(len(points), np.int64))
    members, tree = index.classes[0]
    k = min(NEAREST, len(members))
    away, near = (a.reshape(len(points), k) for a in tree.query(points, k=k))
    everyone = np.arange(len(points))
    best = improved(best, points, index.corners, everyone, members[near[:, 0]])
    if k > 1:
        row, face = np.repeat(everyone, k - 1), members[near[:, 1:]].ravel()
        nearer = may_be_nearer(best, points, index, row, face)
        best = improved(best, points, index.corners, row[nearer], face[nearer])
    for number, (members, tree) in enumerate(index.classes):
        reach = best.distance + index.radius[members].max()
        todo = everyone
        if number == 0:
            todo = np.flatnonzero(reach > away[:, -1]) if k < len(members) else todo[:0]
        tried = away[:, -1] * (1 - 1e-9) if number == 0 else np.zeros(len(points))
        best = tried_in_reach(best, points, index, todo, (tried, reach), members, tree)
    return best


def tried_in_reach(
    best: ClosestPoints,
    points: Float[np.ndarray, "n 3"],
    index: TriangleIndex,
    todo: Int[np.ndarray, "m"],
    between: tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]],
    members: Int[np.ndarray, "f"],
    tree: KDTree,
) -> ClosestPoints:
    """`best` after points[todo] tried every face of one class with its centre between two distances."""
    tried, reach = between
    if len(todo) == 0:
        return best
    counts = tree.query_ball_point(points[todo], reach[todo], return_length=True)
    todo, counts = todo[counts > 0], counts[counts > 0]
    sums = np.cumsum(counts)
    start = 0
    # as many points as fit in memory, at least one
    while start < len(todo):
        before = sums[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(sums, before + PAIRS_AT_ONCE, side="right")))
        near = todo[start:stop]
        lists = tree.query_ball_point(points[near], reach[near], return_sorted=False)
        row = np.repeat(near, counts[start:stop])
        face = members[np.concatenate(lists).astype(np.int64)]
        new = np.linalg.norm(points[row] - index.centre[face], axis=-1) >= tried[row]
        row, face = row[new], face[new]
        nearer = may_be_nearer(best, points, index, row, face)
        best = improved(best, points, index.corners, row[nearer], face[nearer])
        start = stop
    return best


def improved(
    best: ClosestPoints, points: np.ndarray, corners: np.ndarray, row: np.ndarray, face: np.ndarray
) -> ClosestPoints:
    """`best` after trying the pairs (points[row], face)."""
    if len(row) == 0:
        return best
    a, b, c = corners[face].transpose(1, 0, 2)
    distance = np.linalg.norm(points[row] - nearest_on_triangles(points[row], a, b, c), axis=-1)
    order = np.lexsort((distance, row))
    first = order[np.r_[True, row[order][1:] != row[order][:-1]]]
    first = first[distance[first] < best.distance[row[first]]]
    best.distance[row[first]] = distance[first]
    best.face[row[first]] = face[first]
    return best


def surface_distance(to_truth: Float[np.ndarray, "n"], to_reconstruction: Float[np.ndarray, "m"]) -> SurfaceDistance:
    """Scores in centimetres from distances in metres; None where there are no samples."""
    p2s = CENTIMETRES * float(to_truth.mean()) if len(to_truth) else None
    completeness = CENTIMETRES * float(to_reconstruction.mean()) if len(to_reconstruction) else None
    both = None if p2s is None or completeness is None else 0.5 * (p2s + completeness)
    return SurfaceDistance(p2s, completeness, both)


def mesh_distance(
    truth: tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]],
    reconstruction: tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, "g 3"]],
    *,
    count: int = 20_000,
    seed: int = 0,
) -> SurfaceDistance:
    """P2S and Chamfer between two whole meshes in metres."""
    check_mesh(*truth, "truth")
    check_mesh(*reconstruction, "reconstruction")
    check_same_unit(truth[0], reconstruction[0])
    on_truth = sample_surface(*truth, count, seed=seed).on(*truth)
    on_reconstruction = sample_surface(*reconstruction, count, seed=seed + 1).on(*reconstruction)
    return surface_distance(
        closest_points(on_reconstruction, triangle_index(*truth)).distance,
        closest_points(on_truth, triangle_index(*reconstruction)).distance,
    )


def rigid_alignment(
    source: Float[np.ndarray, "n 3"], target: TriangleIndex, *, rounds: int = 20
) -> Float[np.ndarray, "4 4"]:
    """target_from_source by point-to-point ICP (Besl and McKay 1992); rigid, never a mirror."""
    target_from_source = np.eye(4)
    moved = np.asarray(source, np.float64)
    for _ in range(rounds):
        a, b, c = target.corners[closest_points(moved, target).face].transpose(1, 0, 2)
        nearest = nearest_on_triangles(moved, a, b, c)
        middle, aim = moved.mean(0), nearest.mean(0)
        U, _, Vt = np.linalg.svd((nearest - aim).T @ (moved - middle))
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = R, aim - R @ middle
        moved = moved @ R.T + step[:3, 3]
        target_from_source = step @ target_from_source
        # a hundredth of a millimetre
        if np.abs(step - np.eye(4)).max() < 1e-5:
            break
    return target_from_source
