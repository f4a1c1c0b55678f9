"""Which directions each surface point was seen from: the ray statistics behind Eq. 14.

    mean_v = 1/N sum_n d_n        covariance_v = 1/N sum_n t_n t_n^T,  t_n = d_n without its part along the mean

d is the unit direction from the camera to the point, in the canonical frame, through the orthonormal inverse of
the skin (the head: through its rigid motion). A vertex is seen in a frame when it is in the image, faces the
camera, and no other vertex of the posed surface hides it; each frame counts once, so N says how many frames
agree, whatever the pixel size.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage

from avatar.camera import Camera, project
from avatar.skeleton import skin_transforms
from avatar.skinning import SkinWeights, blended_rotations, blended_transforms
from capture.folder import CaptureSubject, PartVideo

# cosine between a vertex's normal and the way to the camera, and metres of a body of metres behind what hides it
FACING, TOLERANCE = 0.15, 0.015


class ViewStatistics(NamedTuple):
    """Per vertex; a vertex never seen has zeros everywhere."""

    count: Float[Array, "vertices"]
    # not normalised: its length says how far the directions agree
    mean: Float[Array, "vertices 3"]
    # xx xy xz yy yz zz
    covariance: Float[Array, "vertices 6"]


class ViewSums(NamedTuple):
    """Running sums in float64: a million unit vectors keep ten digits, where float32 loses all but three."""

    count: Float[Array, "vertices"]
    first: Float[Array, "vertices 3"]
    second: Float[Array, "vertices 6"]


def no_views(vertices: int) -> ViewSums:
    """The sums before the first observation."""
    return ViewSums(np.zeros(vertices), np.zeros((vertices, 3)), np.zeros((vertices, 6)))


def add_views(sums: ViewSums, vertex: Int[Array, "n"], directions: Float[Array, "n 3"]) -> None:
    """Add observations in place; a vertex may appear any number of times."""
    d = np.asarray(directions, np.float64)
    size = len(sums.count)
    sums.count[:] += np.bincount(vertex, minlength=size)
    for i in range(3):
        sums.first[:, i] += np.bincount(vertex, d[:, i], minlength=size)
    for k, (i, j) in enumerate(_PAIRS):
        sums.second[:, k] += np.bincount(vertex, d[:, i] * d[:, j], minlength=size)


_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def statistics(sums: ViewSums) -> ViewStatistics:
    """Mean and tangent covariance: P S P with S the second moment and P = I - m m^T, m the unit mean.

    Where the mean vanishes (seen from opposite sides, or never) no direction is special and P = I.
    """
    number = np.maximum(sums.count, 1)[:, None]
    mean = sums.first / number
    S = np.zeros((len(mean), 3, 3))
    for k, (i, j) in enumerate(_PAIRS):
        S[:, i, j] = S[:, j, i] = sums.second[:, k] / number[:, 0]
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    unit = np.where(length > 1e-9, mean / np.maximum(length, 1e-9), 0.0)
    P = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    across = P @ S @ P
    return ViewStatistics(sums.count, mean, np.stack([across[:, i, j] for i, j in _PAIRS], 1))


def part_views(
    video: PartVideo,
    subject: CaptureSubject,
    vertices: Float[Array, "vertices 3"],
    normals: Float[Array, "vertices 3"],
    skin: SkinWeights,
    inside: Bool[Array, "vertices"],
    canonical_from_head: Float[Array, "4 4"] | None,
) -> ViewSums:
    """Sums over the frames of one video, for the vertices `inside` its part; the others only hide."""
    # vertices of other parts only hide: a sixth of them is dense enough for that
    index = np.flatnonzero(inside | (np.arange(len(vertices)) % 6 == 0))
    points, n, own = vertices[index], normals[index], inside[index]
    local = skin.of(index)
    sums = no_views(len(vertices))
    for frame, camera in enumerate(video.cameras):
        if canonical_from_head is not None:
            scale = np.cbrt(np.linalg.det(canonical_from_head[:3, :3]))
            turn = canonical_from_head[:3, :3] / scale  # canonical from head, only the rotation
            posed = np.linalg.solve(canonical_from_head, np.c_[points, np.ones(len(points))].T).T[:, :3]
            turned = n @ turn
        else:
            assert video.axis_angle is not None and video.root is not None
            B = skin_transforms(video.axis_angle[frame], subject.joints, video.root[frame])
            M = blended_transforms(local, B)
            posed = np.einsum("vij,vj->vi", M[:, :3, :3], points) + M[:, :3, 3]
            # near enough to know front from back
            turned = np.einsum("vij,vj->vi", M[:, :3, :3], n)
        seen = np.flatnonzero(visible_vertices(posed, turned, camera, video.masks[frame]) & own)
        d = posed[seen] - camera.eye
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        if canonical_from_head is not None:
            d = d @ turn.T
        else:
            R = blended_rotations(local.of(seen), B)
            d = np.einsum("vij,vi->vj", R, d)
        add_views(sums, index[seen], d)
    return sums


def visible_vertices(
    points: Float[Array, "vertices 3"], normals: Float[Array, "vertices 3"], camera: Camera,
    mask: Bool[Array, "height width"],
) -> Bool[Array, "vertices"]:  # fmt: skip
    """Vertices seen by a camera: on the mask, facing it (cosine > FACING), and not behind nearer vertices.

    Vertices are splatted into a depth buffer whose cells hold several of them, 3x3 cells each, so that a sheet
    of vertices has no gaps.
    """
    pixels, depth = project(camera, points)
    # 1 for a person in metres; the head frame has its own unit
    size = np.linalg.norm(points.max(0) - points.min(0)) / 2.5
    d = points - camera.eye
    cosine = -(d * normals).sum(1) / np.maximum(np.linalg.norm(d, axis=1), 1e-12)
    width, height = camera.size
    column, row = np.floor(pixels[:, 0]), np.floor(pixels[:, 1])
    inside = (depth > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    on = np.flatnonzero(inside)
    column, row = column[on].astype(int), row[on].astype(int)

    # a cell is as large as 1 cm at the nearest vertex, at least one pixel
    cell = max(1.0, 0.01 * size * camera.K[0, 0] / max(float(depth[on].min(initial=np.inf)), 1e-9))
    shape = (int(height / cell) + 3, int(width / cell) + 3)
    front = on[cosine[on] > 0]
    r, c = (pixels[front, 1] / cell).astype(int) + 1, (pixels[front, 0] / cell).astype(int) + 1
    nearest = np.full(shape, np.inf)
    np.minimum.at(nearest, (r, c), depth[front])
    # the middle of a cell's 3x3 neighbourhood decides, filled where the cell itself is empty
    around = ndimage.minimum_filter(nearest, 3, mode="constant", cval=np.inf)
    nearest = np.where(np.isfinite(nearest), nearest, around)
    r, c = (pixels[on, 1] / cell).astype(int) + 1, (pixels[on, 0] / cell).astype(int) + 1
    seen = np.zeros(len(points), bool)
    # a cell of a slanted sheet is deep
    slope = np.minimum(2 / np.maximum(cosine[on], FACING), 8.0) * 0.003 * size
    open_ = depth[on] <= nearest[r, c] + TOLERANCE * size + slope
    seen[on] = open_ & (cosine[on] > FACING) & mask[row, column]
    return seen


def fused_statistics(each: Sequence[ViewStatistics], shares: Float[Array, "vertices 4"]) -> ViewStatistics:
    """Each vertex uses the part that colors it; in overlaps the parts' numbers are blended with Eq. 9's weights.

    A part that never saw the vertex has no say; if none did, all is zero.
    """
    weights = np.stack([shares[:, i] * (s.count > 0) for i, s in enumerate(each)], 1)
    weights = weights / np.maximum(weights.sum(1, keepdims=True), 1e-12)
    return ViewStatistics(
        np.sum([weights[:, i] * s.count for i, s in enumerate(each)], axis=0),
        np.sum([weights[:, i, None] * s.mean for i, s in enumerate(each)], axis=0),
        np.sum([weights[:, i, None] * s.covariance for i, s in enumerate(each)], axis=0),
    )
