"""Refinement of a capture before training: real captures have noisy poses, and masks all too large or too small.

A field learned from poses that are off is blurred, one learned from masks that are off is fat or thin. Both are
measured against the outline of the template, which is the registered person. Masks whose outline lies outside or
inside of the template's in the same way in body and hands are redrawn (capture/fit/masks.py), and pixels that stay
unsure
supervise nothing. Poses are moved onto the masks (capture/fit/align.py), frames that stay off are left out; what is
left is learned with the field (train/pose_correction.py).

What was refined lies in the run's folder, refined_PART.npz; who reads the capture for a run reads it `with_refined`.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.skeleton import PARTS
from capture.check.silhouette import MISALIGNED, outline_errors
from capture.fit.align import align, outline_offset
from capture.fit.masks import believed_offset, mask_offsets, pixels_off, redrawn
from capture.folder import Capture, CaptureSubject, PartVideo, read_capture
from capture.videos import changed, only
from command.errors import AssetError
from command.progress import Reporter, plural
from files.input_file import read_json_object
from files.npz import read_npz
from files.whole import whole_file

# what refined_PART.npz holds beside `frames` and `masks_off`, where there is any
REFINED = ("axis_angle", "root", "masks", "unsure")


@dataclass(frozen=True)
class RefineJob:
    """The refinement of one video, for a worker process."""

    capture: str
    subject: CaptureSubject  # as it is dressed, not as the capture has it
    part: str
    folder: str  # RUN.partial
    # how far outside of the true outline the masks are, pixels of an image 256 high
    masks_off: float = 0.0


def refine_capture(
    capture: Capture, folder: Path, choice: str, say: Callable[[str], None],
    run: Callable[[Mapping[str, RefineJob], Callable[[RefineJob, Reporter], dict]], dict[str, dict]],
) -> dict[str, Any]:  # fmt: skip
    """Write refined_PART.npz of every part into `folder` where poses or masks are off; returns what was found.

    `choice`: off measures nothing, on refines all poses, auto those whose outlines miss the masks'; not those that were
    fitted to outlines and keypoints together, which outlines alone would draw away again. `run` does the jobs, several
    at a time. Files that are there (a training that goes on) are kept.
    """
    if not may_refine(capture, choice):
        return {}
    done = folder / "refined.json"
    if done.exists():
        return read_json_object(done, "what refining the poses found")
    # the head's has no poses
    posed = only(capture.videos, [part for part in capture.videos if part != "head"])
    # masks first: poses that are moved onto small masks step back, and hide a part of what is missing
    offsets = mask_offsets(posed, capture.subject)
    believed = believed_offset(offsets)
    errors = outline_errors(capture) if choice == "auto" else {}
    wanted = [part for part in posed if choice == "on" or errors[part] > MISALIGNED]
    if wanted and errors:
        off = ", ".join(f"{part} {errors[part]:.1f} px" for part in wanted)
        say(f"outlines miss the masks ({off}): poses refined first; --refine-poses off keeps them")
    jobs = {part: RefineJob(str(capture.path), capture.subject, part, str(folder), believed) for part in wanted}
    facts: dict[str, Any] = dict(run(jobs, refine_part))
    masks_off = believed_offset(offsets | {part: facts[part]["masks_off_px"] for part in facts})
    if masks_off:
        word = "large" if masks_off > 0 else "small"
        say(f"masks are {abs(masks_off):.1f} px too {word}: redrawn, pixels that stay unsure supervise nothing")
    if wanted or masks_off:
        facts["masks_off_px"] = round(masks_off, 3)
        for part in capture.videos:
            _correct_masks(capture, part, refined_path(folder, part), masks_off)
    with whole_file(done, "w") as file:
        json.dump(facts, file)
    return facts


def may_refine(capture: Capture, choice: str) -> bool:
    """Whether there is anything to measure: what was fitted here was fitted to its outlines."""
    return choice == "on" or (choice == "auto" and not capture.fitted_here)


def refine_part(job: RefineJob, reporter: Reporter) -> dict:
    """Align one video's poses with its masks and write them; returns what run.json says of it."""
    path = refined_path(Path(job.folder), job.part)
    video, subject = read_capture(job.capture, parts=(job.part,)).videos[job.part], job.subject
    if job.masks_off:
        video = replace(video, masks=redrawn(video, subject, pixels_off(video, job.masks_off)).masks)
    assert video.axis_angle is not None and video.root is not None
    aligned = align(video, subject, lambda number: reporter.step(number + 1, "poses onto masks"))
    kept = frames_on_the_mask(aligned.edge)
    video = _with_poses(video, aligned.axis_angle[kept], aligned.root[kept], kept)
    facts = {
        "outline_px": round(float(np.median(aligned.edge)), 3),
        "frames_left_out": [int(f) for f in np.setdiff1d(np.arange(len(aligned.edge)), kept)],
        "masks_off_px": round(job.masks_off + outline_offset(video, subject), 3),
    }
    with whole_file(path.with_suffix(".poses")) as file:
        np.savez(file, axis_angle=aligned.axis_angle[kept], root=aligned.root[kept], frames=kept)
    reporter.say(
        f"{job.part}: poses on the masks, outlines {facts['outline_px']:.2f} px apart, "
        f"{plural(len(facts['frames_left_out']), 'frame')} left out"
    )
    return facts


