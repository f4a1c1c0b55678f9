"""Vertex bytes as the GPU reads them, in an order that keeps neighbours together."""

import moderngl
import numpy as np
from jaxtyping import Float, Int, UInt32

from avatar.baked_avatar import Level

VERTEX = np.dtype([("position", "f4", 3), ("uv", "f4", 2), ("joints", "u1", 4), ("weights", "u1", 4)])
VIEW_VERTEX = np.dtype([("mean", "f4", 3), ("q", "f4", 6), ("seen", "f4")])


def interleaved(level: Level) -> np.ndarray:
    """Position, uv and skin of each vertex, 28 bytes; the heaviest bone comes first (shaders/directions.glsl)."""
    out = np.zeros(len(level.positions), VERTEX)
    joints, weights = level.drawn_skin
    heaviest_first = np.argsort(-weights.astype(np.int16), axis=1, kind="stable")
    out["position"], out["uv"] = level.positions, level.uv
    out["joints"] = np.take_along_axis(joints, heaviest_first, 1)
    out["weights"] = np.take_along_axis(weights, heaviest_first, 1)
    return out


def view_interleaved(level: Level) -> np.ndarray:
    """Global view direction, cone and confidence of each vertex, 40 bytes."""
    out = np.zeros(len(level.positions), VIEW_VERTEX)
    out["mean"], out["q"], out["seen"] = level.view_dir, level.view_q, level.view_seen
    return out


def draw_order(
    positions: Float[np.ndarray, "vertices 3"], faces: UInt32[np.ndarray, "faces 3"]
) -> tuple[Int[np.ndarray, "used"], UInt32[np.ndarray, "faces 3"]]:
    """Faces along a Morton curve, vertices in the order of their first use, if any: (order, renumbered faces).

    A software rasteriser shades vertices anew for each run of some 340 faces; neighbours in one run share them
    (26,756 faces of the built-in body: 19,000 vertices shaded instead of 25,800, 78,000 at random).
    """
    faces = faces[np.argsort(morton(positions[faces].mean(1)), kind="stable")]
    flat = faces.reshape(-1).astype(np.int64)
    used, first = np.unique(flat, return_index=True)
    order = used[np.argsort(first)]
    number = np.zeros(len(positions), np.uint32)
    number[order] = np.arange(len(order), dtype=np.uint32)
    return order, number[flat].reshape(-1, 3)


def morton(points: Float[np.ndarray, "points 3"]) -> Int[np.ndarray, "points"]:
    """Position of each point along a Z-order curve of 1024 cells a side."""
    low = points.min(0, initial=np.inf)
    side = max(float((points - low).max(initial=0)), 1e-9)
    cell = np.minimum((points - low) / side * 1024, 1023).astype(np.int64)
    out = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            out |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return out


def attributes_read(program: moderngl.Program, layout: str, *names: str) -> tuple[str, ...]:
    """The layout of a buffer for a program: what it does not read is passed over."""
    parts, each = layout.split()[: len(names)], layout.split()[len(names) :]
    read = [name in program for name in names]
    skipped = [part if there else f"{int(part[0]) * int(part[2])}x" for part, there in zip(parts, read, strict=True)]
    return " ".join([*skipped, *each]), *(name for name, there in zip(names, read, strict=True) if there)
