"""The head's place by its own video before anything is learned: where the template's skin looks alike in all frames.

A dozen landmarks leave the head's scale 1 to 2 % and its turn a degree or two off (Eq. 6). The registered template is
the head's shape; where it lies on the pictured head, a vertex has one color in every frame that sees it. With S a
similarity of the template, c_v a vertex's mean color and I_f(u) frame f at pixel u,

    min over S of  sum over frames and vertices seen  rho(I_f(project_f(S v)) - c_v)  +  sum |S b_i - a_i|^2 / spread^2

(rho: Geman and McClure 1985; b_i the landmarks' places on the template, a_i where Eq. 6 put them) is solved by
Gauss-Newton, the colors c_v eliminated, first on blurred frames.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage

from avatar.camera import Camera, project
from avatar.kinematics import pixel_rows
from avatar.skeleton import PARTS
from capture.fit.pixels import bilinear
from capture.folder import CaptureSubject, PartVideo
from capture.register.placement import PlaceEquations, refine
from capture.template.hull import head_cameras
from capture.template.surface import neck_height, visible_faces
from capture.videos import even
from geometry.icp import Anchors
from geometry.least_squares import robust_cost, robust_weight
from geometry.mesh import vertex_normals
from geometry.rasterise import rasterise

FRAMES = 20  # at most, spread over the video
# pixels, standard deviation; a blur lets the slope of the picture reach as far as the template may be off
BLURS = (2.5, 1.2)
ROUNDS = 6  # with each
# standard deviation of a pixel's residual: neighbours err together, so more than the noise
PIXEL = 0.1
OUTLIER = 0.05  # hair before the cheek, a shadow
FACING = 0.35  # cosine
# metres that the outline of hair, unknown yet, may hide beside the skin
DEEP = 0.012
# metres: farther than this the template is not what was filmed
MOST = 0.03


class ConsistentPlace(NamedTuple):
    """Where the head's own video has it."""

    canonical_from_head: Float[Array, "4 4"]
    # root of the mean rho, before and after
    before: float
    after: float
    moved: float  # metres, mean over the head's skin


def place_by_consistency(
    subject: CaptureSubject, video: PartVideo, canonical_from_head: Float[Array, "4 4"], anchors: Anchors
) -> ConsistentPlace:
    """Eq. 6's place refined until the template's skin looks alike in all frames of the head's video.

    Raises:
        ValueError: hardly any skin is seen twice, or the answer is no better, or lies farther than MOST away.
    """
    skin = (subject.part == PARTS.index("head")) & ~subject.hair
    if not skin.any():
        raise ValueError("the template has no bare skin on its head")
    chosen = np.zeros(len(subject.vertices), bool)
    chosen[np.unique(subject.faces[visible_faces(subject)])] = True
    chosen &= skin & (subject.vertices[:, 1] > neck_height(subject))
    vertex = np.flatnonzero(chosen)
    normals = vertex_normals(subject.vertices, subject.faces)[vertex]
    # the template moves under cameras that stay: S
    used = even(len(video.images), FRAMES)
    cameras = [head_cameras(video, canonical_from_head)[i] for i in used]
    images, masks = [video.images[i] for i in used], [video.masks[i] for i in used]
    centre = subject.vertices[vertex].mean(0)
    back = Anchors(anchors.target, anchors.source, anchors.spread)
    S, tried = np.eye(4), []
    for blur in BLURS:
        frames = [_blurred(image, mask, blur) for image, mask in zip(images, masks)]

        def equations_at(S: Float[Array, "4 4"], frames=frames) -> PlaceEquations:
            """What all frames and the landmarks say at a place."""
            placed = subject.vertices @ S[:3, :3].T + S[:3, 3]
            turned = normals @ (S[:3, :3] / np.cbrt(np.linalg.det(S[:3, :3]))).T
            rows = [
                _rows(placed, subject.faces, vertex, turned, camera, frame, mask)
                for camera, frame, mask in zip(cameras, frames, masks)
            ]
            equations = PlaceEquations(S, centre)
            equations.add_landmarks(back)
            _add_consistency(equations, rows, placed[vertex])
            if equations.count < 1000:
                raise ValueError("the head's video sees hardly any of the template's skin twice")
            return equations

        tried, S = refine(S, equations_at, ROUNDS)
    before, after, S = tried[0].residual, tried[-1].residual, tried[-1].transform
    moved = np.linalg.norm(subject.vertices[vertex] @ (S - np.eye(4))[:3, :3].T + S[:3, 3], axis=1)
    if not after <= 1.02 * before:
        raise ValueError(f"the frames agree less than before ({before:.4f} -> {after:.4f})")
    if moved.max() > MOST:
        raise ValueError(f"the frames would move the head by {moved.max():.3f} m, more than {MOST}")
    return ConsistentPlace(np.linalg.inv(S) @ canonical_from_head, before, after, float(moved.mean()))


