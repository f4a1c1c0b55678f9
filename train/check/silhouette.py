"""The posed template drawn over the video frames: how far its outline is from that of the mask."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from avatar.rasterise import Fragments, rasterise
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from train.capture import PARTS, Capture, Subject
from train.cells import distance_to, nearest_marked
from train.register import similarity_from_landmarks

Array = np.ndarray

# Mean outline error of the worst part beyond which poses are worth refining, pixels of an image 256 high.
# Measured on four people: exact poses 0.3-0.4 in every part; 2 degrees of pose noise 2 on the body, 15-20 on hands.
MISALIGNED = 1.0


@dataclass(frozen=True)
class Outline:
    """One frame's template against its mask, where the template shows the part that the video is of."""

    frame: int
    edge: float  # pixels, mean distance between the two outlines, both ways; nan where either has none
    iou: float  # intersection over union of the two areas near the part; nan where neither shows it


def misalignment(capture: Capture, frames: int = 4) -> float:
    """Mean outline error of the worst posed part over a few frames of each, in pixels of an image 256 high.

    Beyond MISALIGNED the poses (or the template, or the masks) do not explain the silhouettes. The head has no
    pose, and its outline is that of the hair, which no template has: it is left out.
    """
    return max(error for part, error in outline_errors(capture, frames).items() if part != "head")


def outline_errors(capture: Capture, frames: int = 4) -> dict[str, float]:
    """Mean outline error of each part over `frames` evenly chosen frames, in pixels of an image 256 high.

    A part whose outlines are never both in the image is infinitely far off.
    """
    errors = {}
    for part, video in capture.videos.items():
        chosen = np.unique(np.linspace(0, len(video.masks), frames, endpoint=False).astype(int))
        edges = [outline(capture, part, int(frame))[0].edge for frame in chosen]
        finite = [edge for edge in edges if np.isfinite(edge)]
        errors[part] = float(np.mean(finite)) * 256 / video.masks.shape[1] if finite else np.inf
    return errors


def outline(capture: Capture, part: str, frame: int) -> tuple[Outline, Fragments]:
    """The template drawn in one frame, and how its outline agrees with the mask's."""
    video = capture.videos[part]
    drawn = rasterise(posed_template(capture, part, frame), capture.subject.faces, video.cameras[frame])
    edge, iou = agreement(drawn_parts(drawn, capture.subject), video.masks[frame], PARTS.index(part))
    return Outline(frame, edge, iou), drawn


def posed_template(capture: Capture, part: str, frame: int) -> Float[Array, "v 3"]:
    """The template as one frame should show it, in the frame of that video's cameras.

    The head video: the canonical template, moved into the head frame by the landmarks (Eq. 6). Its body is
    not posed as the person's, only its head counts.
    """
    video, subject = capture.videos[part], capture.subject
    if video.axis_angle is None or video.root is None:
        head_from_canonical = np.linalg.inv(canonical_from_head(capture))
        return subject.vertices @ head_from_canonical[:3, :3].T + head_from_canonical[:3, 3]
    B = skin_transforms(video.axis_angle[frame], subject.joints, video.root[frame])
    return skin_points(subject.vertices, subject.skin, B)


def canonical_from_head(capture: Capture) -> Float[Array, "4 4"]:
    """Eq. 6 of the head video's landmarks; ValueError where they determine nothing."""
    video = capture.videos["head"]
    assert video.landmarks is not None and video.landmark_vertices is not None
    target = capture.subject.vertices[video.landmark_vertices]
    return similarity_from_landmarks(video.landmarks, target).transform


def drawn_parts(drawn: Fragments, subject: Subject) -> Int[Array, "h w"]:
    """Part of the template at each pixel, -1 where there is none."""
    of_face = np.sort(subject.part[subject.faces], 1)[:, 1]  # the majority of the three
    return np.where(drawn.face >= 0, of_face[drawn.face], -1)


def agreement(parts: Int[Array, "h w"], mask: Bool[Array, "h w"], part: int) -> tuple[float, float]:
    """Mean distance between the outlines of template and mask along one part, and the overlap of their areas.

        edge = (mean over template outline of the part, of the distance to the mask's outline
                + mean over the mask's outline nearest to the part, of the distance to the template's) / 2

    Outlines do not run along the image border: there the picture ends, not the person. A pixel belongs to the
    part when the nearest template pixel does; areas count within a tenth of the image height of the template.
    """
    template = parts >= 0
    if not (parts == part).any() or not mask.any():
        return np.nan, (0.0 if mask.any() or (parts == part).any() else np.nan)
    away = distance_to(template)
    own = parts[nearest_marked(template)] == part
    near = own & (away < 0.1 * mask.shape[0])
    union = (near & (template | mask)).sum()
    iou = float((near & template & mask).sum() / union) if union else np.nan
    of_template, of_mask = _outline(template), _outline(mask)
    if not (of_template & own).any() or not of_mask.any():
        return np.nan, iou
    there = distance_to(of_mask)[of_template & own]
    back, facing = distance_to(of_template), of_mask & own[nearest_marked(of_template)]
    return float(np.mean([there.mean(), back[facing].mean()] if facing.any() else there.mean())), iou


def _outline(area: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """Pixels of the area with a neighbour outside it; what lies beyond the image counts as the area."""
    return area & ~np.asarray(ndimage.binary_erosion(area, border_value=1), bool)
