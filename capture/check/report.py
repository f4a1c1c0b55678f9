"""Everything that is measured of a capture, part by part."""

from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from avatar.camera import project
from avatar.similarity import similarity_from_landmarks
from avatar.skeleton import PARTS
from capture.check.coverage import Coverage, coverage
from capture.check.pictures import Clipping, blurred, exposure, repeated, sharpness
from capture.check.silhouette import Agreement, TemplateOutline, agreement, outline, posed_template
from capture.check.unseen import UnseenPlace, frames_that_see, unseen_places
from capture.folder import Capture
from capture.template.surface import visible_faces
from capture.videos import even

# frames of each video whose outlines are compared, at most
COMPARED = 40
# logarithm of mask area over template area, from the video's median
JUMP = 0.15


@dataclass(frozen=True)
class PartReport:
    """One video. Frames are indices; pixels are the image's own."""

    part: str
    frames: int
    size: tuple[int, int]  # pixels
    metres_per_pixel: float  # at the part
    # metres, median of camera to the middle of the part
    distance: float
    outlines: tuple[TemplateOutline, ...]
    # over the outlines; the head's is that of the hair as well
    mean: Agreement
    # frames, those with the largest outline error first
    worst: tuple[int, ...]
    # share of the template's part that the masks leave out, median over frames
    outside: float
    # the other hand's masks fit this hand's poses better, or its pictures show the other hand
    exchanged: bool
    empty: tuple[int, ...]
    # frames whose mask has another size than the template explains
    jumps: tuple[int, ...]
    # the part itself touches the image border
    cropped: tuple[int, ...]
    blurred: tuple[int, ...]
    repeated: tuple[int, ...]
    exposure: Clipping
    coverage: Coverage


@dataclass(frozen=True)
class CaptureReport:
    height: float  # metres, of the template in pose 0
    landmarks: int
    # metres, root mean square of Eq. 6; nan where the landmarks determine nothing
    landmark_residual: float
    head_scale: float  # metres per unit of the head frame
    parts: dict[str, PartReport]
    # sides of limbs that hardly any frame shows, the largest first
    unseen: tuple[UnseenPlace, ...] = ()


def examine(capture: Capture) -> CaptureReport:
    """Measure everything. ValueError where the head's landmarks determine no frame (Eq. 6)."""
    head, subject = capture.videos["head"], capture.subject
    assert head.landmarks is not None and head.landmark_vertices is not None
    fit = similarity_from_landmarks(head.landmarks, subject.vertices[head.landmark_vertices])
    scale = float(np.cbrt(np.linalg.det(fit.transform[:3, :3])))
    visible = visible_faces(subject)
    parts = {part: examine_part(capture, part, scale, visible) for part in PARTS}
    height = float(np.ptp(subject.rest[:, 1]))
    unseen = unseen_places(subject.rest, subject.faces, subject.skin, frames_that_see(capture), visible)
    return CaptureReport(height, len(head.landmarks), fit.residual, scale, parts, unseen)


