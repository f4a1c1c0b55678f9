"""Refinement of a capture before training: real captures have noisy poses, and masks all too large or too small.

A field learnt from poses that are off is blurred, one learnt from masks that are off is fat or thin. Both are
measured against the outline of the template, which is the registered person. Poses are moved onto the masks
(train/align.py), frames that stay off are left out. Masks whose outline lies outside or inside of the template's
in the same way in body and hands are shrunk or grown by as much, and pixels near their edge supervise nothing.

What was refined lies in the run's folder, refined_PART.npz; who reads the capture for a run reads it `with_refined`.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from avatar.errors import AssetError
from avatar.files import whole_file
from avatar.npz import read_npz
from avatar.rasterise import rasterise
from avatar.skeleton import skin_transforms
from avatar.skinning import skin_points
from train.align import AlignSettings, align, outline_offset
from train.capture import Capture, PartVideo, Subject, read_capture
from train.cells import distance_to
from train.check import MISALIGNED, outline_errors
from train.workers import Tell

Array = np.ndarray

ROUNDS = AlignSettings().rounds  # of each video
CHOICES = ("auto", "on", "off")
MASKS_OFF = 0.9  # pixels of an image 256 high: masks that are off by less are believed (clean ones: .1 to .5)
MEASURED_AGAIN = 2
UNSURE = 1.0  # pixels on both sides of a corrected mask's edge that supervise nothing


@dataclass(frozen=True)
class RefineJob:
    """What the refinement of one video is told; a worker process gets it whole."""

    capture: str
    part: str
    folder: str  # RUN.partial
    masks_off: float = 0.0  # how far outside of the true outline the masks are, pixels of an image 256 high


def refine_capture(
    capture: Capture, folder: Path, choice: str, say: Callable[[str], None],
    run: Callable[[Mapping[str, RefineJob], Callable[[RefineJob, Tell], dict]], dict[str, dict]],
) -> dict[str, Any]:  # fmt: skip
    """Write refined_PART.npz of every part into `folder` where poses or masks are off; returns what was found.

    `choice`: off measures nothing, on refines all poses, auto those whose outlines miss the masks'. `run` does the
    jobs, several at a time. Files that are there (a training that goes on) are kept.
    """
    if choice == "off":
        return {}
    done = folder / "refined.json"
    if done.exists():
        return json.loads(done.read_text("utf-8"))
    posed = {part: video for part, video in capture.videos.items() if video.axis_angle is not None}
    # masks first: poses that are moved onto small masks step back, and hide a part of what is missing
    offsets = mask_offsets(posed, capture.subject)
    believed = believed_offset(offsets)
    errors = outline_errors(capture) if choice == "auto" else {}
    wanted = [part for part in posed if choice == "on" or errors[part] > MISALIGNED]
    if wanted and errors:
        off = ", ".join(f"{part} {errors[part]:.1f} px" for part in wanted)
        say(f"outlines miss the masks ({off}): poses refined first; --refine-poses off leaves them alone")
    jobs = {part: RefineJob(str(capture.path), part, str(folder), believed) for part in wanted}
    facts: dict[str, Any] = dict(run(jobs, refine_part))
    masks_off = believed_offset(offsets | {part: facts[part]["masks_off_px"] for part in facts})
    if masks_off:
        word = "large" if masks_off > 0 else "small"
        say(f"masks are {abs(masks_off):.1f} px too {word}: corrected, pixels near their edge supervise nothing")
    if wanted or masks_off:
        facts["masks_off_px"] = round(masks_off, 3)
        for part in capture.videos:
            _correct_masks(capture, part, refined_path(folder, part), masks_off)
    with whole_file(done, "w") as file:
        json.dump(facts, file)
    return facts


def mask_offsets(videos: Mapping[str, PartVideo], subject: Subject) -> dict[str, float]:
    """How far each posed video's masks are outside of the template, pixels of an image 256 high.

    The nearest pixel of an outline is nearer than the one across (four fifths, of 2 pixels): masks that are off are
    corrected by what was found and measured again.
    """
    offsets = {part: outline_offset(video, subject) for part, video in videos.items()}
    for _ in range(MEASURED_AGAIN if believed_offset(offsets) else 0):
        middle = believed_offset(offsets)
        offsets = {part: middle + outline_offset(corrected(video, middle), subject) for part, video in videos.items()}
    return offsets


def corrected(video: PartVideo, masks_off: float) -> PartVideo:
    """The video with masks that are so far outside (pixels of an image 256 high) shrunk, or grown if negative."""
    if not masks_off:
        return video
    return replace(video, masks=regrown(video.masks, -masks_off * video.masks.shape[1] / 256))


def believed_offset(offsets: Mapping[str, float]) -> float:
    """How far all masks are off, pixels of an image 256 high: the median over the posed videos, or 0 if small.

    Loose clothes are outside of the template too, but not on hands: two of three videos do not see them.
    """
    middle = float(np.median(list(offsets.values())))
    return middle if abs(middle) > MASKS_OFF else 0.0


def refine_part(job: RefineJob, tell: Tell) -> dict:
    """Align one video's poses with its masks and write them; returns what run.json says of it."""
    path = refined_path(Path(job.folder), job.part)
    capture = read_capture(job.capture)
    video, subject = corrected(capture.videos[job.part], job.masks_off), capture.subject
    assert video.axis_angle is not None and video.root is not None
    aligned = align(video, subject, AlignSettings(), lambda number, *_: tell.step(number + 1, "poses onto masks"))
    kept = frames_on_the_mask(aligned.edge)
    video = _with_poses(video, aligned.axis_angle[kept], aligned.root[kept], kept)
    facts = {
        "outline_px": round(float(np.median(aligned.edge)), 3),
        "frames_left_out": [int(f) for f in np.setdiff1d(np.arange(len(aligned.edge)), kept)],
        "masks_off_px": round(job.masks_off + outline_offset(video, subject), 3),
    }
    with whole_file(path.with_suffix(".poses")) as file:
        np.savez(file, axis_angle=aligned.axis_angle[kept], root=aligned.root[kept], frames=kept)
    tell.say(
        f"{job.part}: poses on the masks, outlines {facts['outline_px']:.2f} px apart, "
        f"{len(facts['frames_left_out'])} frames left out"
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
    videos = dict(capture.videos)
    for part, video in capture.videos.items():
        path = refined_path(folder, part)
        if path.exists():
            videos[part] = read_refined(path, video)
    return replace(capture, videos=videos)


def read_refined(path: Path, video: PartVideo) -> PartVideo:
    """A video with the refined poses and masks of a file.

    Raises:
        AssetError: the file is broken, or of another video.
    """
    fields = read_npz(path, "refined poses", ("frames", "masks_off"))
    kept, masks_off = fields["frames"], fields["masks_off"]
    if kept.ndim != 1 or kept.dtype.kind != "i" or len(kept) == 0 or masks_off.shape != ():
        raise AssetError(f"{path}: expected frames (k,) and one masks_off, found {kept.shape}, {masks_off.shape}")
    if kept.min() < 0 or kept.max() >= len(video.images):
        raise AssetError(f"{path}: frames should be of the video's {len(video.images)}")
    axis_angle, root = video.axis_angle, video.root
    if axis_angle is not None and root is not None:
        axis_angle, root = fields.get("axis_angle", axis_angle[kept]), fields.get("root", root[kept])
        if axis_angle.shape != (len(kept), 52, 3) or root.shape != (len(kept), 3):
            raise AssetError(f"{path}: axis_angle and root should be of {len(kept)} frames, are {axis_angle.shape}, {root.shape}")  # fmt: skip
    video = _with_poses(video, axis_angle, root, kept)
    if masks_off == 0:
        return video
    count = video.masks.size
    packed = fields.get("unsure")
    if packed is None or packed.dtype != np.uint8 or len(packed) != -(-count // 8):
        raise AssetError(f"{path}: unsure should be {count} bits")
    unsure = np.unpackbits(packed, count=count).astype(bool).reshape(video.masks.shape)
    return replace(video, masks=regrown(video.masks, -float(masks_off)), unsure=unsure)


def _with_poses(video: PartVideo, axis_angle: Array | None, root: Array | None, kept: Int[Array, "k"]) -> PartVideo:
    """The frames `kept` of a video, in these poses."""
    return replace(
        video, images=video.images[kept], masks=video.masks[kept], cameras=tuple(video.cameras[f] for f in kept),
        axis_angle=axis_angle, root=root,
    )  # fmt: skip


def _correct_masks(capture: Capture, part: str, path: Path, masks_off: float) -> None:
    """Write refined_PART.npz: the poses found before, if any, and what to do with the masks."""
    video = capture.videos[part]
    found = path.with_suffix(".poses")
    fields: dict[str, Array] = {"frames": np.arange(len(video.images))}
    if found.exists():
        fields = read_npz(found, "refined poses", ("frames", "axis_angle", "root"))
    pixels = masks_off * video.masks.shape[1] / 256
    fields["masks_off"] = np.array(pixels)
    if pixels:
        kept = fields["frames"]
        poses = (None, None) if video.axis_angle is None or video.root is None else (
            fields.get("axis_angle", video.axis_angle), fields.get("root", video.root))  # fmt: skip
        video = _with_poses(video, *poses, kept)
        fields["unsure"] = np.packbits(unsure_pixels(video, capture.subject, pixels))
    with whole_file(path) as file:
        np.savez_compressed(file, allow_pickle=False, **fields)
    found.unlink(missing_ok=True)


def unsure_pixels(video: PartVideo, subject: Subject, masks_off: float) -> Bool[Array, "frames h w"]:
    """Pixels that may show the person or not: near the corrected edge, and where only the template sees a limb.

    An eroded mask has lost what is thinner than it was eroded by, and growing does not bring it back.
    """
    unsure = np.abs(signed_pixels(video.masks) + masks_off) < UNSURE
    if video.axis_angle is None or video.root is None or masks_off > 0:
        return unsure
    grown = regrown(video.masks, -masks_off)
    for f, camera in enumerate(video.cameras):
        B = skin_transforms(video.axis_angle[f], subject.joints, video.root[f])
        drawn = rasterise(skin_points(subject.vertices, subject.skin, B), subject.faces, camera)
        unsure[f] |= (drawn.face >= 0) & ~grown[f]
    return unsure


def signed_pixels(masks: Bool[Array, "frames h w"]) -> Float[Array, "frames h w"]:
    """Distance of every pixel centre to the mask's edge, negative inside; the edge runs between two pixels."""
    out = np.empty(masks.shape)
    for f, mask in enumerate(masks):
        if mask.all() or not mask.any():
            out[f] = -np.inf if mask.all() else np.inf
            continue
        out[f] = np.where(mask, 0.5 - distance_to(~mask), distance_to(mask) - 0.5)
    return out


def regrown(masks: Bool[Array, "frames h w"], pixels: float) -> Bool[Array, "frames h w"]:
    """Masks grown by so many pixels, shrunk if negative."""
    return signed_pixels(masks) < pixels
