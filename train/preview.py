"""A picture of a part while it learns: observed | rendered | normals, for one fixed frame of its video."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from avatar.camera import Camera, project
from avatar.skeleton import PARTS, skin_transforms
from avatar.skinning import SkinWeights, skin_points
from capture.folder import PartVideo
from files.picture import encode_png
from files.whole import whole_file
from train.field import PartField, unit_normals
from train.objective import Batch, RayTensors, functions_of, ray_tensors, render_rays
from train.preset import Preset
from train.rays import FilmedPart, RaySettings, part_rays

SIDE = 112  # pixels at most
BATCH = 4096  # rays drawn at once


class Preview:
    """Draws a part by volume rendering of cached rays, as it learns.

    Rays of pixels that do not supervise the part (the body's, in a picture of a hand) are not cast; they are
    black, and so is the background. Normals are canonical, n / 2 + 1 / 2 as a color.
    """

    def __init__(
        self, path: Path, rays: RayTensors, pixels: Int[Array, "rays 2"], observed: UInt8[Array, "height width 3"],
        every: int,
    ):  # fmt: skip
        # a PNG file; steps between two pictures
        self.path, self.every = path, every
        self.rays, self.pixels, self.observed = rays, pixels, observed

    def draw(self, field: PartField, beta: float, preset: Preset) -> UInt8[Array, "height wide 3"]:
        """The picture, also written to `path`, whole or not at all. Field and random state stay as they are."""
        rendered, normals = np.zeros_like(self.observed), np.zeros_like(self.observed)
        device, functions = self.rays.ends.device, functions_of(field)
        for chosen in torch.arange(len(self.pixels), device=device).split(BATCH):
            u = torch.full((len(chosen),), 0.5, device=device)
            with torch.no_grad():
                drawn = render_rays(functions, self.rays, Batch(chosen, u, beta), preset, create_graph=False)
                opacity = -torch.expm1(drawn.log_transmittance)[:, None]
                n = unit_normals(drawn.gradient).view(len(chosen), -1, 3)
                n = unit_normals((drawn.share[..., None] * n).sum(1))
            row, column = self.pixels[chosen.cpu().numpy()].T
            rendered[row, column] = _bytes(drawn.color)
            normals[row, column] = _bytes(opacity * (0.5 + 0.5 * n))
        image = np.concatenate([self.observed, rendered, normals], 1)
        self.path.parent.mkdir(exist_ok=True)
        with whole_file(self.path) as file:
            file.write(encode_png(image))
        return image


def part_preview(path: Path, filmed: FilmedPart, settings: RaySettings, device: torch.device, every: int) -> Preview:
    """The rays of a pixel grid over the part, in the first frame that shows it about as large as any.

    Raises:
        ValueError: no pixel of that frame supervises the part.
    """
    frame, box = _view(filmed)
    small = _thinned(filmed.video, frame, box)
    camera, canonical_from_head = small.cameras[0], filmed.canonical_from_head
    everything = replace(settings, per_frame=2 * small.masks[0].size, background=1.0)
    rays = part_rays(replace(filmed, video=small), everything, np.random.default_rng(0))
    # a ray does not hold its pixel; its direction leads back to it
    directions = rays.direction.astype(np.float64)
    if canonical_from_head is not None:
        directions = directions @ (canonical_from_head[:3, :3] / filmed.scale)
    at, _ = project(camera, camera.eye + directions)
    pixels = np.floor(at).astype(np.int64)[:, ::-1]
    tensors = ray_tensors(rays, filmed.cloud, device)
    bones = tensors.bones
    # the codes of T_nr and F_c are the video's: so are the frame numbers
    if bones is not None:
        bones = bones.expand(frame + 1, *bones.shape[1:])
    tensors = replace(tensors, frame=torch.full_like(tensors.frame, frame), bones=bones)
    observed = small.images[0] * small.masks[0][..., None]
    return Preview(path, tensors, pixels, observed, every)


def _view(filmed: FilmedPart) -> tuple[int, tuple[int, int, int, int]]:
    """A frame, and the rows and columns (first, past the last) of its image that show the part."""
    video, cloud, index = filmed.video, filmed.cloud, PARTS.index(filmed.part.name)
    own = np.flatnonzero(cloud.part == index if index else np.ones(len(cloud.points), bool))
    own = own[:: max(len(own) // 500, 1)]
    skin = SkinWeights(cloud.skin.joints[own], cloud.skin.weights[own])
    counts, boxes = [], []
    for i, camera in enumerate(video.cameras):
        if filmed.canonical_from_head is not None:
            points = np.c_[cloud.points[own], np.ones(len(own))] @ np.linalg.inv(filmed.canonical_from_head)[:3].T
        else:
            assert video.axis_angle is not None and video.root is not None
            B = skin_transforms(video.axis_angle[i], filmed.subject.joints, video.root[i])
            points = skin_points(cloud.points[own], skin, B)
        pixels, depth = project(camera, points)
        height, width = video.masks[i].shape
        column, row = np.floor(pixels.clip(-1, max(width, height))).astype(int).T
        seen = (depth > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        seen[seen] = video.masks[i][row[seen], column[seen]]
        counts.append(int(seen.sum()))
        if not seen.any():
            boxes.append((0, height, 0, width))
            continue
        low, high = pixels[seen].min(0), pixels[seen].max(0)
        pad = 0.08 * (high - low).max() + 2
        left, top = (int(value) for value in np.maximum(low - pad, 0))
        right, bottom = (int(value) for value in np.minimum(high + pad, [width, height]))
        boxes.append((top, max(bottom, top + 1), left, max(right, left + 1)))
    frame = int(np.argmax(np.array(counts) >= 0.95 * max(counts)))
    return frame, boxes[frame]


def _thinned(video: PartVideo, frame: int, box: tuple[int, int, int, int]) -> PartVideo:
    """One frame, cropped, of every n-th pixel; its camera sees the same rays."""
    top, bottom, left, right = box
    step = -(-max(bottom - top, right - left) // SIDE)
    top, left = min(top + step // 2, bottom - 1), min(left + step // 2, right - 1)
    image = video.images[frame][top:bottom:step, left:right:step]
    mask = video.masks[frame][top:bottom:step, left:right:step]
    camera = video.cameras[frame]
    small_from_pixel = np.diag([1 / step, 1 / step, 1.0])
    # centres lie at .5 in both
    small_from_pixel[:2, 2] = 0.5 - (np.array([left, top]) + 0.5) / step
    size = (mask.shape[1], mask.shape[0])
    camera = Camera(small_from_pixel @ camera.K, camera.camera_from_world, size, camera.distortion)
    one = slice(frame, frame + 1)
    return replace(
        video, images=image[None], masks=mask[None], cameras=(camera,),
        axis_angle=None if video.axis_angle is None else video.axis_angle[one],
        root=None if video.root is None else video.root[one],
        # the picture has no holes
        unsure=None,
    )  # fmt: skip


def _bytes(color: Float[torch.Tensor, "n 3"]) -> UInt8[Array, "n 3"]:
    return (color.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()
