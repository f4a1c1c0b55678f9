"""Pose refinement: real captures have noisy poses, and a field learnt from them is blurred.

Before training the poses are moved onto the masks (train/align.py); frames that stay off are left out. The refined
poses are written beside the fields, and whoever reads the capture for a run reads them with it (`with_refined`).
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.errors import AssetError
from avatar.files import whole_file
from avatar.npz import read_npz
from train.align import AlignSettings, align
from train.capture import Capture, PartVideo, Subject
from train.check import MISALIGNED, outline_errors

Array = np.ndarray

CHOICES = ("auto", "on", "off")


def refine_wanted(capture: Capture, choice: str, say: Callable[[str], None]) -> frozenset[str]:
    """Parts whose poses are refined: of the posed videos all, none, or those whose outlines miss the masks'."""
    if choice == "off":
        return frozenset()
    posed = frozenset(part for part, video in capture.videos.items() if video.axis_angle is not None)
    if choice == "on":
        return posed
    errors = outline_errors(capture)
    wanted = frozenset(part for part in posed if errors[part] > MISALIGNED)
    if wanted:
        off = ", ".join(f"{part} {errors[part]:.1f} px" for part in sorted(wanted))
        say(f"poses miss the masks ({off}): refined first; --refine-poses off leaves them alone")
    return wanted


def refined_path(folder: Path, part: str) -> Path:
    """Where a run keeps the refined poses of a part's video."""
    return folder / f"refined_{part}.npz"


def refined_video(video: PartVideo, subject: Subject, path: Path) -> tuple[PartVideo, dict]:
    """The video with its poses on its masks and without the frames that stay off; written to `path`.

    Returns:
        the video, and what run.json says of it.
    """
    assert video.axis_angle is not None and video.root is not None
    aligned = align(video, subject, AlignSettings())
    kept = frames_on_the_mask(aligned.edge)
    write_refined(path, aligned.axis_angle[kept], aligned.root[kept], kept)
    facts = {
        "outline_px": round(float(np.median(aligned.edge)), 3),
        "frames_left_out": [int(f) for f in np.setdiff1d(np.arange(len(aligned.edge)), kept)],
    }
    return with_poses(video, aligned.axis_angle[kept], aligned.root[kept], kept), facts


def frames_on_the_mask(edge: Float[Array, "frames"]) -> Array:
    """Frames whose outline error is not more than twice that of the middle frame and a tenth of a pixel."""
    return np.flatnonzero(edge <= 2 * np.median(edge) + 0.1)


def with_poses(
    video: PartVideo, axis_angle: Float[Array, "k 52 3"], root: Float[Array, "k 3"], kept: Array
) -> PartVideo:
    """The frames `kept` of a video, in these poses."""
    return replace(
        video, images=video.images[kept], masks=video.masks[kept], cameras=tuple(video.cameras[f] for f in kept),
        axis_angle=axis_angle, root=root,
    )  # fmt: skip


def write_refined(
    path: Path, axis_angle: Float[Array, "k 52 3"], root: Float[Array, "k 3"], kept: Array
) -> None:
    """refined_PART.npz: the frames kept of the capture's video and their poses."""
    with whole_file(path) as file:
        np.savez(file, axis_angle=axis_angle, root=root, frames=kept.astype(np.int64))


def with_refined(capture: Capture, folder: Path) -> Capture:
    """The capture as a run saw it: its posed videos in the refined poses that lie in the run's folder, if any.

    Raises:
        AssetError: a file of refined poses does not belong to the capture.
    """
    videos = dict(capture.videos)
    for part, video in capture.videos.items():
        path = refined_path(folder, part)
        if path.exists():
            videos[part] = read_refined(path, video)
    return replace(capture, videos=videos)


def read_refined(path: Path, video: PartVideo) -> PartVideo:
    """A video in the refined poses of a file.

    Raises:
        AssetError: the file is broken, or of another video.
    """
    fields = read_npz(path, "refined poses", ("axis_angle", "root", "frames"))
    kept, axis_angle, root = fields["frames"], fields["axis_angle"], fields["root"]
    count = len(kept)
    if kept.ndim != 1 or kept.dtype.kind != "i" or axis_angle.shape != (count, 52, 3) or root.shape != (count, 3):
        raise AssetError(f"{path}: expected axis_angle (k, 52, 3), root (k, 3) and frames (k,), found "
                         f"{axis_angle.shape}, {root.shape}, {kept.shape}")  # fmt: skip
    if count == 0 or kept.min() < 0 or kept.max() >= len(video.images):
        raise AssetError(f"{path}: frames should be of the video's {len(video.images)}")
    return with_poses(video, axis_angle.astype(np.float64), root.astype(np.float64), kept)