def frames_on_the_mask(edge: Float[Array, "frames"]) -> Int[Array, "kept"]:
    """Frames whose outline error is not more than twice that of the middle frame and a tenth of a pixel."""
    return np.flatnonzero(edge <= 2 * np.median(edge) + 0.1)


def refined_path(folder: Path, part: str) -> Path:
    """Where a run keeps what was refined of a part's video."""
    return folder / f"refined_{part}.npz"


def with_refined(capture: Capture, folder: Path) -> Capture:
    """The capture as a run saw it: with the refined poses and masks that lie in the run's folder, if any.

    Raises:
        AssetError: a file of refined poses does not belong to the capture.
    """

    def refined(part: str, video: PartVideo) -> PartVideo:
        path = refined_path(folder, part)
        return read_refined(path, video) if path.exists() else video

    there = [part for part in capture.videos if refined_path(folder, part).exists()]
    if not there:
        return capture
    videos = changed(capture.videos, refined)
    # a file that does not fit is refused now, not when its video is asked for
    for part in there:
        videos[part]
    return replace(capture, videos=videos)


def kept_frames(folder: Path, part: str) -> Int[Array, "kept"] | None:
    """Which frames of a part's video a run kept; None: all."""
    path = refined_path(folder, part)
    return read_npz(path, "refined poses", ("frames",))["frames"] if path.exists() else None


def poses_refined(folder: Path, part: str) -> bool:
    """Whether the poses of a part's video were moved, and not only its masks."""
    path = refined_path(folder, part)
    return path.exists() and "axis_angle" in read_npz(path, "refined poses", ("frames",), ("axis_angle",))


def write_learned(folder: Path, part: str, video: PartVideo) -> None:
    """Keep the poses that the training of a part ended with, beside those that it began with: it may be resumed."""
    assert video.axis_angle is not None and video.root is not None
    with whole_file(_learned_path(folder, part)) as file:
        np.savez(file, allow_pickle=False, axis_angle=video.axis_angle, root=video.root)


def with_learned(capture: Capture, folder: Path) -> Capture:
    """The capture `with_refined`, in the poses that training ended with where it learned them."""

    def learned(part: str, video: PartVideo) -> PartVideo:
        path = _learned_path(folder, part)
        if not path.exists():
            return video
        return replace(video, **read_npz(path, "learned poses", ("axis_angle", "root")))

    return replace(capture, videos=changed(capture.videos, learned))


