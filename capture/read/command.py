"""`selfscan import`: real captures, read into capture folders."""

import argparse
import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from avatar.body import read_body
from capture.keypoints.detect import MODELS, detect, model_files
from capture.raw.video_file import open_video, read_frames
from capture.read.folder import MOST_FRAMES
from command.command_line import Help, Option, parse
from command.errors import AssetError
from command.progress import progress
from command.settings import Above, AtLeast, AtMost, OneOf
from files.whole import check_folder, exclusive_lock

Frames = Annotated[int, AtLeast(1), AtMost(1_000_000), "most frames of a video"]


@dataclass(frozen=True)
class TotalSelfScanCommand:
    source: Annotated[Path, Option(positional=True, metavar="SRC"), "the subject's folder"]
    out: Annotated[Path, Option(positional=True, metavar="OUT"), "capture folder to write"]
    frames: Annotated[
        int | None,
        AtLeast(1),
        AtMost(1_000_000),
        Option(metavar="N"),
        f"most frames of a video (default: the authors' where it is whole, else {MOST_FRAMES})",
    ] = None
    body: Annotated[
        Path | None, Option(metavar="MODEL"), "the SMPL+H model of the fits (.pkl, .npz), for its skin weights"
    ] = None


@dataclass(frozen=True)
class EasyMocapCommand:
    source: Annotated[Path, Option(positional=True, metavar="SRC"), "folder with body, head, hand_left, hand_right"]
    out: Annotated[Path, Option(positional=True, metavar="OUT"), "capture folder to write"]
    body: Annotated[Path, Option(metavar="MODEL"), "the SMPL+H model of the fits (.pkl, .npz)"]
    head: Annotated[Path, Option(metavar="COLMAP_DIR"), "COLMAP model of the head video"]
    landmarks: Annotated[Path, Option(metavar="FILE"), "JSON: named pixels of the head video"]
    masks: Annotated[Path, Option(metavar="DIR"), "folder with masks of the four videos"]
    frames: Frames = MOST_FRAMES


@dataclass(frozen=True)
class FilmOptions:
    """What is known of the films beside them, and how they are read."""

    keypoints: Annotated[
        str,
        Option(metavar="auto|DIR"),
        "folder with keypoints of body, head, hand_left and hand_right (docs/capture.md: detectors), for each "
        "frame of the video; auto: the folder keypoints beside the videos, else found by MediaPipe with --models, and "
        "kept in OUT.keypoints",
    ] = "auto"
    masks: Annotated[
        str, Option(metavar="auto|DIR"), "folder with masks of the videos, one for each frame; auto: from the videos"
    ] = "auto"
    models: Annotated[
        Path | None,
        Option(metavar="DIR"),
        f"MediaPipe's model files, for --keypoints auto: {', '.join(MODELS.values())}",
    ] = None
    sex: Annotated[str, OneOf(("male", "female")), "the free body that the fit begins with"] = "male"
    stature: Annotated[
        float | None,
        AtLeast(0.8),
        AtMost(2.5),
        Option(metavar="METRES"),
        "your height as filmed, in shoes if you wore them; all lengths follow from it",
    ] = None
    focal: Annotated[
        float | None, Above(0), Option(metavar="PX"), "focal length of the phone, pixels of the videos (default: found)"
    ] = None
    frames: Annotated[int, AtLeast(8), AtMost(1000), "most frames of a video that are used"] = 60

    def check(self) -> None:
        """Refuse folders that are named and absent, before the work begins: `AssetError`."""
        for option in ("keypoints", "masks", "models"):
            folder = getattr(self, option)
            if folder not in (None, "auto") and not Path(folder).is_dir():
                raise AssetError(f"--{option} {folder}: expected a folder, found none")


@dataclass(frozen=True)
class VideoCommand:
    videos: Annotated[
        tuple[Path, ...],
        Option(positional=True, metavar="BODY HEAD LEFT RIGHT", several=True),
        "the four videos, the body's alone, or a folder with body.mp4 and any of head.mp4, left.mp4 and right.mp4; and "
        "face.mp4, where you say ah, smile, move brows and blink",
    ]
    out: Annotated[Path, Option(("-o", "--out"), "OUT"), "capture folder to write"]
    reading: Annotated[FilmOptions, "how the films are read"]


