"""Masks that are all too large or too small: by how much, and where the person really ends.

By how much is read off the template's outline, which is the registered person. Where the edge runs is then read off
the picture: between pixels that are surely the person and pixels that surely are not, a random walk that does not
like to cross edges of color (Grady, Random Walks for Image Segmentation, 2006) decides. Where colors say nothing
it ends half-way, near where only the offset would put the edge, and those pixels count as unsure.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from capture.fit.align import outline_offset
from capture.folder import CaptureSubject, PartVideo
from capture.raw.masks import CONTRAST, walk
from geometry.cells import distance_to
from geometry.rasterise import rasterise

# pixels of an image 256 high: masks that are off by less are believed (clean ones: .1 to .5)
BELIEVED = 0.9
MEASURED_AGAIN = 2
# pixels beyond the expected edge from where a pixel is surely on its side
MARGIN = 1.0
# probabilities of being the person within this of a half supervise nothing
UNSURE = 0.25


class Redrawn(NamedTuple):
    """The masks of a video with their edges read off the pictures."""

    masks: Bool[Array, "frames height width"]
    # may show the person or not
    unsure: Bool[Array, "frames height width"]


def mask_offsets(videos: Mapping[str, PartVideo], subject: CaptureSubject) -> dict[str, float]:
    """How far each posed video's masks are outside of the template, pixels of an image 256 high.

    The nearest pixel of an outline is nearer than the one across (four fifths, of 2 pixels): masks that are off are
    corrected by what was found and measured again.
    """
    # no name for a video, or it would be in memory beside the next one
    offsets = {part: outline_offset(videos[part], subject) for part in videos}
    for _ in range(MEASURED_AGAIN if believed_offset(offsets) else 0):
        middle = believed_offset(offsets)
        for part in videos:
            masks = regrown(videos[part].masks, -pixels_off(videos[part], middle))
            offsets[part] = middle + outline_offset(replace(videos[part], masks=masks), subject)
    return offsets


def believed_offset(offsets: Mapping[str, float]) -> float:
    """How far all masks are off, pixels of an image 256 high: the median over the posed videos, or 0 if small.

    Loose clothes are outside of the template too, but not on hands: two of three videos do not see them.
    """
    middle = float(np.median(list(offsets.values())))
    return middle if abs(middle) > BELIEVED else 0.0


def pixels_off(video: PartVideo, masks_off: float) -> float:
    """Pixels of an image 256 high as pixels of the video."""
    return masks_off * video.masks.shape[1] / 256


def redrawn(video: PartVideo, subject: CaptureSubject, pixels: float) -> Redrawn:
    """Masks whose outline lies `pixels` outside of the person's (negative: inside), with the edge the picture shows.

    An eroded mask has lost what is thinner than it was eroded by; where the template says that a limb is there the
    picture may give it back, and where it does not the pixel is unsure.
    """
    masks, unsure = np.empty_like(video.masks), np.empty_like(video.masks)
    for f, mask in enumerate(video.masks):
        limb = np.zeros_like(mask)
        if pixels < 0 and video.axis_angle is not None and video.root is not None:
            B = skin_transforms(video.axis_angle[f], subject.joints, video.root[f])
            posed = skin_points(subject.vertices, subject.skin, B)
            limb = rasterise(posed, subject.faces, video.cameras[f]).face >= 0
        masks[f], unsure[f] = edge_by_colors(video.images[f], mask, pixels, limb)
    return Redrawn(masks, unsure)


def edge_by_colors(
    image: UInt8[Array, "height width 3"],
    mask: Bool[Array, "height width"],
    pixels: float,
    limb: Bool[Array, "height width"],
) -> tuple[Bool[Array, "height width"], Bool[Array, "height width"]]:
    """One mask redrawn, and what stays unsure; `limb` is where the person may be whatever the mask says."""
    away = signed_pixels(mask[None])[0]
    if pixels < 0:
        person, beside = away < -0.4, (away > MARGIN - pixels) & ~limb
    else:
        person, beside = away < -MARGIN - pixels, away > 0.4
    if not (person.any() and beside.any()):
        grown = away < -pixels
        return grown, np.abs(away + pixels) < MARGIN
    labels = np.where(person, 1, np.where(beside, 2, 0))
    # a pixel that no seed reaches keeps probability 0 of either: unsure
    probability = walk(image / 255.0, labels, CONTRAST)
    share = probability[0] / np.maximum(probability.sum(0), 1e-9)
    share = np.where(probability.sum(0) > 1e-6, share, 0.5)
    found = share > 0.5
    return found, (np.abs(share - 0.5) < UNSURE) | (limb & ~found)


def signed_pixels(masks: Bool[Array, "frames height width"]) -> Float[Array, "frames height width"]:
    """Distance of every pixel centre to the mask's edge, negative inside; the edge runs between two pixels."""
    out = np.empty(masks.shape)
    for f, mask in enumerate(masks):
        if mask.all() or not mask.any():
            out[f] = -np.inf if mask.all() else np.inf
            continue
        out[f] = np.where(mask, 0.5 - distance_to(~mask), distance_to(mask) - 0.5)
    return out


def regrown(masks: Bool[Array, "frames height width"], pixels: float) -> Bool[Array, "frames height width"]:
    """Masks grown by so many pixels, shrunk if negative."""
    return signed_pixels(masks) < pixels
