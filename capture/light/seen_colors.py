"""The color of each vertex of the template, as the videos show it: what a person is painted in before any training.

    c_v = sum_i w_i c_i / sum_i w_i

over the pixels i that show a triangle of v, with w_i the squared cosine between normal and view. Each part's own video
decides where it shows a vertex, else the body's. Unseen vertices are filled from their neighbours.
"""

from collections.abc import Collection, Mapping

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.light import CaptureLight
from avatar.skeleton import PARTS
from capture.folder import Capture
from capture.light.frames import light_frame
from capture.light.pixels import LitPixels, video_pixels
from geometry.harmonic import anchored, fill_harmonic

# a video gives at most so many; twenty for each triangle that it may show
PIXELS = 300_000


def seen_colors(
    capture: Capture, lights: Mapping[str, CaptureLight], seed: int = 0, parts: Collection[str] = PARTS
) -> Float[Array, "vertices 3"]:
    """sRGB in [0, 1] of the template's vertices, by the videos of `parts`; albedo where `lights`, by the part of each
    video, are given."""
    subject, frame = capture.subject, light_frame(capture)
    colors = np.full((len(subject.vertices), 3), 0.5)
    known = np.zeros(len(colors), bool)
    rng = np.random.default_rng([seed, 37])
    for index, part in enumerate(PARTS):
        if part not in parts:
            continue
        own = (subject.part[subject.faces] == index).any(1) | (part == "body")
        pixels = video_pixels(capture, part, own, frame, PIXELS, rng)
        found, shown = _of_vertices(pixels, _albedo(pixels, lights.get(part)), subject.faces, len(colors))
        colors[shown], known = found[shown], known | shown
    if not known.any():
        return colors
    reached = anchored(known, subject.faces)
    colors[~reached] = colors[known].mean(0)
    return np.clip(fill_harmonic(colors, known | ~reached, subject.faces), 0, 1)


def _albedo(pixels: LitPixels, light: CaptureLight | None) -> Float[Array, "n 3"]:
    if light is None:
        return pixels.color
    shading, highlight = light.shading(pixels.normal), light.highlight(pixels.normal, pixels.towards_eye)
    return light.albedo(pixels.color, shading, highlight)


def _of_vertices(
    pixels: LitPixels, color: Float[Array, "n 3"], faces: Array, count: int
) -> tuple[Float[Array, "vertices 3"], Bool[Array, "vertices"]]:
    """Mean color of the pixels on the triangles round each vertex, and which vertices have any."""
    weight = (pixels.normal * pixels.towards_eye).sum(1) ** 2
    corners, each = faces[pixels.face].ravel(), np.repeat(weight, 3)
    total = np.bincount(corners, each, count)
    sums = np.stack([np.bincount(corners, each * np.repeat(color[:, c], 3), count) for c in range(3)], 1)
    return sums / np.maximum(total, 1e-9)[:, None], total > 0
