"""The color of each vertex of the template, as the videos show it: what a person is painted in before any training.

    c_v = sum_i w_i c_i / sum_i w_i

over the pixels i that show a triangle of v, with w_i the squared cosine between normal and view. Each part's own video
decides where it shows a vertex, else the body's. Unseen vertices are filled from their neighbours.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.light import CaptureLight
from avatar.skeleton import PARTS
from capture.folder import Capture
from capture.light.frames import light_frame
from capture.light.pixels import video_pixels
from geometry.harmonic import anchored, fill_harmonic

# a video gives at most so many; twenty for each triangle that it may show
PIXELS = 300_000


def seen_colors(capture: Capture, lights: Mapping[str, CaptureLight], seed: int = 0) -> Float[Array, "vertices 3"]:
    """sRGB in [0, 1] of the template's vertices; albedo where `lights`, by the part of each video, are given."""
    subject, frame = capture.subject, light_frame(capture)
    colors = np.full((len(subject.vertices), 3), 0.5)
    known = np.zeros(len(colors), bool)
    rng = np.random.default_rng([seed, 37])
    for index, part in enumerate(PARTS):
        own = (subject.part[subject.faces] == index).any(1) | (part == "body")
        if part == "head" and capture.fitted_here and capture.chin is not None:
            # neck and collar stand elsewhere in its video than they are posed: they left a second collar under the chin
            own &= (subject.vertices[subject.faces, 1] > capture.chin).all(1)
        pixels = video_pixels(capture, part, own, frame, PIXELS, rng)
        color, light = pixels.color, lights.get(part)
        if light is not None:
            shading, highlight = light.shading(pixels.normal), light.highlight(pixels.normal, pixels.towards_eye)
            color = light.albedo(color, shading, highlight)
        corners = subject.faces[pixels.face].ravel()
        each = np.repeat((pixels.normal * pixels.towards_eye).sum(1) ** 2, 3)
        total = np.bincount(corners, each, len(colors))
        sums = np.stack([np.bincount(corners, each * np.repeat(color[:, c], 3), len(colors)) for c in range(3)], 1)
        shown = total > 0
        colors[shown], known = sums[shown] / total[shown, None], known | shown
    if not known.any():
        return colors
    reached = anchored(known, subject.faces)
    colors[~reached] = colors[known].mean(0)
    return np.clip(fill_harmonic(colors, known | ~reached, subject.faces), 0, 1)
