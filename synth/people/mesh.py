"""Pieces of a dressed person: sheets of cloth or hair given a thickness, lofts of rings, and their texture coordinates.

Frame: pose 0, pelvis at the origin, metres. Rings run from +z (the front) by +x (the person's left) round to the back.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.sparse import csr_matrix, diags
from scipy.spatial import ConvexHull

from geometry.mesh import half_edges, neighbour_matrix, vertex_normals
from synth.people.cloth import Picture

Loft = tuple[Float[Array, "points 3"], Int[Array, "faces 3"], Float[Array, "faces 3 2"]]


@dataclass(frozen=True)
class PersonPiece:
    """Triangles that show one picture."""

    kind: str  # "skin", "eye", "hair", "cloth" or "shoe"
    points: Float[Array, "points 3"]
    faces: Int[Array, "faces 3"]
    uv: Float[Array, "faces 3 2"]  # v runs down; beyond 0 and 1 the picture repeats
    weights: Float[Array, "points 52"]
    picture: Picture


def half_step(faces: Int[Array, "faces 3"], count: int) -> csr_matrix:
    """The matrix that moves values on a mesh half of the way to the mean of their neighbours."""
    near = neighbour_matrix(faces, count)
    degree = np.maximum(np.asarray(near.sum(1)).ravel(), 1)
    return csr_matrix(0.5 * (diags(1 / degree) @ near + diags(np.ones(count))))


def in_four(faces: Int[Array, "faces 3"], count: int) -> tuple[Int[Array, "more 3"], Int[Array, "edges 2"]]:
    """Every face in four, and the edges whose middles are new points behind the `count` that there were."""
    edges, index = np.unique(np.sort(half_edges(faces), 1), axis=0, return_inverse=True)
    (a, b, c), (ab, bc, ca) = faces.T, count + index.reshape(3, -1)
    corners = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.concatenate([np.stack(corner, 1) for corner in corners]), edges


def rim_edges(faces: Int[Array, "faces 3"], count: int) -> tuple[Bool[Array, "3*faces"], Int[Array, "rim 2"]]:
    """The directed edges that one face alone has: which of all half edges, and themselves."""
    ends = half_edges(faces).astype(np.int64)
    rim = ~np.isin(ends @ [count, 1], ends @ [1, count])
    return rim, ends[rim]


def hemmed(points: Float[Array, "points 3"], faces: Int[Array, "faces 3"], steps: int = 12) -> Float[Array, "points 3"]:
    """The points of a sheet with its edges smoothed along themselves."""
    _, ends = rim_edges(faces, len(points))
    ends = np.concatenate([ends, ends[:, ::-1]])
    near = np.maximum(np.bincount(ends[:, 0], minlength=len(points)), 1)[:, None]
    for _ in range(steps):
        away = np.zeros_like(points)
        np.add.at(away, ends[:, 0], points[ends[:, 1]] - points[ends[:, 0]])
        points = points + 0.5 * away / near
    return points


def shell(piece: PersonPiece, thickness: Float[Array, "points"] | float) -> PersonPiece:
    """The sheet closed: itself as the outside, an inside `thickness` under it, and a rim round every opening."""
    points, faces, count = piece.points, piece.faces, len(piece.points)
    inner = points - np.broadcast_to(thickness, count)[:, None] * vertex_normals(points, faces)
    rim, ends = rim_edges(faces, count)
    a, b = ends.T
    p, q = np.concatenate([piece.uv[:, [0, 1]], piece.uv[:, [1, 2]], piece.uv[:, [2, 0]]])[rim].swapaxes(0, 1)
    sides = np.stack([b, a, a + count], 1), np.stack([b, a + count, b + count], 1)
    return replace(
        piece,
        points=np.concatenate([points, inner]),
        faces=np.concatenate([faces, faces[:, ::-1] + count, *sides]),
        uv=np.concatenate([piece.uv, piece.uv[:, ::-1], np.stack([q, p, p], 1), np.stack([q, p, q], 1)]),
        weights=np.tile(piece.weights, (2, 1)),
    )


def loft(rings: Float[Array, "rings around 3"], u: Float[Array, "columns"], v: Float[Array, "rings"]) -> Loft:
    """Points, faces and texture coordinates of the surface through rings that run downwards.

    With one more column in `u` than a ring has points the surface is closed round; else it is a sheet.
    """
    (count, around), columns = rings.shape[:2], len(u)
    k, i = (grid.ravel() for grid in np.meshgrid(np.arange(count - 1), np.arange(columns - 1), indexing="ij"))
    a = k * columns + i
    below, after = a + columns, a + 1
    corners = np.concatenate([np.stack([a, below, below + 1], 1), np.stack([a, below + 1, after], 1)])
    row, column = np.divmod(corners, columns)
    return rings.reshape(-1, 3), row * around + column % around, np.stack([u[column], v[row]], -1)


def tube(path: Float[Array, "rings 3"], radius: Float[Array, "rings around"]) -> Float[Array, "rings around 3"]:
    """Rings about a path, across it."""
    along = np.gradient(path, axis=0)
    across = np.cross(along, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    beside = np.cross(across, along / np.linalg.norm(along, axis=1, keepdims=True))
    angle = 2 * np.pi * np.arange(radius.shape[1])[:, None] / radius.shape[1]
    return path[:, None] + radius[..., None] * (np.cos(angle) * across[:, None] + np.sin(angle) * beside[:, None])


def ended(rings: Float[Array, "rings around 3"]) -> Float[Array, "more around 3"]:
    """The rings between their middles, each repeated as a ring: the loft is closed at either end."""
    middle = np.broadcast_to(rings.mean(1, keepdims=True), rings.shape)
    return np.concatenate([middle[:1], rings, middle[-1:]])


def reach(points: Float[Array, "n 2"], angle: Float[Array, "around"]) -> Float[Array, "around"]:
    """How far from the origin the convex outline of points in (x, z) lies in directions from +z towards +x.

    The origin lies inside; a ray leaves the outline at the nearest of its edges' lines.
    """
    outline = points[ConvexHull(points).vertices]
    edge = np.roll(outline, -1, axis=0) - outline
    normal = np.stack([edge[:, 1], -edge[:, 0]], 1)
    facing = np.stack([np.sin(angle), np.cos(angle)], 1) @ normal.T
    return np.where(facing > 1e-12, (normal * outline).sum(1) / np.maximum(facing, 1e-12), np.inf).min(1)


def unrolled(
    angle: Float[Array, "points"], along: Float[Array, "points"], faces: Int[Array, "faces 3"], repeats: float
) -> Float[Array, "faces 3 2"]:
    """Texture coordinates round an axis: `repeats` pictures a turn, and `along` of them down."""
    apart = angle[faces] - angle[faces[:, :1]]
    turn = angle[faces[:, :1]] + apart - 2 * np.pi * np.round(apart / (2 * np.pi))
    return np.stack([turn * repeats / (2 * np.pi), along[faces]], -1)


def trimmed(
    inside: Float[Array, "points"], faces: Int[Array, "faces 3"], values: Sequence[Float[Array, "points _"]]
) -> tuple[Int[Array, "left 3"], list[Float[Array, "kept _"]]]:
    """The part of a mesh where `inside` is positive, its edge on the zero line: faces, and the values of its points.

    A point outside slides along the edge to its innermost neighbour until it meets the line.
    """
    faces = faces[(inside[faces] > 0).any(1)]
    ends = half_edges(faces)
    ends = np.concatenate([ends, ends[:, ::-1]])
    ends = ends[(inside[ends[:, 0]] <= 0) & (inside[ends[:, 1]] > 0)]
    # the innermost last: NumPy keeps the last of repeated indices
    out, into = ends[np.argsort(inside[ends[:, 1]], kind="stable")].T
    partner, share = np.arange(len(inside)), np.zeros((len(inside), 1))
    partner[out], share[out, 0] = into, inside[out] / (inside[out] - inside[into])
    kept, index = np.unique(faces, return_inverse=True)
    return index.reshape(-1, 3), [((1 - share) * value + share * value[partner])[kept] for value in values]


def waves(points: Float[Array, "n d"], scale: Sequence[float], rng: np.random.Generator) -> Float[Array, "n"]:
    """Smooth noise of about -1 to 1: twelve plane waves in random directions, `scale` radians a metre on each axis."""
    direction = rng.standard_normal((12, len(scale))) * scale
    return np.sin(points @ direction.T + rng.uniform(0, 2 * np.pi, 12)).sum(1) / 4


def smoothstep(low: float | Array, high: float | Array, x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """0 below `low`, 1 above `high`, smooth between; the other way round where low > high."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
