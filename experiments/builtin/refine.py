"""Splitting a mesh without cracks: long edges to a length, and any edge along the zero line of a function.

Both keep the surface closed, because a split belongs to an edge and so to both of its faces, and both keep the
texture seams: texture coordinates are split beside the points.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from geometry.mesh import vertex_normals

Array = np.ndarray


@dataclass(frozen=True)
class TexturedMesh:
    """Triangles with texture coordinates of their own and skin weights by vertex."""

    vertices: Float[Array, "vertices 3"]  # metres
    faces: Int[Array, "faces 3"]
    uv: Float[Array, "T 2"]
    uv_faces: Int[Array, "faces 3"]
    weights: Float[Array, "vertices 52"]  # dense: they are interpolated


def edges_of(faces: Int[Array, "faces 3"]) -> tuple[Int[Array, "E 2"], Int[Array, "faces 3"]]:
    """Each edge once, lower vertex first, and for each face the edges 01, 12, 20."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], -1).reshape(-1, 2), axis=1).astype(np.int64)
    keys, index = np.unique(ends[:, 0] << 32 | ends[:, 1], return_inverse=True)
    return np.stack([keys >> 32, keys & 0xFFFFFFFF], -1), index.reshape(-1, 3)


def smoothed(
    values: Float[Array, "vertices D"], faces: Int[Array, "faces 3"], free: Bool[Array, "vertices"], steps: int
) -> Float[Array, "vertices D"]:
    """`steps` half steps of the uniform Laplacian on the free vertices; the others stay."""
    ends, _ = edges_of(faces)
    rows, columns = np.concatenate([ends[:, 0], ends[:, 1]]), np.concatenate([ends[:, 1], ends[:, 0]])
    degree = np.maximum(np.bincount(rows, minlength=len(values)), 1)
    values = values.copy()
    for _ in range(steps):
        for k in range(values.shape[1]):
            mean = np.bincount(rows, values[columns, k], len(values)) / degree
            values[:, k] = np.where(free, 0.5 * (values[:, k] + mean), values[:, k])
    return values


