"""The posed template drawn over the video frames: how far its outline is from that of the mask."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.camera import Camera
from avatar.similarity import similarity_from_landmarks
from avatar.skeleton import PARTS, skin_transforms
from avatar.skinning import skin_points
from capture.folder import Capture
from capture.videos import even
from geometry.cells import distance_to, nearest_marked, rim_of
from geometry.mesh import face_values
from geometry.rasterise import rasterise

# outline error of the worst posed part beyond which poses are worth refining, in pixels as `common` counts them.
# Measured on four people: exact poses 0.3-0.5; masks eroded by 3 px 0.5, dilated by 3 px 0.9; 2 degrees of pose noise
# 2.2 on the body, 25-35 on the hands.
MISALIGNED = 1.0
# frames of a part that say whether its poses are worth refining
COMPARED = 4
# a larger frame is compared on every second, third ... pixel
ROWS = 540


class Agreement(NamedTuple):
    """How two outlines agree along one part; nan where either has none there. Pixels of the compared grid."""

    # mean distance between the outlines, both ways
    edge: float
    # median of that distance with sign: positive where the template is the larger
    offset: float
    # mean departure from the offset: what a wrong pose gives and a wrong mask threshold does not
    spread: float
    # intersection over union of the areas near the part
    iou: float
    # area of the mask over area of the template, near the part
    fill: float


@dataclass(frozen=True)
class TemplateOutline:
    """The template drawn over one frame; pixels are the image's own."""

    frame: int
    agreement: Agreement
    # template part at each compared pixel, -1 where there is none
    parts: Int[Array, "height width"]
    step: int  # pixels of the image between compared ones


def outline_errors(capture: Capture) -> dict[str, float]:
    """Mean outline error (`spread`) of each part over COMPARED even frames, in `common` pixels.

    Beyond MISALIGNED the poses (or the template) do not explain the silhouettes; but for the head, whose outline is
    that of the hair, which no template has. A part whose outlines are never both in the image is infinitely far off.
    """
    errors = {}
    for part in capture.videos:
        frames, rows, _ = capture.videos[part].masks.shape
        spread = np.array([outline(capture, part, i).agreement.spread for i in even(frames, COMPARED)])
        seen = np.isfinite(spread)
        errors[part] = common(float(spread[seen].mean()), rows) if seen.any() else np.inf
    return errors


def common(pixels: float, rows: int) -> float:
    """Pixels of an image of so many rows as pixels of one 256 high; a smaller image is as coarse as it is."""
    return pixels * 256 / max(rows, 256)


def outline(capture: Capture, part: str, frame: int) -> TemplateOutline:
    """The template drawn over one frame, and how its outline agrees with the mask's along the video's part."""
    video = capture.videos[part]
    mask, camera = video.masks[frame], video.cameras[frame]
    step = -(-mask.shape[0] // ROWS)
    if step > 1:
        rows, columns = mask.shape[0] // step, mask.shape[1] // step
        mask = mask[step // 2 :: step, step // 2 :: step][:rows, :columns]
        # what does not fill a step is cut off
        whole = (columns * step, rows * step)
        camera = Camera(camera.K, camera.camera_from_world, whole, camera.distortion).resized((columns, rows))
    drawn = rasterise(posed_template(capture, part, frame), capture.subject.faces, camera)
    part_of_face = face_values(capture.subject.part, capture.subject.faces)
    parts = np.where(drawn.face >= 0, part_of_face[drawn.face], -1)
    found = agreement(parts, mask, PARTS.index(part))
    pixels = found._replace(edge=step * found.edge, offset=step * found.offset, spread=step * found.spread)
    return TemplateOutline(frame, pixels, parts, step)


def posed_template(capture: Capture, part: str, frame: int) -> Float[Array, "vertices 3"]:
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


def agreement(parts: Int[Array, "height width"], mask: Bool[Array, "height width"], part: int) -> Agreement:
    """Distance between the outlines of template and mask along one part, and the overlap of their areas.

    Both outlines are measured against the other: the template's where it shows the part, the mask's where the
    nearest pixel of the template's outline shows it. Outlines do not run along the image border: there the
    picture ends, not the person. Areas count within a tenth of the image height of the template.
    """
    template = parts >= 0
    if not (parts == part).any() or not mask.any():
        empty = 0.0 if mask.any() or (parts == part).any() else np.nan
        return Agreement(np.nan, np.nan, np.nan, empty, empty)
    own = parts[nearest_marked(template)] == part
    near = own & (distance_to(template) < 0.1 * mask.shape[0])
    both, either = (near & template & mask).sum(), (near & (template | mask)).sum()
    iou, fill = float(both / either), float((near & mask).sum() / (near & template).sum())
    of_template, of_mask = rim_of(template), rim_of(mask)
    here = of_template & own
    if not here.any() or not of_mask.any():
        return Agreement(np.nan, np.nan, np.nan, iou, fill)
    facing = of_mask & own[nearest_marked(of_template)]
    to_mask, to_template = distance_to(of_mask), distance_to(of_template)
    beyond = np.where(mask, -to_mask, to_mask)[here]
    within = np.where(template, to_template, -to_template)[facing]
    signed = np.concatenate([beyond, within])
    offset = float(np.median(signed))
    # each outline counts the same, however many pixels it has; the second may be empty
    both = [beyond, within] if len(within) else [beyond]
    edge, spread = (float(np.mean([np.abs(one - o).mean() for one in both])) for o in (0.0, offset))
    return Agreement(edge, offset, spread, iou, fill)
