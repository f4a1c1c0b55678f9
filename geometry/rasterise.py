"""Which triangle each pixel sees: a z-buffer in NumPy, where no graphics context is wanted."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.camera import Camera, project

# pixels of bounding boxes tried at once; bounds the memory to some 100 MB
CANDIDATES = 1 << 20


class FaceBuffer(NamedTuple):
    """What each pixel centre sees."""

    # -1 where there is nothing
    face: Int[Array, "height width"]
    # along the optical axis, the unit of the vertices; inf where nothing
    depth: Float[Array, "height width"]


class _Projected(NamedTuple):
    """Triangles on the picture."""

    corner: Float[Array, "faces 3 2"]  # pixels
    closeness: Float[Array, "faces 3"]  # 1 / depth
    area: Float[Array, "faces"]  # twice the signed one, square pixels
    low: Int[Array, "faces 2"]  # first column and row of the pixels tried
    size: Int[Array, "faces 2"]  # columns and rows


def rasterise(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], camera: Camera, *, near: float = 1e-3
) -> FaceBuffer:
    """The nearest triangle through every pixel centre; both sides are drawn.

    1/depth is linear on the image of a triangle, so it is what is interpolated and compared. Triangles with a
    corner nearer than `near` are left out, not clipped; lens distortion moves corners, edges stay straight.
    A pixel centre exactly on an edge belongs to both triangles, so a closed surface has no pinholes.
    """
    width, height = camera.size
    pixels, depth = project(camera, vertices)
    corner, z = pixels[faces], depth[faces]
    low = np.ceil(np.clip(corner.min(1), -1, [width, height]) - 0.5).astype(np.int64)
    high = np.floor(np.clip(corner.max(1), -1, [width + 1, height + 1]) - 0.5).astype(np.int64)
    low, high = np.maximum(low, 0), np.minimum(high, [width - 1, height - 1])
    size = np.maximum(high - low + 1, 0)
    area = _cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    drawn = np.flatnonzero((z > near).all(1) & (size > 0).all(1) & (np.abs(area) > 1e-12))
    count = size[drawn].prod(1)
    triangles = _Projected(corner, 1 / np.maximum(z, near), area, low, size)
    face = np.full(height * width, -1)
    closeness = np.zeros(height * width)  # 1 / depth
    # a new group wherever the running count of candidates passes another multiple
    group = np.cumsum(count) // CANDIDATES
    for chosen in np.split(drawn, np.flatnonzero(np.diff(group)) + 1):
        _draw(face, closeness, triangles, chosen, width)
    with np.errstate(divide="ignore"):
        return FaceBuffer(face.reshape(height, width), (1 / closeness).reshape(height, width))


def _draw(
    face: Int[Array, "pixels"], closeness: Float[Array, "pixels"], triangles: _Projected,
    chosen: Int[Array, "chosen"], width: int,
) -> None:  # fmt: skip
    """Draw the chosen faces over what is there, in place."""
    corner, inverse, area, low, size = triangles
    count = size[chosen].prod(1)
    of = np.repeat(chosen, count)
    place = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
    column, row = low[of, 0] + place % size[of, 0], low[of, 1] + place // size[of, 0]
    p = np.stack([column + 0.5, row + 0.5], 1)
    a, b, c = corner[of, 0], corner[of, 1], corner[of, 2]
    u, v = _cross(c - b, p - b) / area[of], _cross(a - c, p - c) / area[of]
    w = 1 - u - v
    inside = (u >= -1e-9) & (v >= -1e-9) & (w >= -1e-9)
    of, pixel = of[inside], row[inside] * width + column[inside]
    near = u[inside] * inverse[of, 0] + v[inside] * inverse[of, 1] + w[inside] * inverse[of, 2]
    # the nearest is written last
    order = np.argsort(near, kind="stable")
    of, pixel, near = of[order], pixel[order], near[order]
    first = np.full(len(face), -1)
    first[pixel] = np.arange(len(pixel))
    seen = np.flatnonzero(first >= 0)
    candidate = first[seen]
    nearer = near[candidate] > closeness[seen]
    face[seen[nearer]] = of[candidate[nearer]]
    closeness[seen[nearer]] = near[candidate[nearer]]


def _cross(a: Array, b: Array) -> Array:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