def split_edges(mesh: TexturedMesh, marked: Bool[Array, "E"], at: Float[Array, "E"]) -> TexturedMesh:
    """Put a vertex on each marked edge, at the fraction `at` from its lower vertex, and split its faces.

    A face with one marked edge becomes two, with two three (the shorter diagonal), with three four. The edges
    are those of `edges_of`.
    """
    ends, of_face = edges_of(mesh.faces)
    new = np.full(len(ends), -1)
    new[marked] = len(mesh.vertices) + np.arange(int(marked.sum()))
    t = at[marked][:, None]
    low, high = ends[marked].T

    def between(values):
        return np.concatenate([values, (1 - t) * values[low] + t * values[high]])

    vertices, weights = between(mesh.vertices), between(mesh.weights)

    # the same on texture coordinates: an edge on a seam has two of them
    a, b = mesh.uv_faces, np.roll(mesh.uv_faces, -1, axis=1)
    flip = mesh.faces > np.roll(mesh.faces, -1, axis=1)
    a, b = np.where(flip, b, a), np.where(flip, a, b)
    wanted = marked[of_face]
    key = np.stack([of_face[wanted], a[wanted], b[wanted]], -1)
    key, index = np.unique(key, axis=0, return_inverse=True)
    s = at[key[:, 0]][:, None]
    uv = np.concatenate([mesh.uv, (1 - s) * mesh.uv[key[:, 1]] + s * mesh.uv[key[:, 2]]])
    new_uv = np.full(of_face.shape, -1)
    new_uv[wanted] = len(mesh.uv) + index.ravel()

    corners = np.stack([mesh.faces, mesh.uv_faces], -1)  # (F, 3, 2): vertex and texture coordinate
    middles = np.stack([new[of_face], new_uv], -1)
    count = wanted.sum(1)
    first = np.where(count == 1, wanted.argmax(1), np.where(count == 2, (wanted.argmin(1) + 1) % 3, 0))
    turn = (first[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, turn[..., None], 1)
    middles = np.take_along_axis(middles, turn[..., None], 1)

    def faces_of(rows, *triples):
        points = {
            **{f"c{i}": corners[rows, i] for i in range(3)},
            **{f"m{i}": middles[rows, i] for i in range(3)},
        }
        return [np.stack([points[name] for name in triple.split()], 1) for triple in triples]

    parts = faces_of(count == 0, "c0 c1 c2") + faces_of(count == 1, "c0 m0 c2", "m0 c1 c2")
    two = count == 2
    short = np.linalg.norm(vertices[middles[:, 1, 0]] - vertices[corners[:, 0, 0]], axis=1) < np.linalg.norm(
        vertices[corners[:, 2, 0]] - vertices[middles[:, 0, 0]], axis=1
    )
    parts += faces_of(two, "m0 c1 m1")
    parts += faces_of(two & short, "c0 m0 m1", "c0 m1 c2") + faces_of(two & ~short, "c0 m0 c2", "m0 m1 c2")
    parts += faces_of(count == 3, "c0 m0 m2", "m0 c1 m1", "m2 m1 c2", "m0 m1 m2")
    faces = np.concatenate(parts)
    return TexturedMesh(vertices, faces[..., 0], uv, faces[..., 1], weights)


def refined(
    mesh: TexturedMesh, longest: Callable[[Float[Array, "vertices 3"]], Float[Array, "vertices"]], rounds: int = 3
) -> TexturedMesh:
    """Split edges longer than `longest` allows at both ends, metres, rounding the surface a little on the way.

    The new point is the edge's middle moved 0.6 of the way to the mean of its projections on the tangent planes
    of the edge's ends (Boubekeur and Alexa 2008, Phong tessellation); old vertices stay where they are.
    """
    for _ in range(rounds):
        ends, _ = edges_of(mesh.faces)
        a, b = (mesh.vertices[ends[:, i]] for i in range(2))
        marked = np.linalg.norm(b - a, axis=1) > longest(mesh.vertices)[ends].max(1)
        if not marked.any():
            break
        normals = vertex_normals(mesh.vertices, mesh.faces)
        n, m = (normals[ends[marked, i]] for i in range(2))
        middle = 0.5 * (a[marked] + b[marked])
        towards = [((p[marked] - middle) * d).sum(1, keepdims=True) * d for p, d in ((a, n), (b, m))]
        rise = 0.6 * 0.5 * (towards[0] + towards[1])
        # only outwards: hollows, split unevenly, would ripple
        rise[(rise * (n + m)).sum(1) < 0] = 0
        count = len(mesh.vertices)
        mesh = split_edges(mesh, marked, np.full(len(ends), 0.5))
        vertices = mesh.vertices.copy()
        vertices[count:] += rise
        mesh = replace(mesh, vertices=vertices)
    return mesh


def cut_along(mesh: TexturedMesh, values: Float[Array, "vertices"], level: float, *, snap: float = 0.2) -> TexturedMesh:
    """Split every edge where `values` (by vertex) crosses `level`, so that the line runs along edges.

    A vertex within `snap` of an edge's length from the line is moved onto it along that edge instead: no slivers.
    """
    ends, _ = edges_of(mesh.faces)
    s = values - level
    a, b = s[ends[:, 0]], s[ends[:, 1]]
    crossing = a * b < 0
    t = np.where(crossing, a / np.where(crossing, a - b, 1), 0.5)
    vertices, snapped = mesh.vertices.copy(), np.zeros(len(s), bool)
    for side, near in ((0, t < snap), (1, t > 1 - snap)):
        edge = np.flatnonzero(crossing & near)
        vertex, first = np.unique(ends[edge, side], return_index=True)
        edge = edge[first]
        low, high = mesh.vertices[ends[edge, 0]], mesh.vertices[ends[edge, 1]]
        vertices[vertex] = low + t[edge, None] * (high - low)
        snapped[vertex] = True
    crossing &= ~snapped[ends].any(1)
    return split_edges(replace(mesh, vertices=vertices), crossing, t)