KINDS = """usage: selfscan import KIND ...

Turn real self-scan videos, with the poses, masks and cameras that other tools made of them, into a capture folder.
docs/capture.md says how to film and which tools to run.

  video BODY HEAD LEFT RIGHT -o OUT   your own four videos as filmed: nothing else is needed but keypoints
  totalselfscan SRC OUT   one subject of the paper's released data
  easymocap SRC OUT       your own videos, fitted with EasyMocap

`selfscan import KIND --help` explains each; then: selfscan check OUT && selfscan train OUT -o RUN
"""
FILMED = Help(
    "selfscan import video",
    """Videos of one person, as filmed, to a capture folder: frames are chosen, the person is cut from the room, body,
hands, head and cameras are fitted. Head and hands without a film are cut from the body's, as sharp as they are there.
Look at the videos first with `selfscan check`. Stopped, it goes on with the frames and masks that it has.""",
    "example: selfscan import video me/body.mp4 me/head.mp4 me/left.mp4 me/right.mp4 --stature 1.78 -o capture",
)
RELEASED = Help(
    "selfscan import totalselfscan",
    """One subject of the data that TotalSelfScan's authors released: annots.npy, params, lbs, face, hand/handl,
hand/handr.""",
)
OWN = Help(
    "selfscan import easymocap",
    """Your own four videos: SMPL+H fits of body and hands by EasyMocap, head cameras by COLMAP, landmarks that you
marked, masks. Folders: docs/capture.md.""",
)


def _detect(folder: Path, files: dict[str, Path], models: dict[str, Path]) -> None:
    """Keypoints of videos by MediaPipe, a file each, as old as its video: those that are there are not found again."""
    videos = {part: open_video(path) for part, path in files.items()}
    folder.mkdir(exist_ok=True)
    for part, video in videos.items():
        path = folder / f"{part}.json"
        filmed = video.path.stat().st_mtime_ns
        if not path.exists() or path.stat().st_mtime_ns != filmed:
            frames = ((frame.time, frame.picture) for frame in read_frames(video))
            detect(path, progress(frames, f"keypoints of {video.name}", video.frames), models)
            os.utime(path, ns=(filmed, filmed))


def _import_video(command: VideoCommand) -> list[str]:
    from capture.fit.scan import fit_scan
    from capture.raw.four_videos import FACE_FILM, KEYPOINTS, face_film, find_videos
    from capture.read.video import VideoImport, import_video

    reading = command.reading
    files, face = find_videos(command.videos), face_film(command.videos)
    beside = files["body"].parent / "keypoints"
    if reading.keypoints != "auto":
        keypoints = Path(reading.keypoints)
    elif beside.is_dir():
        keypoints = beside
    else:
        try:
            models = model_files(reading.models)
        except AssetError as error:
            raise AssetError(f"{beside}: expected {KEYPOINTS}, found no such folder; {error}; "
                             "`selfscan make` lets you click them") from None  # fmt: skip
        keypoints = command.out.with_name(command.out.name + ".keypoints")
        _detect(keypoints, files | ({FACE_FILM: face} if face else {}), models)
    masks = None if reading.masks == "auto" else Path(reading.masks)
    given = VideoImport(files, keypoints, masks, reading.frames, reading.focal, face)
    return import_video(given, command.out, lambda scan: fit_scan(scan, sex=reading.sex, stature=reading.stature))


def main(argv: Sequence[str]) -> int:
    """The command line; see `selfscan import --help`."""
    kind, rest = (argv[0], argv[1:]) if argv else ("", ())
    if kind in ("-h", "--help"):
        print(KINDS, end="")
        return 0
    if kind == "totalselfscan":
        command = parse(TotalSelfScanCommand, rest, RELEASED)
        from capture.read.totalselfscan import import_totalselfscan

        check_folder(command.out, command.source)
        body = read_body(command.body) if command.body else None
        notes = import_totalselfscan(command.source, command.out, body=body, most=command.frames)
    elif kind == "easymocap":
        command = parse(EasyMocapCommand, rest, OWN)
        from capture.read.easymocap import import_easymocap

        check_folder(command.out, command.source, command.masks)
        notes = import_easymocap(
            command.source, command.out, body=read_body(command.body), head=command.head, landmarks=command.landmarks,
            masks=command.masks, most=command.frames,
        )  # fmt: skip
    elif kind == "video":
        command = parse(VideoCommand, rest, FILMED)
        command.reading.check()
        check_folder(command.out, *command.videos)
        with exclusive_lock(command.out):
            notes = _import_video(command)
    else:
        parser = argparse.ArgumentParser(prog="selfscan import", usage=argparse.SUPPRESS)
        parser.error(f"KIND: expected video, totalselfscan or easymocap, found {kind or 'nothing'}; see --help")
    for note in notes:
        print(note)
    print(f"{command.out}: imported; `selfscan check {shlex.quote(str(command.out))}` says whether it can be used")
    return 0