def examine_part(capture: Capture, part: str, head_scale: float, visible: Bool[Array, "faces"]) -> PartReport:
    """Measure one video; `head_scale` is metres per unit of the head frame, `visible` the template's outer faces."""
    video, index = capture.videos[part], PARTS.index(part)
    outlines = tuple(outline(capture, part, frame) for frame in even(len(video.masks), COMPARED))
    table = np.array([o.agreement for o in outlines])
    seen = np.isfinite(table[:, 0])
    mean = Agreement(*(table[seen].mean(0).tolist() if seen.any() else [np.inf, np.nan, np.inf, 0.0, 0.0]))
    error = np.where(seen, table[:, 2], np.inf)
    worst = tuple(outlines[i].frame for i in np.argsort(-error, kind="stable")[:3])
    fill = np.log(np.maximum(table[:, 4], 1e-3))
    jumps = np.flatnonzero(seen & (np.abs(fill - np.median(fill[seen])) > JUMP)) if seen.any() else []
    own = np.array([(o.parts == index).sum() for o in outlines])
    inside = [(o.parts == index) & _compared(video.masks[o.frame], o) for o in outlines]
    left_out = own - [area.sum() for area in inside]
    distance = _distance(capture, part) * (head_scale if part == "head" else 1.0)
    sharp = sharpness(video.images, video.masks)
    return PartReport(
        part=part,
        frames=len(video.masks),
        size=video.cameras[0].size,
        metres_per_pixel=distance / float(np.median([c.K[1, 1] for c in video.cameras])),
        distance=distance,
        outlines=outlines,
        mean=mean,
        worst=worst,
        outside=float(np.median(left_out / np.maximum(own, 1))),
        exchanged=_exchanged(capture, part, outlines, mean),
        empty=tuple(i for i, mask in enumerate(video.masks) if not mask.any()),
        jumps=tuple(outlines[i].frame for i in jumps),
        cropped=tuple(o.frame for o, area in zip(outlines, inside) if area.sum() > area[1:-1, 1:-1].sum()),
        blurred=tuple(blurred(sharp)),
        repeated=tuple(repeated(video.images)),
        exposure=exposure(video.images, video.masks),
        coverage=coverage(capture, part, visible),
    )


def _compared(mask: Array, o: TemplateOutline) -> Array:
    begin, (rows, columns) = o.step // 2, o.parts.shape
    return mask[begin :: o.step, begin :: o.step][:rows, :columns]


def _distance(capture: Capture, part: str) -> float:
    """From the camera to the middle of the part, in the unit of the video's frame; median over some frames."""
    chosen = capture.subject.part == PARTS.index(part)
    video = capture.videos[part]
    depth = []
    for frame in even(len(video.masks), 8):
        middle = posed_template(capture, part, frame)[chosen].mean(0)
        depth.append(project(video.cameras[frame], middle[None])[1][0])
    return float(np.median(depth))


def _exchanged(capture: Capture, part: str, outlines: tuple[TemplateOutline, ...], mean: Agreement) -> bool:
    """Whether a hand video is that of the other hand: the other's masks fit its poses, or it shows the other."""
    if not part.startswith("hand") or mean.iou > 0.8:
        return False
    other = "hand_right" if part == "hand_left" else "hand_left"
    own, next_to = PARTS.index(part), PARTS.index(other)
    shown = np.median([(o.parts == next_to).sum() > 4 * (o.parts == own).sum() for o in outlines])
    masks = capture.videos[other].masks
    cross = [agreement(o.parts, _compared(masks[o.frame], o), own).iou for o in outlines
             if o.frame < len(masks) and _compared(masks[o.frame], o).shape == o.parts.shape]  # fmt: skip
    return bool(shown) or (len(cross) > 0 and float(np.nanmedian(cross)) > mean.iou + 0.3)


def report_facts(report: CaptureReport) -> dict:
    """The report as JSON holds it: numbers and frame lists; nan and infinity are null."""
    parts = {}
    for name, part in report.parts.items():
        facts = {k: v for k, v in asdict(part).items() if k not in ("part", "outlines", "coverage", "exposure", "mean")}
        facts["outline"] = part.mean._asdict()
        facts["per_frame"] = [{"frame": o.frame, **o.agreement._asdict()} for o in part.outlines]
        facts["exposure"] = part.exposure._asdict()
        facts["coverage"] = {"seen": part.coverage.seen, "gap_degrees": part.coverage.gap}
        parts[name] = facts
    whole = {k: getattr(report, k) for k in ("height", "landmarks", "landmark_residual", "head_scale")}
    unseen = [asdict(place) for place in report.unseen]
    return {key: _plain(value) for key, value in {**whole, "parts": parts, "unseen": unseen}.items()}


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.bool):
        return bool(value)
    if isinstance(value, float):
        return round(value, 6) if np.isfinite(value) else None
    return value
