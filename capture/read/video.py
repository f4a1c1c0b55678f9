"""Videos as filmed become a capture folder: frames chosen, person masked, body fitted, all of it in one command.

Frames and masks lie in OUT.partial until the capture is whole: the same command goes on with them.
"""

import json
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from avatar.motion.clip import spread_frames
from avatar.skeleton import PARTS
from capture.frame_files import sized_picture, write_picture
from capture.keypoints.record import Keypoints
from capture.own_face import OwnFace
from capture.raw.four_videos import NAMES, all_keypoints, found_lines, judge_videos
from capture.raw.glance import Glance
from capture.raw.judge import Judged, refusal
from capture.raw.masks import soft_mask
from capture.raw.plate import plate_of_empty, plate_of_free
from capture.raw.scan import FittedScan, RawScan, RawVideo
from capture.raw.selection import KeptFrames, select
from capture.raw.video_file import open_video, read_frames
from capture.read.close_up import PartMasks
from capture.read.face_film import open_face_film, own_face
from capture.read.folder import SourceVideo, pictures_in, write_capture
from capture.read.from_body import cut_close_up
from command.errors import AssetError
from command.progress import ProgressBoard, Reporter
from command.workers import run_jobs
from files.input_file import read_json
from files.picture import read_picture
from files.whole import check_folder, is_free, whole_file

# most frames whose points alone are used, and seconds from one to the next: a detector's errors last about as long
TRACK, APART = 120, 0.1
# what was filmed, to the person
Fit = Callable[[RawScan], FittedScan]


@dataclass(frozen=True)
class VideoImport:
    videos: Mapping[str, Path]  # by part
    keypoints: Path
    # None: made from the videos
    masks: Path | None = None
    frames: int = 60  # most of each video
    focal: float | None = None  # pixels; None: solved
    face: Path | None = None  # film of a face


def import_video(given: VideoImport, out: Path, fit: Fit) -> list[str]:
    """Write the capture folder `out`; returns what is worth saying.

    Raises:
        AssetError: a video cannot be used (one line says why and what to do), or keypoints or masks are not its own.
    """
    check_folder(out)
    videos = {part: open_video(path) for part, path in given.videos.items()}
    keypoints = all_keypoints(given.keypoints, videos)
    face = None if given.face is None else open_face_film(given.face, given.keypoints, keypoints["body"].order)
    work = _work_folder(out, given)
    judged = judge_videos(videos, keypoints, work)
    why = refusal(judged)
    if why is not None:
        # others will be filmed: nothing of these is worth keeping
        shutil.rmtree(work)
        raise AssetError(why)
    notes = [problem.line(videos[part].name) for part, at in judged.items() for problem in at.problems]
    chosen = {part: select(at, given.frames) for part, at in judged.items()}
    notes += [kept.line(videos[part].name) for part, kept in chosen.items()]
    notes += found_lines(judged, "given" if given.masks else None)
    jobs = {part: _Chosen(given, judged[part], kept, work / part) for part, kept in chosen.items()}
    workers = min(os.cpu_count() or 1, len(jobs))
    board = ProgressBoard({part: len(kept.frames) for part, kept in chosen.items()}, workers)
    scan = RawScan(run_jobs(jobs, _prepared, board, workers))
    fitted = fit(scan)
    own = None
    if face is not None:
        own, said = own_face(face, fitted.template.vertices, fitted.focal)
        notes += said
    _write(out, scan, fitted, work, given, notes, own)
    shutil.rmtree(work)
    return [*notes, *fitted.notes]


def _work_folder(out: Path, given: VideoImport) -> Path:
    """OUT.partial, emptied if it belongs to other input."""
    work = out.with_name(out.name + ".partial")
    named = [*given.videos.values(), given.keypoints, *(path for path in (given.masks, given.face) if path)]
    # a folder's time says nothing of what is written over in it
    files = [*named, *sorted(path for path in given.keypoints.rglob("*") if path.is_file())]
    stamp = {
        "files": [[str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns] for path in files],
        "frames": given.frames,
    }
    mark = work / "inputs.json"
    if mark.exists() and read_json(mark, "what an unfinished import was made of") != stamp:
        shutil.rmtree(work)
    elif not is_free(work) and not mark.exists():
        raise AssetError(f"{work}: is in the way, and not an unfinished import; remove or rename it")
    if mark.exists():
        print(f"{work}: goes on with what is done")
    work.mkdir(exist_ok=True)
    with whole_file(mark, "w") as file:
        json.dump(stamp, file)
    for part in PARTS:
        (work / part).mkdir(exist_ok=True)
    return work


class _Chosen(NamedTuple):
    """What is taken of one video, for a worker process."""

    given: VideoImport
    judged: Judged
    kept: KeptFrames
    work: Path