def copy_refined(partial: Path, folder: Path) -> None:
    """What was refined, into the run's folder, with the poses that training ended with."""
    for part in PARTS:
        path, learned = refined_path(partial, part), _learned_path(partial, part)
        if not path.exists():
            continue
        fields = read_npz(path, "refined poses", ("frames", "masks_off"), REFINED)
        if learned.exists():
            fields |= read_npz(learned, "learned poses", ("axis_angle", "root"))
        with whole_file(refined_path(folder, part)) as file:
            np.savez_compressed(file, allow_pickle=False, **fields)


def _learned_path(folder: Path, part: str) -> Path:
    return folder / f"learned_{part}.npz"


def read_refined(path: Path, video: PartVideo) -> PartVideo:
    """A video with the refined poses and masks of a file.

    Raises:
        AssetError: the file is broken, or of another video.
    """
    fields = read_npz(path, "refined poses", ("frames", "masks_off"), REFINED)
    kept, masks_off = fields["frames"], fields["masks_off"]
    if kept.ndim != 1 or kept.dtype.kind != "i" or len(kept) == 0 or masks_off.shape != ():
        raise AssetError(f"{path}: expected frames (k,) and one masks_off, found {kept.shape}, {masks_off.shape}")
    if kept.min() < 0 or kept.max() >= len(video.images):
        raise AssetError(f"{path}: frames should be of the video's {len(video.images)}")
    axis_angle, root = video.axis_angle, video.root
    if axis_angle is not None and root is not None:
        axis_angle, root = fields.get("axis_angle", axis_angle[kept]), fields.get("root", root[kept])
        if axis_angle.shape != (len(kept), 52, 3) or root.shape != (len(kept), 3):
            raise AssetError(
                f"{path}: axis_angle and root should be of {len(kept)} frames, are {axis_angle.shape}, {root.shape}"
            )
    video = _with_poses(video, axis_angle, root, kept)
    if masks_off == 0:
        return video
    shape, bits = video.masks.shape, {}
    for name in ("masks", "unsure"):
        packed, count = fields.get(name), int(np.prod(shape))
        if packed is None or packed.dtype != np.uint8 or len(packed) != -(-count // 8):
            raise AssetError(f"{path}: {name} should be {count} bits")
        bits[name] = np.unpackbits(packed, count=count).astype(bool).reshape(shape)
    return replace(video, **bits)


def _with_poses(video: PartVideo, axis_angle: Array | None, root: Array | None, kept: Int[Array, "k"]) -> PartVideo:
    if len(kept) == len(video.images) and (kept == np.arange(len(kept))).all():
        # no second copy of all pixels
        return replace(video, axis_angle=axis_angle, root=root)
    return replace(
        video, images=video.images[kept], masks=video.masks[kept], cameras=tuple(video.cameras[f] for f in kept),
        unsure=None if video.unsure is None else video.unsure[kept], axis_angle=axis_angle, root=root,
        trunk=None if video.trunk is None else video.trunk[kept],
    )  # fmt: skip


def _correct_masks(capture: Capture, part: str, path: Path, masks_off: float) -> None:
    """Write refined_PART.npz: the poses found before, if any, and what to do with the masks."""
    video = capture.videos[part]
    found = path.with_suffix(".poses")
    fields: dict[str, Array] = {"frames": np.arange(len(video.images))}
    if found.exists():
        fields = read_npz(found, "refined poses", ("frames", "axis_angle", "root"))
    pixels = pixels_off(video, masks_off)
    fields["masks_off"] = np.array(pixels)
    if pixels:
        kept = fields["frames"]
        poses = (None, None) if video.axis_angle is None or video.root is None else (
            fields.get("axis_angle", video.axis_angle), fields.get("root", video.root))  # fmt: skip
        video = _with_poses(video, *poses, kept)
        fields |= {name: np.packbits(bits) for name, bits in redrawn(video, capture.subject, pixels)._asdict().items()}
    with whole_file(path) as file:
        np.savez_compressed(file, allow_pickle=False, **fields)
    found.unlink(missing_ok=True)
