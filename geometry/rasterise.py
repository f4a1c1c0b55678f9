"""Which triangle each pixel sees: a z-buffer in NumPy, where no graphics context is wanted."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.camera import Camera, project

# pixels of bounding boxes tried at once; bounds the memory to some 100 MB
CANDIDATES = 1 << 20


class FaceBuffer(NamedTuple):
    # -1 where there is nothing
    face: Int[Array, "height width"]
    # along the optical axis, the unit of the vertices; inf where nothing
    depth: Float[Array, "height width"]


class _Projected(NamedTuple):
    corner: Float[Array, "faces 3 2"]  # pixels
    closeness: Float[Array, "faces 3"]  # 1 / depth
    area: Float[Array, "faces"]  # twice the signed one, square pixels
    low: Int[Array, "faces 2"]  # first column and row of the pixels tried
    size: Int[Array, "faces 2"]  # columns and rows


def rasterise(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], camera: Camera, *, near: float = 1e-3,
    asked: Bool[Array, "height width"] | None = None,
) -> FaceBuffer:  # fmt: skip
    """The nearest triangle through every pixel centre; both sides are drawn.

    `asked`: pixels whose answer is wanted, the others' may be wrong; None: all.

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
    if asked is not None:
        before = np.pad(asked.cumsum(0).cumsum(1), ((1, 0), (1, 0)))  # asked above and to the left
        (left, top), (right, bottom) = low[drawn].T, high[drawn].T + 1
        inside = before[bottom, right] - before[top, right] - before[bottom, left] + before[top, left]
        drawn = drawn[inside > 0]
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
    # barycentric coordinates at the box's first pixel centre, and their steps to the right and down
    first, (a, b, c) = low[chosen] + 0.5, corner[chosen].transpose(1, 0, 2)
    u = np.c_[_cross(c - b, first - b), (b - c)[:, 1], (c - b)[:, 0]] / area[chosen, None]
    v = np.c_[_cross(a - c, first - c), (c - a)[:, 1], (a - c)[:, 0]] / area[chosen, None]
    of = np.repeat(np.arange(len(chosen)), count)
    down, right = np.divmod(np.arange(len(of)) - (np.cumsum(count) - count)[of], size[chosen, 0][of])
    u, v = (at[:, 0][of] + at[:, 1][of] * right + at[:, 2][of] * down for at in (u, v))
    w = 1 - u - v
    inside = np.flatnonzero((u >= -1e-9) & (v >= -1e-9) & (w >= -1e-9))
    of, u, v, w = chosen[of[inside]], u[inside], v[inside], w[inside]
    pixel = (low[of, 1] + down[inside]) * width + low[of, 0] + right[inside]
    near = u * inverse[of, 0] + v * inverse[of, 1] + w * inverse[of, 2]
    before = closeness[pixel]
    np.maximum.at(closeness, pixel, near)
    nearest = (near == closeness[pixel]) & (near > before)
    face[pixel[nearest]] = of[nearest]


def _cross(a: Array, b: Array) -> Array:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
