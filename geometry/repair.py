"""Closed, oriented 2-manifolds: what keeps a mesh from being one, and its repair.

trimesh reports whether a mesh is watertight and fills holes of three or four edges; it neither finds vertices at which
two fans touch nor separates sheets that share an edge.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Integer
from numpy import ndarray as Array

from command.errors import AssetError
from geometry.mesh import TriangleMesh, connected, half_edges, largest_component


class Fault(NamedTuple):
    """What keeps a mesh from being one closed, oriented 2-manifold; all zero when nothing does."""

    open_edges: int  # used by one triangle
    # used by three or more, or twice in the same direction
    crowded_edges: int
    # their triangles form more than one fan
    split_vertices: int
    # triangles that name a vertex twice
    degenerate: int

    def __bool__(self) -> bool:
        return any(self)


def find_faults(faces: Integer[Array, "faces 3"], count: int) -> Fault:
    """Edges and vertices at which the mesh is not a closed oriented 2-manifold."""
    degenerate = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    directed = half_edges(faces)
    times, both = (np.unique(_keys(ends, count), return_counts=True)[1] for ends in (directed, np.sort(directed)))
    crowded = int((both > 2).sum()) + int((times > 1).sum())
    fans = _fans(faces, count)
    owners = np.unique(faces.reshape(-1).astype(np.int64) * (fans.max() + 1) + fans) // (fans.max() + 1)
    split = int((np.bincount(owners, minlength=count) > 1).sum())
    return Fault(int((both == 1).sum()), crowded, split, int(degenerate.sum()))


def _fans(faces: Integer[Array, "faces 3"], count: int) -> Integer[Array, "corners"]:
    """Fan label of every corner (face-major): corners at one vertex share it if their triangles share an edge there."""
    corner = np.arange(faces.size).reshape(-1, 3)
    # each undirected edge joins, in its two triangles, the corners at its two ends
    start = np.concatenate([corner[:, 0], corner[:, 1], corner[:, 2]])
    end = np.concatenate([corner[:, 1], corner[:, 2], corner[:, 0]])
    pair = half_edges(faces)
    flipped = pair[:, 0] > pair[:, 1]
    low, high = np.where(flipped, end, start), np.where(flipped, start, end)
    key = _keys(np.sort(pair), count)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    left, right = order[same], order[same + 1]
    pairs = np.stack([np.concatenate([low[left], high[left]]), np.concatenate([low[right], high[right]])], 1)
    return connected(pairs, faces.size)


def split_nonmanifold(mesh: TriangleMesh, *, rounds: int = 6) -> TriangleMesh:
    """Sheets that were collapsed onto one edge, separated again without losing a triangle.

    The triangles round a crowded edge are paired across the solid wedges between them; every pair but the
    first gets a midpoint of its own, and fans that touch in one vertex a copy each. A closed mesh comes back
    closed and manifold; edges whose triangles do not pair up (an open mesh) are left for `repair`.
    """
    vertices, faces = mesh.vertices, mesh.faces.copy()
    for _ in range(rounds):
        directed = half_edges(faces)
        pair = np.sort(directed)
        key = _keys(pair, len(vertices))
        order = np.argsort(key, kind="stable")
        starts = np.flatnonzero(np.r_[True, np.diff(key[order]) > 0, True])
        crowded = [order[a:b] for a, b in zip(starts[:-1], starts[1:], strict=True) if b - a > 2]
        if not crowded:
            break
        touched, added, points = set[int](), list[Array](), list[Array]()
        for uses in crowded:
            (u, v), owners = pair[uses[0]].tolist(), uses % len(faces)
            own = set(owners.tolist())
            if touched & own or len(own) < len(owners):
                # changed in this round already: the next one sees it
                continue
            wedges = _wedges(vertices, faces, pair[uses[0]], directed[uses], owners)
            if wedges is None:
                continue
            touched |= own
            for wedge in wedges[1:]:
                middle = len(vertices) + len(points)
                points.append(vertices[[u, v]].mean(0))
                for face in owners[list(wedge)]:
                    whole = faces[face]
                    added.append(np.where(whole == u, middle, whole))
                    faces[face] = np.where(whole == v, middle, whole)
        if not touched:
            break
        if points:
            vertices = np.concatenate([vertices, np.array(points)])
            faces = np.concatenate([faces, np.array(added)])
    return _split_touching_fans(vertices, faces)


def _wedges(vertices: Array, faces: Array, edge: Array, directed: Array, owners: Array) -> list[tuple[int, int]] | None:
    """Pairs of uses of an edge with the solid between them; None when forward and backward uses do not match.

    Round the edge (from its lower to its higher vertex) a triangle that runs forward faces larger angles, so
    the solid lies below it, down to the next triangle that runs backward.
    """
    forward = directed[:, 0] == edge[0]
    if forward.sum() * 2 != len(forward):
        return None
    apex = vertices[faces[owners].sum(1) - edge.sum()] - vertices[edge[0]]
    axis = vertices[edge[1]] - vertices[edge[0]]
    axis = axis / max(float(np.linalg.norm(axis)), 1e-20)
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first /= max(float(np.linalg.norm(first)), 1e-20)
    angle = np.arctan2(apex @ np.cross(axis, first), apex @ first)
    free, result = {int(i) for i in np.flatnonzero(forward)}, []
    for back in np.flatnonzero(~forward)[np.argsort(angle[~forward], kind="stable")]:
        ahead = min(free, key=lambda i: ((angle[i] - angle[back]) % (2 * np.pi), i))
        free.remove(ahead)
        result.append((int(back), ahead))
    return result


def _split_touching_fans(vertices: Array, faces: Array) -> TriangleMesh:
    """Fans that touch in one vertex get a copy of it each."""
    fans = _fans(faces, len(vertices))
    key = faces.reshape(-1).astype(np.int64) * (fans.max() + 1) + fans
    owners, renumbered = np.unique(key, return_inverse=True)
    return TriangleMesh(vertices[owners // (fans.max() + 1)], renumbered.reshape(-1, 3))


def repair(mesh: TriangleMesh, *, rounds: int = 8) -> TriangleMesh:
    """Close what a collapse tore open: crowded edges lose their triangles, touching fans are split, and every
    hole is closed by a fan about its centre. The mesh that comes back has no faults, or AssetError."""
    vertices, faces = mesh.vertices, mesh.faces
    for _ in range(rounds):
        distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        faces = faces[distinct]
        _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
        faces = faces[np.sort(first)]
        faces = faces[~_crowded(faces, len(vertices))]
        if len(faces) == 0:
            break
        vertices, faces = _split_touching_fans(vertices, faces)
        loops = _boundary_loops(faces, len(vertices))
        fans = [np.stack([np.roll(loop, -1), loop, 0 * loop + len(vertices) + i], 1) for i, loop in enumerate(loops)]
        vertices = np.concatenate([vertices, *(vertices[loop].mean(0, keepdims=True) for loop in loops)])
        faces = np.concatenate([faces, *fans])
        closed, _, _ = largest_component(TriangleMesh(vertices, faces))
        if not find_faults(closed.faces, len(closed.vertices)):
            return closed
        vertices, faces = closed
    fault = find_faults(faces, len(vertices)) if len(faces) else "no triangle left"
    raise AssetError(f"surface: should close into a manifold in {rounds} rounds of repair, left {fault}")


def _crowded(faces: Integer[Array, "faces 3"], count: int) -> Array:
    """Triangles at an edge used by more than two, or twice in one direction."""
    bad, directed = np.zeros(faces.size, bool), half_edges(faces)
    for ends, most in ((directed, 1), (np.sort(directed), 2)):
        _, inverse, times = np.unique(_keys(ends, count), return_inverse=True, return_counts=True)
        bad |= times[inverse] > most
    return np.any(bad.reshape(3, -1), axis=0)


def _keys(ends: Integer[Array, "edges 2"], count: int) -> Integer[Array, "edges"]:
    """A number for each edge of a mesh of `count` vertices, by its ends in their order."""
    return ends[:, 0].astype(np.int64) * count + ends[:, 1]


def _boundary_loops(faces: Integer[Array, "faces 3"], count: int) -> list[Array]:
    """Closed chains of edges used once, in the direction of their triangles. Fans are split: chains are simple."""
    directed = half_edges(faces)
    lone = ~np.isin(_keys(directed, count), _keys(directed[:, ::-1], count))
    following = dict(zip(directed[lone, 0].tolist(), directed[lone, 1].tolist(), strict=True))
    loops = []
    while following:
        start, nxt = following.popitem()
        loop = [start]
        while nxt != start:
            loop.append(nxt)
            nxt = following.pop(nxt)
        loops.append(np.array(loop))
    return loops