class _Seen(NamedTuple):
    """The vertices that one frame sees, what it shows there, and how that changes per increment of S."""

    vertex: Int[Array, "k"]  # into the chosen ones
    color: Float[Array, "k 3"]
    slope: Float[Array, "k 3 2"]  # per pixel, x and y
    derivative: Float[Array, "k 2 3"]  # pixels per metre


def _blurred(image: Array, mask: Bool[Array, "h w"], blur: float) -> Float[Array, "h w 3"]:
    """A frame in [0, 1], blurred inside the mask: the black round it is no color of anything."""
    blurred = np.zeros(image.shape)
    if mask.any():
        # as far as the filter reaches, there is nothing beyond
        margin = int(4 * blur) + 1
        ends = [np.flatnonzero(mask.any(axis))[[0, -1]] for axis in (1, 0)]
        box = tuple(slice(max(int(a) - margin, 0), int(b) + margin + 1) for a, b in ends)
        inside = ndimage.gaussian_filter(mask[box].astype(np.float64), blur)
        lit = image[box].astype(np.float64) / 255 * mask[box][..., None]
        blurred[box] = ndimage.gaussian_filter(lit, (blur, blur, 0)) / np.maximum(inside, 1e-3)[..., None]
    return blurred


def _rows(
    placed: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], vertex: Int[Array, "n"],
    normals: Float[Array, "n 3"], camera: Camera, frame: Float[Array, "h w 3"], mask: Bool[Array, "h w"],
) -> _Seen:  # fmt: skip
    points = placed[vertex]
    pixels, depth = project(camera, points)
    away = points - camera.eye
    facing = -(away * normals).sum(1) / np.linalg.norm(away, axis=1) > FACING
    width, height = camera.size
    K = camera.K.copy()
    K[:2] *= 0.5
    drawn = rasterise(placed, faces, replace(camera, K=K, size=(width // 2, height // 2)))
    row, column = (np.clip(np.floor(pixels[:, i]), 0, s - 1).astype(int) for i, s in ((1, height), (0, width)))
    inside = (depth > 0) & ((pixels >= 1) & (pixels < np.array([width - 1, height - 1]))).all(1) & mask[row, column]
    nearest = drawn.depth[np.minimum(row // 2, height // 2 - 1), np.minimum(column // 2, width // 2 - 1)]
    seen = np.flatnonzero(facing & inside & (depth < nearest + DEEP))
    down, across = np.gradient(frame, axis=(0, 1))
    color, *slope = (bilinear(values, pixels[seen]) for values in (frame, across, down))
    return _Seen(seen, color, np.stack(slope, -1), pixel_rows(camera, points[seen])[1])


def _add_consistency(equations: PlaceEquations, rows: list[_Seen], points: Float[Array, "n 3"]) -> None:
    """Add all frames, the colors of vertices eliminated."""
    count = len(points)
    vertex = np.concatenate([seen.vertex for seen in rows])
    if len(vertex) == 0:
        return
    color = np.concatenate([seen.color for seen in rows])
    motion = np.concatenate([seen.derivative @ equations.rows(points[seen.vertex]) for seen in rows])
    slope = np.concatenate([seen.slope for seen in rows])
    J = np.einsum("kcp,kpi->kci", slope, motion)
    times = np.bincount(vertex, minlength=count)
    total = lambda values, weight: np.stack(
        [np.bincount(vertex, weight * column, count) for column in values.reshape(len(values), -1).T], 1
    )
    weight = np.ones(len(vertex))
    for _ in range(3):
        share = weight / np.maximum(np.bincount(vertex, weight, count), 1e-9)[vertex]
        residual = color - total(color, share)[vertex]
        weight = robust_weight((residual**2).sum(1), OUTLIER)
    J = J - total(J, share)[vertex].reshape(J.shape)
    twice = times[vertex] >= 3
    J, r, w = J[twice].reshape(-1, 7), residual[twice].ravel(), np.repeat(weight[twice], 3) / PIXEL**2
    equations.add(J, -r, w)
    equations.cost += float(robust_cost((residual[twice] ** 2).sum(1), OUTLIER).sum())
    equations.count += int(twice.sum())
