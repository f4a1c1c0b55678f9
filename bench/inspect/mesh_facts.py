"""What a level of an avatar file shows of itself: chart seams, cones, whether it is closed.

Everything is computed from the file alone, not from what baking wrote into it, so that the two can be compared.
Frame: canonical, metres.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from avatar.baked_avatar import Level
from avatar.texture import mipmaps
from bake.cone import matrix_from_six
from bake.texture.seams import chart_edges, seam_steps
from geometry.mesh import component_labels, face_areas, half_edges

MIPS = 4
SAMPLES = 5  # along a seam edge


class Seams(NamedTuple):
    """Edges whose two triangles lie in different places of the texture."""

    edges: Int[np.ndarray, "edges 2"]  # vertices of the level, on one side
    # differences of the two sides' colors, 0 to 255, at SAMPLES places along each edge
    steps: Float[np.ndarray, "mips samples edges"]


class Closedness(NamedTuple):
    """How the triangles meet: a baked avatar has two at every edge."""

    open_edges: int
    crowded_edges: int  # more than two triangles
    pieces: int


def weld(level: Level) -> Int[np.ndarray, "vertices"]:
    """The surface before the atlas cut it: the number of each vertex's place and skin, equal where they are."""
    joints = np.where(level.weights > 0, level.joints, 0)
    places = np.ascontiguousarray(level.positions + np.float32(0)).view(np.uint32)
    return np.unique(np.concatenate([places, joints, level.weights], 1), axis=0, return_inverse=True)[1].reshape(-1)


def closedness(level: Level) -> Closedness:
    """Edges with one triangle, edges with more than two, and connected pieces, once welded."""
    source = weld(level)
    faces = source[level.faces]
    _, uses = np.unique(np.sort(half_edges(faces), axis=1), axis=0, return_counts=True)
    pieces = np.unique(component_labels(faces, int(source.max()) + 1)[faces])
    return Closedness(int((uses == 1).sum()), int((uses > 2).sum()), len(pieces))


def seams(level: Level) -> Seams:
    """Chart edges and the step of color across them, on the texture and its first mipmaps."""
    uv = level.uv.astype(np.float64)
    edges = chart_edges(uv, level.faces.astype(np.int64), weld(level))
    steps = [seam_steps(uv, edges, image, samples=SAMPLES) for image in mipmaps(level.base_color, MIPS)]
    return Seams(edges.left, np.reshape(steps, (MIPS, SAMPLES, len(edges.left))))


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


def share_of_area(level: Level, chosen: Bool[np.ndarray, "vertices"]) -> float:
    """Part of the surface that belongs to these vertices."""
    area = face_areas(level.positions, level.faces)
    return float((area * chosen[level.faces].mean(1)).sum() / max(area.sum(), 1e-30))
