"""Outlines: of masks to a fraction of a pixel, and of the posed template as vertices on its silhouette."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array
from scipy import ndimage
from scipy.spatial import KDTree

from avatar.camera import Camera, project
from geometry.cells import rim_of
from geometry.mesh import vertex_normals
from geometry.rasterise import rasterise

# the drawn template is this many pixels high; its own outline is exact, only what hides what is read from it
DRAWN = 360
# samples of one frame
SAMPLES = 300


# a k-d tree moves a split beside equal points to the next float; next to 0 that is a denormal, and where those are
# flushed (train.trainer.flushed_denormals) the tree would grow for ever: keep away from 0
OFF_ZERO = 1e3


class Contour(NamedTuple):
    """Places on the edge of an area, with outward normals."""

    at: Float[Array, "n 2"]  # pixels
    normals: Float[Array, "n 2"]  # unit

    def nearest(
        self, at: Float[Array, "k 2"], normals: Float[Array, "k 2"], bend: float
    ) -> tuple[Int[Array, "k"], Float[Array, "k"]]:
        """For each place the nearest of the contour that faces the same way, and how far it is, pixels.

        A normal turned by one radian counts as `bend` pixels.
        """
        tree = KDTree(np.c_[self.at / bend, self.normals] + OFF_ZERO)
        index = np.asarray(tree.query(np.c_[at / bend, normals] + OFF_ZERO)[1])
        return index, np.linalg.norm(self.at[index] - at, axis=1)


def pixel_contour(area: Bool[Array, "height width"]) -> Contour:
    """The outermost pixels of an area, those at the border of the picture left out."""
    row, column = np.nonzero(rim_of(area))
    smooth = np.asarray(ndimage.gaussian_filter(area.astype(np.float32), 1.5, mode="nearest"))
    down, right = np.gradient(smooth, axis=0), np.gradient(smooth, axis=1)
    normals = -np.stack([right[row, column], down[row, column]], 1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-6)
    return Contour(np.stack([column, row], 1) + 0.5, normals)


def mask_contour(mask: UInt8[Array, "height width"] | Float[Array, "height width"]) -> Contour:
    """Where the smoothed mask crosses one half between neighbouring pixels (the corners of marching squares).

    Pixels at the border of the picture are no outline: the person goes on beyond it. Large masks are halved until their
    shorter side is below 960 pixels.
    """
    height, width = mask.shape
    half = 1
    while min(mask.shape) >= 960:
        even = mask[: mask.shape[0] // 2 * 2, : mask.shape[1] // 2 * 2].astype(np.float32)
        mask, half = 0.25 * (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]), 2 * half
    soft = ndimage.gaussian_filter(mask.astype(np.float32) / 255, 0.8, mode="nearest")
    down, right = np.gradient(ndimage.gaussian_filter(soft, 1.0, mode="nearest"))
    at, normals = [], []
    for axis in (0, 1):
        one = soft[:-1] if axis == 0 else soft[:, :-1]
        two = soft[1:] if axis == 0 else soft[:, 1:]
        row, column = np.nonzero((one > 0.5) != (two > 0.5))
        a, b = one[row, column], two[row, column]
        t = (0.5 - a) / (b - a)
        place = np.stack([column + 0.5 + t * (axis == 1), row + 0.5 + t * (axis == 0)], 1)
        at.append(place)
        where = (place[:, ::-1] - 0.5).T
        normals.append(-np.stack([ndimage.map_coordinates(slope, where, order=1) for slope in (right, down)], 1))
    place, normal = half * np.concatenate(at), np.concatenate(normals)
    inside = ((place > 2) & (place < [width - 2, height - 2])).all(1)
    place, normal = place[inside], normal[inside]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    if len(place) == 0:
        # far away from everything: matches nothing
        place, normal = np.full((1, 2), -1e6), np.array([[1.0, 0.0]])
    return Contour(place, normal)


class Silhouette(NamedTuple):
    """Vertices of the posed template on its outline, where each is or should be, and which way is out."""

    vertices: Int[Array, "n"]
    at: Float[Array, "n 2"]
    normals: Float[Array, "n 2"]  # outward, unit


def silhouette(
    x: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], camera: Camera, chosen: Bool[Array, "vertices"]
) -> Silhouette:
    """Some of the `chosen` vertices on the outline, spread evenly.

    They lie between a face that is seen and one that is not, with nothing drawn just outside them.
    """
    a, b, c = (x[faces[:, k]] for k in range(3))
    front = ((a * np.cross(b - a, c - a)).sum(1)) < 0
    seen, hidden = np.zeros((2, len(x)), bool)
    seen[faces[front]] = True
    hidden[faces[~front]] = True
    rim = np.flatnonzero(seen & hidden & chosen & (x[:, 2] < -0.05))
    at, size = project(camera, x)[0], camera.size
    # perspective hardly matters for which way is out
    normals = vertex_normals(x, faces)[rim]
    flat = np.stack([normals[:, 0], -normals[:, 1]], 1)
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    scale = min(1.0, DRAWN / max(float(np.ptp(at[:, 1].clip(0, size[1]))), 1.0))
    small = (max(int(scale * size[0]), 1), max(int(scale * size[1]), 1))
    smaller = replace(camera, K=np.diag([scale, scale, 1]) @ camera.K, size=small)
    inside = ((at[rim] > 1) & (at[rim] < np.array(size) - 1)).all(1)
    column, row = np.clip((scale * at[rim] + 2.0 * flat).astype(int), 0, np.array(small) - 1).T
    asked = np.zeros(small[::-1], bool)
    asked[row, column] = True
    free = inside & (rasterise(x, faces[front], smaller, asked=asked).face[row, column] < 0)
    rim, flat = rim[free], flat[free]
    if len(rim) > SAMPLES:
        # neighbours on the outline have neighbouring angles round its middle
        middle = at[rim].mean(0)
        order = np.argsort(np.arctan2(*(at[rim] - middle).T), kind="stable")
        keep = order[np.linspace(0, len(rim) - 1, SAMPLES).astype(int)]
        rim, flat = rim[keep], flat[keep]
    return Silhouette(rim, at[rim], flat)