def _prepared(job: _Chosen, report: Reporter) -> RawVideo:
    given, judged, chosen, work = job
    at = judged.glance
    images, masks = work / "images", work / "masks"
    images.mkdir(exist_ok=True)
    masks.mkdir(exist_ok=True)
    pictures = [images / f"{i:06d}.png" for i in range(len(chosen.frames))]
    if not (work / "images.done").exists():
        wanted = frozenset(int(number) for number in chosen.frames)
        for i, frame in enumerate(read_frames(at.video, only=wanted)):
            write_picture(pictures[i], frame.picture)
        (work / "images.done").touch()
    keypoints = at.keypoints.of_frames(chosen.frames)
    paths = [masks / f"{i:06d}.png" for i in range(len(chosen.frames))]
    if given.masks is not None:
        _given_masks(given.masks, at, chosen, paths)
    else:
        _own_masks(judged, pictures, keypoints, paths, report)
    soft = np.stack([read_picture(path, "L") for path in paths])
    many = max(given.frames, min(TRACK, round(float(at.times[-1]) / APART)))
    track = at.keypoints.of_frames(select(judged, many).frames)
    return RawVideo(at.part, at.video.size, at.video.rate, chosen.frames, tuple(pictures), soft, keypoints, given.focal,
                    at.video.focal, track)  # fmt: skip


def _own_masks(judged: Judged, pictures: list[Path], keypoints: Keypoints, paths: list[Path], report: Reporter) -> None:
    missing = [i for i, path in enumerate(paths) if not path.exists()]
    if not missing:
        return
    at = judged.glance
    if judged.empty.any():
        plate = plate_of_empty(at.video, np.flatnonzero(judged.empty))
    else:
        spread = spread_frames(len(pictures), 30)
        plate = plate_of_free([read_picture(pictures[i]) for i in spread], keypoints.of_frames(spread))
    for i in missing:
        report.step(i, "masks")
        write_picture(paths[i], soft_mask(read_picture(pictures[i]), plate, keypoints, i))


def _given_masks(folder: Path, at: Glance, chosen: KeptFrames, paths: list[Path]) -> None:
    """Masks of another tool: one for each frame of the video, in order."""
    place = next((folder / name for name in NAMES[at.part] if (folder / name).is_dir()), folder / at.part)
    files = pictures_in(place)
    if len(files) != len(at.times):
        raise AssetError(
            f"{place}: expected a mask for each of {len(at.times)} frames of {at.video.name}, found {len(files)}"
        )
    for number, path in zip(chosen.frames, paths, strict=True):
        mask = _grey(files[number], at.video.size)
        if mask.max(initial=0) <= 1:
            mask = 255 * mask
        if not mask.any():
            raise AssetError(f"{files[number]}: mask shows no person in frame {number} of {at.video.name}")
        write_picture(path, mask)


def _grey(path: Path, size: tuple[int, int]) -> np.ndarray:
    """A mask, 0 to 255 or 0 and 1; AssetError where it has colors or small numbers, which are labels of parts."""
    stored = sized_picture(path, size, "as the video")
    # a JPEG's greys may differ a little
    if np.ptp(stored, axis=-1).max() > 8 or 1 < stored.max() < 128:
        raise AssetError(f"{path}: mask should be 255 where the person is and 0 elsewhere, is a picture of labels")
    return stored[..., 0]


def _write(
    out: Path, scan: RawScan, fitted: FittedScan, work: Path, given: VideoImport, notes: list[str], own: OwnFace | None
) -> None:
    videos, numbers = {}, {}
    for part in PARTS:
        film = given.videos.get(part, given.videos["body"])
        if part in scan.videos:
            raw, fit = scan.videos[part], fitted.videos[part]
        else:
            raw, fit = cut_close_up(part, scan.videos["body"], fitted, work / part)
            width, height = raw.size
            notes = [*notes, f"{part}: not filmed alone, {len(raw.frames)} pictures of {width} x {height} pixels cut "
                     f"from {film.name}; a film of its own makes it sharper"]  # fmt: skip
        numbers[part] = [int(n) for n in raw.frames[fit.usable]]
        kept = np.flatnonzero(fit.usable)
        if len(kept) < 4:
            raise AssetError(f"{film}: the person could be fitted in {len(kept)} of {len(raw.frames)} frames")
        masks = work / part / "masks"
        if part != "body":
            # without the rest of the person, beside the masks that the fit was given
            close_up, masks = PartMasks(fitted.template, part, fitted.landmarks), work / part / "own_masks"
            masks.mkdir(exist_ok=True)
            for i, camera in enumerate(fit.cameras):
                mask = read_picture(work / part / "masks" / f"{i:06d}.png", "L")
                write_picture(masks / f"{i:06d}.png", close_up.mask(mask, camera, fit, i))
        pick = lambda values: None if values is None else values[kept]
        videos[part] = SourceVideo(
            tuple(raw.pictures[i] for i in kept),
            tuple(masks / f"{i:06d}.png" for i in kept),
            any_value=False, soft=True, cameras=tuple(fit.cameras[i] for i in kept),
            axis_angle=pick(fit.axis_angle), root=pick(fit.root), place=str(film), trunk=pick(fit.trunk),
        )  # fmt: skip
    landmarks = {
        "points": {name: [float(x) for x in point] for name, (point, _) in fitted.landmarks.items()},
        "vertices": {name: int(vertex) for name, (_, vertex) in fitted.landmarks.items()},
    }
    facts = {
        "subject": out.name, "source": "video", "input": "from_pixels", "body_licence": fitted.template.licence,
        "filmed": list(scan.videos), "frame_numbers": numbers,
        "notes": [*notes, *fitted.notes],
    }  # fmt: skip
    write_capture(out, fitted.template, videos, landmarks, facts, own)
