"""The face in the head's video: how finely its eyes are seen, and in which frames they look closed."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.camera import project
from capture.check.coverage import camera_directions
from capture.check.silhouette import canonical_from_head
from capture.folder import Capture
from capture.template.eyes import eye_openings, eye_spheres

# metres, of nearly all grown people
IRIS = 0.0117
# an eye is looked at in frames that see it from within so many degrees of the front
FRONT = 40.0
# metres round the opening that landmarks may be off
ROUND = 0.003
# share of the median contrast of the eyes in the other frames: under it the lids look closed
CLOSED = 0.45


@dataclass(frozen=True)
class FaceReport:
    """What the head's video shows of the eyes; frames are indices."""

    # that see an eye from the front
    frames: int
    metres_per_pixel: float  # at the eyes, median over these
    iris: float  # pixels across one
    # pixels over which the steepest edge of an eye goes from dark to bright, median: 2 is sharp
    edge: float
    # frames in which both lids look closed
    closed: tuple[int, ...]


class _Look(NamedTuple):
    """One eye in one frame."""

    frame: int
    scale: float  # metres a pixel
    contrast: float  # out of 255, between dark and bright
    edge: float  # pixels


def face_report(capture: Capture) -> FaceReport | None:
    """What the head's video shows of the eyes; None for a template whose eyes are not known."""
    spheres = eye_spheres(capture.subject)
    opening = eye_openings(capture.subject)
    if spheres is None or not len(opening):
        return None
    to_head = np.linalg.inv(canonical_from_head(capture))
    scale = float(np.cbrt(np.linalg.det(to_head[:3, :3])))
    # degrees from straight before the face to the camera, to its left positive
    x, _, z = camera_directions(capture, "head").T
    turns = np.degrees(np.arctan2(x, z))
    looks: list[_Look] = []
    for frame in np.flatnonzero(np.abs(turns) < FRONT):
        for centre in spheres.centres:
            own = opening[np.linalg.norm(opening - centre, axis=1) < 2 * spheres.radii.max()]
            found = _look(capture, int(frame), own @ to_head[:3, :3].T + to_head[:3, 3], scale)
            if found is not None:
                looks.append(found)
    if not looks:
        return FaceReport(0, float("nan"), float("nan"), float("nan"), ())
    seen = sorted({look.frame for look in looks})
    # the wider open eye of a frame: the other one may lie behind the nose
    contrast = {frame: max(look.contrast for look in looks if look.frame == frame) for frame in seen}
    usual = float(np.median(list(contrast.values())))
    pixel = float(np.median([look.scale for look in looks]))
    return FaceReport(
        frames=len(seen),
        metres_per_pixel=pixel,
        iris=IRIS / pixel,
        edge=float(np.median([look.edge for look in looks])),
        closed=tuple(frame for frame in seen if contrast[frame] < CLOSED * usual),
    )


def _look(capture: Capture, frame: int, opening: Float[Array, "n 3"], scale: float) -> _Look | None:
    """One eye in one frame, its opening in the head frame; None where the picture or the mask does not hold it."""
    video = capture.videos["head"]
    camera = video.cameras[frame]
    pixels, depth = project(camera, opening)
    pixel = float(np.median(depth)) / scale / float(camera.K[1, 1])
    low, high = pixels.min(0) - ROUND / pixel, pixels.max(0) + ROUND / pixel
    width, height = camera.size
    if depth.min() <= 0 or (low < 1).any() or (high > np.array([width, height]) - 1).any():
        return None
    (x0, y0), (x1, y1) = np.floor(low).astype(int), np.ceil(high).astype(int)
    if not video.masks[frame, y0:y1, x0:x1].all():
        return None
    grey = video.images[frame, y0 - 1 : y1 + 1, x0 - 1 : x1 + 1].astype(np.float64).mean(-1)
    dark, bright = np.percentile(grey, [5, 95])
    slopes = np.gradient(grey)
    steepest = float(np.percentile(np.hypot(*slopes), 98))
    return _Look(frame, pixel, float(bright - dark), float(bright - dark) / max(steepest, 1e-6))


def face_line(report: FaceReport) -> str:
    """The report for reading."""
    if not report.frames:
        return "face: no frame of the head's video shows an eye from the front"
    closed = f"; lids look closed in frames {', '.join(map(str, report.closed))}" if report.closed else ""
    return (
        f"face: {report.frames} frames see the eyes from the front, {report.metres_per_pixel * 1000:.1f} mm a pixel "
        f"there, an iris {report.iris:.0f} pixels wide, edges over {report.edge:.1f} pixels{closed}"
    )
