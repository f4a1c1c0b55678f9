"""What a level of an avatar file shows of itself: parts, texel sizes, chart seams, cones, whether it is closed.

Everything is computed from the file alone, not from what baking wrote into it, so that the two can be compared.
Frame: canonical, metres.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from avatar.baked_avatar import Level
from avatar.skeleton import JOINTS, LEFT_HAND, RIGHT_HAND
from avatar.texture import mipmaps
from bake.cone import matrix_from_six
from bake.texture.seams import chart_edges, seam_steps

MIPS = 4
SAMPLES = 5  # along a seam edge


class Welded(NamedTuple):
    """The surface before the atlas cut it: vertices at one place with one skin are one."""

    # welded vertex of each vertex of the level
    source: Int[np.ndarray, "vertices"]
    faces: Int[np.ndarray, "faces 3"]
    count: int


class Seams(NamedTuple):
    """Edges whose two triangles lie in different places of the texture."""

    edges: Int[np.ndarray, "edges 2"]  # vertices of the level, on one side
    step: Float[np.ndarray, "mips edges"]  # largest difference of the two sides' colors along the edge, 0 to 255
    # a seam's samples, as bake.seams.seam_steps counts them
    steps: Float[np.ndarray, "mips samples"]


class Closedness(NamedTuple):
    """How the triangles meet: a baked avatar has two at every edge."""

    open_edges: int
    crowded_edges: int  # more than two triangles
    pieces: int


def joint_parts() -> UInt8[np.ndarray, "52"]:
    """Part of each joint: head, hands (fingers and wrist) and the body."""
    part = np.zeros(52, np.uint8)
    part[JOINTS.index("head")] = 1
    part[LEFT_HAND], part[RIGHT_HAND] = 2, 3
    part[JOINTS.index("left_wrist")], part[JOINTS.index("right_wrist")] = 2, 3
    return part


def heaviest_joint(level: Level) -> Int[np.ndarray, "vertices"]:
    """The joint that moves each vertex most."""
    rows = np.arange(len(level.joints))
    return level.joints[rows, level.weights.argmax(1)].astype(np.int64)


def joint_weight(level: Level, joint: int) -> Float[np.ndarray, "vertices"]:
    """Weight of one joint at each vertex, 0 to 1."""
    return (np.where(level.joints == joint, level.weights, 0).sum(1) / 255).astype(np.float64)


def vertex_parts(level: Level) -> UInt8[np.ndarray, "vertices"]:
    """Part of each vertex, by the joint that moves it most."""
    return joint_parts()[heaviest_joint(level)]


def face_parts(level: Level) -> UInt8[np.ndarray, "faces"]:
    """Part of each triangle: what two of its corners say, else the first corner's."""
    a, b, c = vertex_parts(level)[level.faces].T
    return np.where(b == c, b, a)


def areas(level: Level) -> Float[np.ndarray, "faces"]:
    """Square metres of each triangle."""
    a, b, c = level.positions.astype(np.float64)[level.faces].transpose(1, 0, 2)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def edge_millimetres(level: Level) -> Float[np.ndarray, "faces"]:
    """Mean length of a triangle's edges."""
    corners = level.positions.astype(np.float64)[level.faces]
    return 1e3 * np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(1)


def texel_millimetres(level: Level) -> Float[np.ndarray, "faces"]:
    """Side of a texel on each triangle: sqrt(area on the surface / area in texels); NaN without texels."""
    height, width = level.base_color.shape[:2]
    a, b, c = (level.uv.astype(np.float64)[level.faces] * [width, height]).transpose(1, 0, 2)
    texels = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(texels > 1e-9, 1e3 * np.sqrt(areas(level) / texels), np.nan)


def median_by_area(values: Float[np.ndarray, "n"], weight: Float[np.ndarray, "n"]) -> float | None:
    """The value that half of the weight lies below; None where there is none."""
    known = np.isfinite(values) & (weight > 0)
    if not known.any():
        return None
    order = np.argsort(values[known])
    below = np.cumsum(weight[known][order])
    return float(values[known][order][np.searchsorted(below, 0.5 * below[-1])])


def weld(level: Level) -> Welded:
    """Undo the cuts of the atlas: vertices of equal place, joints and weights were one."""
    joints = np.where(level.weights > 0, level.joints, 0)
    keys = np.concatenate(
        [np.ascontiguousarray(level.positions + np.float32(0)).view(np.uint32), joints, level.weights], axis=1
    )
    _, source = np.unique(keys, axis=0, return_inverse=True)
    source = source.reshape(-1)
    return Welded(source, source[level.faces.astype(np.int64)], int(source.max()) + 1)


def closedness(welded: Welded) -> Closedness:
    """Edges with one triangle, edges with more than two, and connected pieces."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = np.sort(np.concatenate([welded.faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    _, uses = np.unique(ends, axis=0, return_counts=True)
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(welded.count, welded.count))
    pieces = connected_components(graph, directed=False)[1][np.unique(welded.faces)]
    return Closedness(int((uses == 1).sum()), int((uses > 2).sum()), len(np.unique(pieces)))


def seams(level: Level, welded: Welded) -> Seams:
    """Chart edges and the step of color across them, on the texture and its first mipmaps."""
    uv = level.uv.astype(np.float64)
    edges = chart_edges(uv, level.faces.astype(np.int64), welded.source)
    steps = []
    for image in mipmaps(level.base_color, MIPS):
        steps.append(seam_steps(uv, edges, image, samples=SAMPLES).reshape(SAMPLES, len(edges.left)))
    table = np.stack(steps)
    return Seams(edges.left, table.max(1), table.reshape(MIPS, -1))


def cone_degrees(level: Level) -> Float[np.ndarray, "vertices 2"]:
    """Widest and narrowest half-angle, degrees, that view dependence may reach from the global direction.

    t' = v t / sqrt(1 + t^T Q t) is longest at |t| = 1 (docs/avatar-format.md): asin(v / sqrt(1 + q)) along the axis
    of Q with eigenvalue q, of the two axes across the view direction.
    """
    q = matrix_from_six(level.view_q.astype(np.float64))
    d = level.view_dir.astype(np.float64)
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    values = np.linalg.eigvalsh(across @ q @ across + 1e9 * d[:, :, None] * d[:, None, :])[:, :2]
    reach = level.view_seen[:, None].astype(np.float64) / np.sqrt(1 + np.maximum(values, 0))
    return np.degrees(np.arcsin(np.clip(reach, 0, 1)))


def unseen(level: Level) -> Bool[np.ndarray, "vertices"]:
    """Vertices that no camera looked at in training."""
    return level.view_seen <= 0


def share_of_area(level: Level, chosen: Bool[np.ndarray, "vertices"]) -> float:
    """Part of the surface that belongs to these vertices."""
    area = areas(level)
    return float((area * chosen[level.faces].mean(1)).sum() / max(area.sum(), 1e-30))
