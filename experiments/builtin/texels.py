"""The texels that a mesh covers in its texture, and what lies under each."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.ndimage import distance_transform_edt

Array = np.ndarray


@dataclass(frozen=True)
class Texels:
    """The covered texels of one texture and what lies under each."""

    index: Int[Array, "n"]  # row * width + column
    face: Int[Array, "n"]
    barycentric: Float[Array, "n 3"]


def covered_texels(uv: Float[Array, "faces 3 2"], size: int, chunk: int = 400_000) -> Texels:
    """Texel centres inside triangles of texture coordinates (v down); the later triangle wins on an edge."""
    pixel = uv * size - 0.5
    low = np.maximum(np.ceil(pixel.min(1) - 1e-9), 0).astype(np.int64)
    high = np.minimum(np.floor(pixel.max(1) + 1e-9), size - 1).astype(np.int64)
    extent = np.maximum(high - low + 1, 0)
    area = extent[:, 0] * extent[:, 1]
    found: list[tuple] = []
    edges = np.searchsorted(np.cumsum(area), np.arange(chunk, area.sum() + chunk, chunk))
    start = 0
    for stop in [*(edges + 1), len(uv)]:
        rows = np.arange(start, min(stop, len(uv)))
        start = max(start, min(stop, len(uv)))
        if not len(rows):
            continue
        face = np.repeat(rows, area[rows])
        step = np.arange(len(face)) - np.repeat(np.cumsum(area[rows]) - area[rows], area[rows])
        x = low[face, 0] + step % np.maximum(extent[face, 0], 1)
        y = low[face, 1] + step // np.maximum(extent[face, 0], 1)
        a, b, c = pixel[face].transpose(1, 0, 2)
        p = np.stack([x, y], -1)

        def cross(u, v):
            return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

        whole = cross(b - a, c - a)
        whole = np.where(np.abs(whole) < 1e-12, np.inf, whole)
        s, t = cross(p - a, c - a) / whole, cross(b - a, p - a) / whole
        inside = (s >= -1e-6) & (t >= -1e-6) & (s + t <= 1 + 1e-6) & np.isfinite(whole)
        s, t = s[inside], t[inside]
        found.append(((y * size + x)[inside], face[inside], np.stack([1 - s - t, s, t], -1)))
    index, face, barycentric = (np.concatenate(parts) for parts in zip(*found))
    owner = np.full(size * size, -1)
    owner[index] = np.arange(len(index))
    kept = owner[owner >= 0]
    return Texels(index[kept], face[kept], barycentric[kept].astype(np.float32))


def spread(
    image: Float[Array, "height width 3"], covered: Bool[Array, "height width"]
) -> UInt8[Array, "height width 3"]:
    """The image in 8 bits; what no triangle covers gets the nearest color, so that filtering finds no seam."""
    nearest = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    assert nearest is not None
    return np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)[nearest[0], nearest[1]]
