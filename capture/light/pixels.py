"""What the videos show of the template: color, triangle, normal and direction of pixels well inside the person."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage

from avatar.camera import Camera, pixel_rays
from avatar.light import Frame
from avatar.skeleton import PARTS
from capture.check.silhouette import canonical_from_head, posed_template
from capture.folder import Capture
from capture.light.frames import light_from_video
from capture.videos import even
from command.workers import on_all_cores
from geometry.mesh import vertex_normals
from geometry.rasterise import rasterise

# out of 255: brighter ones may have been clipped, which looks like a darker skin
CLIPPED = 249
# as dark as this is noise and the dirt between two pixels
DARK = 3
# cosine between normal and eye: flatter ones show neither place nor normal well
GRAZING = 0.25
# metres of depth between neighbours: an outline in the middle of the person
JUMP = 0.02
# frames of a video: half a turn apart twice over is enough
MOST_FRAMES = 16
MOST = 40_000  # pixels of a video


class LitPixels(NamedTuple):
    """Pixels of all videos that show the template; n of them."""

    video: Int[Array, "n"]  # index into PARTS
    face: Int[Array, "n"]  # the template's
    color: Float[Array, "n 3"]  # sRGB in [0, 1]
    normal: Float[Array, "n 3"]  # unit, where the light stands still
    towards_eye: Float[Array, "n 3"]  # the same

    def chosen(self, rows: Array) -> "LitPixels":
        return LitPixels(*(values[rows] for values in self))


def lit_pixels(capture: Capture, frame: Frame, seed: int) -> LitPixels:
    """Pixels in which the light can be read; at most MOST of each video, evenly chosen.

    Left out are pixels at an outline, clipped or black ones, flat views, hair (which no template has), and, in the
    head's and hands' videos, everything else of the person: it is out of focus there, or stands in another pose.
    """
    rng = np.random.default_rng([seed, 31])
    hair = np.asarray(capture.subject.hair[capture.subject.faces].any(1))
    found = []
    for index, part in enumerate(PARTS):
        own = ((capture.subject.part[capture.subject.faces] == index).any(1) | (part == "body")) & ~hair
        found.append(video_pixels(capture, part, own, frame, MOST, rng))
    return LitPixels(*(np.concatenate(values) for values in zip(*found, strict=True)))


def video_pixels(
    capture: Capture, part: str, own: Bool[Array, "faces"], frame: Frame, most: int, rng: np.random.Generator
) -> LitPixels:
    """At most `most` pixels of one video that show the template's faces `own`; left out is what `lit_pixels` names."""
    video, faces = capture.videos[part], capture.subject.faces
    turns = light_from_video(capture, part, frame)
    frames = even(len(video.cameras), MOST_FRAMES)
    each = -(-most // len(frames))
    # the head's frame has its own unit
    metres = float(np.cbrt(np.linalg.det(canonical_from_head(capture)[:3, :3]))) if part == "head" else 1.0
    jump = JUMP / metres

    def shown(number: int, rng: np.random.Generator) -> LitPixels:
        """Those of one frame."""
        camera = video.cameras[number]
        vertices = posed_template(capture, part, number)
        drawn = rasterise(vertices, faces, camera)
        image = video.images[number]
        usable = (drawn.face >= 0) & (image.max(-1) < CLIPPED) & (image.max(-1) > DARK)
        # neighbours show the person too, at nearly the same depth; the farthest finite one stands for what is behind
        inside = ndimage.binary_erosion(video.masks[number], np.ones((3, 3)), border_value=1)
        seen = np.isfinite(drawn.depth)
        depth = np.where(seen, drawn.depth, np.max(drawn.depth, initial=0, where=seen) + 10 * jump)
        even_depth = ndimage.maximum_filter(depth, 3) - ndimage.minimum_filter(depth, 3) < jump
        usable &= own[np.maximum(drawn.face, 0)] & np.asarray(inside, bool) & even_depth
        if video.unsure is not None:
            usable &= ~video.unsure[number]
        pixels = np.argwhere(usable)
        pixels = rng.permutation(pixels)[: 3 * each]
        face = drawn.face[tuple(pixels.T)]
        normal, towards_eye = _seen(vertices, faces, face, camera, pixels, drawn.depth[tuple(pixels.T)])
        facing = np.flatnonzero((normal * towards_eye).sum(1) > GRAZING)[:each]
        R = turns[number].T
        color = image[tuple(pixels[facing].T)] / 255
        video_index = np.full(len(facing), PARTS.index(part))
        return LitPixels(video_index, face[facing], color, normal[facing] @ R, towards_eye[facing] @ R)

    pieces = on_all_cores(lambda one: shown(*one), zip(frames, rng.spawn(len(frames))))
    return LitPixels(*(np.concatenate(values) for values in zip(*pieces, strict=True)))


def _seen(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], face: Int[Array, "n"], camera: Camera,
    pixels: Int[Array, "n 2"], depth: Float[Array, "n"],
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:  # fmt: skip
    """Interpolated unit normals of pixels (row, column) on faces, and unit directions to the eye."""
    origins, directions = pixel_rays(camera, pixels[:, ::-1] + 0.5)
    along = directions @ camera.camera_from_world[2, :3]
    points = origins + directions * (depth / along)[:, None]
    a, b, c = (vertices[faces[face, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.maximum((normal**2).sum(1), 1e-30)
    u = (np.cross(c - b, points - b) * normal).sum(1) / area
    v = (np.cross(a - c, points - c) * normal).sum(1) / area
    weight = np.clip(np.stack([u, v, 1 - u - v], 1), 0, 1)
    n = (weight[:, :, None] * vertex_normals(vertices, faces)[faces[face]]).sum(1)
    return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9), -directions
