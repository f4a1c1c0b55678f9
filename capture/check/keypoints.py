"""Do the poses follow keypoints that a detector found? Outlines of an arm's two sides look alike; points do not.

Joints of the posed template are projected into each frame and compared with the points of the same names. Detectors
place hips and shoulders some centimetres off a skeleton's, so only what is far off is a finding: all points (another
video, another order of frames), or left and right, which fit better exchanged.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.camera import project
from avatar.skeleton import JOINTS, joint_transforms
from capture.check.report import CaptureReport
from capture.fit.directions import opposite
from capture.folder import Capture
from capture.keypoints.read import read_keypoints
from capture.raw.judge import Finding
from command.errors import AssetError

PARTS = ("body", "hand_left", "hand_right")
# confidence from which a point is compared
SURE = 0.3
# metres at the part, median over points: worth a look, of another video
FAR = (0.06, 0.20)
# share of frames in which exchanged sides fit better
EXCHANGED = 0.5


@dataclass(frozen=True)
class Followed:
    """How far one video's poses are from its keypoints."""

    part: str
    points: int  # compared, over all frames
    pixels: float  # median distance
    metres: float  # the same at the part
    worst: str  # the joint that is farthest off, by its median
    worst_metres: float
    exchanged: float  # share of frames that fit better with left and right exchanged
    notes: tuple[str, ...]


def compare_keypoints(capture: Capture, folder: Path, report: CaptureReport) -> tuple[Followed, ...]:
    """Compare the videos that the folder has keypoints for.

    Raises:
        AssetError: no keypoints of any video, or as many frames as the video has not, or none that is sure.
    """
    parts = [part for part in PARTS if (folder / part).exists()]
    if not parts:
        raise AssetError(f"{folder}: expected keypoints in body, hand_left or hand_right, found none")
    return tuple(_followed(capture, part, folder / part, report.parts[part].metres_per_pixel) for part in parts)


def keypoint_findings(followed: tuple[Followed, ...]) -> list[Finding]:
    """What there is to act on."""
    found = []
    for part in followed:
        worst = f"{part.worst} {100 * part.worst_metres:.0f} cm"
        far = f"poses are {100 * part.metres:.0f} cm off the keypoints (median; {worst})"
        if part.exchanged > EXCHANGED:
            found.append(Finding(part.part, True, f"left and right are exchanged in {part.exchanged:.0%} of the frames",
                                 "the poses or the keypoints are mirrored; fit or detect again"))  # fmt: skip
        elif part.metres > FAR[0]:
            advice = "are they of this video, frame by frame? else fit the poses again"
            found.append(Finding(part.part, part.metres > FAR[1], far, advice))
    return found


def keypoint_lines(followed: tuple[Followed, ...]) -> list[str]:
    """What was measured, for reading."""
    out = []
    for part in followed:
        out.append(
            f"{part.part}: keypoints {part.pixels:.1f} px, {100 * part.metres:.1f} cm off (median of {part.points}); "
            f"{part.worst} most, {100 * part.worst_metres:.1f} cm"
        )
        out += [f"{part.part}: {note}" for note in part.notes]
    return out


def _followed(capture: Capture, part: str, path: Path, metres_per_pixel: float) -> Followed:
    video = capture.videos[part]
    assert video.axis_angle is not None and video.root is not None
    found = read_keypoints(path, size=video.cameras[0].size)
    frames = len(video.cameras)
    if len(found.pixels) != frames:
        raise AssetError(f"{path}: expected keypoints for each of {frames} frames, found {len(found.pixels)}")
    if found.size is not None and found.size != video.cameras[0].size:
        raise AssetError(f"{path}: keypoints of {found.size} pictures, the video's are {video.cameras[0].size}")
    names = [name for name in found.names if name in JOINTS]
    seen = np.stack([found.seen(name) for name in names], 1)
    joints = joint_transforms(video.axis_angle, capture.subject.joints, video.root)[:, :, :3, 3]
    shown = np.stack([project(camera, at)[0] for camera, at in zip(video.cameras, joints, strict=True)])
    own = [JOINTS.index(name) for name in names]
    off, other = _distances(shown[:, own], seen), _distances(shown[:, opposite(JOINTS)[own]], seen)
    if not np.isfinite(off).any():
        raise AssetError(f"{path}: no point has a confidence above {SURE:g}")
    with_points = np.isfinite(off).any(1)
    swapped = np.nanmedian(other[with_points], 1) < 0.5 * np.nanmedian(off[with_points], 1)
    have = np.isfinite(off).any(0)
    by_name = np.where(have, np.nanmedian(np.where(have, off, 0), 0), -1)
    worst = int(np.argmax(by_name))
    median = float(np.nanmedian(off))
    return Followed(
        part, int(np.isfinite(off).sum()), median, median * metres_per_pixel, names[worst],
        float(by_name[worst]) * metres_per_pixel, float(swapped.mean()), found.notes,
    )  # fmt: skip


def _distances(shown: Float[Array, "frames n 2"], seen: Float[Array, "frames n 3"]) -> Float[Array, "frames n"]:
    """Pixels between joints and points; NaN where the point is not sure."""
    return np.where(seen[:, :, 2] > SURE, np.linalg.norm(shown - seen[:, :, :2], axis=-1), np.nan)
