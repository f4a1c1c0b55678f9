"""The four videos of a person as files: which is which, their keypoints, and what is to be said of each."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from avatar.skeleton import PARTS
from capture.keypoints.read import read_keypoints
from capture.keypoints.record import Keypoints
from capture.raw.glance import Glance, glance
from capture.raw.judge import Judged, judge
from capture.raw.video_file import VideoFile, open_video
from command.errors import AssetError
from command.progress import Progress
from files.npz import read_npz
from files.whole import whole_file

# what files and folders of a part may be called
NAMES = {
    "body": ("body",), "head": ("head",), "hand_left": ("hand_left", "left"), "hand_right": ("hand_right", "right"),
}  # fmt: skip
ENDINGS = (".mp4", ".mov", ".m4v", ".mkv", ".webm")
KEYPOINTS = "keypoints (OpenPose, COCO-WholeBody, MediaPipe) of body, head, hand_left and hand_right"


def find_videos(paths: Sequence[Path]) -> dict[str, Path]:
    """The videos by part: four files in the order body, head, left, right, or a folder that holds them.

    Raises:
        AssetError: three files, or a folder in which one is missing.
    """
    if len(paths) == len(PARTS):
        return dict(zip(PARTS, paths, strict=True))
    if len(paths) > 1:
        found = ", ".join(map(str, paths))
        raise AssetError(f"expected four videos, BODY HEAD LEFT RIGHT, found {len(paths)}: {found}")
    (folder,) = paths
    out = {}
    for part in PARTS:
        places = [folder / (name + ending) for name in NAMES[part] for ending in ENDINGS]
        out[part] = next((path for path in places if path.is_file()), None)
    absent = [NAMES[part][-1] for part, path in out.items() if path is None]
    if absent:
        raise AssetError(f"{folder}: expected body.mp4, head.mp4, left.mp4 and right.mp4, found no {', '.join(absent)}")
    return out


def holds_videos(folder: Path) -> bool:
    """Whether a folder has a video of any part in it, and is no capture folder."""
    names = [name + ending for part in PARTS for name in NAMES[part] for ending in ENDINGS]
    return not (folder / "capture.json").exists() and any((folder / name).is_file() for name in names)


def part_keypoints(folder: Path, part: str, video: VideoFile) -> Keypoints:
    """The keypoints of one video out of a folder of four.

    Raises:
        AssetError: there are none, or they are of pictures of another size.
    """
    for name in NAMES[part]:
        for path in (folder / name, folder / f"{name}.json"):
            if path.exists():
                found = read_keypoints(path, size=video.size)
                if found.size is not None and found.size != video.size:
                    raise AssetError(f"{path}: keypoints of {found.size} pictures, {video.path} has {video.size}")
                return found
    raise AssetError(f"{folder / part}: expected {KEYPOINTS}, found nothing of {video.name}")


def examine_videos(paths: Sequence[Path], keypoints: Path | None) -> dict[str, Judged]:
    """Judge four videos; without `keypoints` those beside them, in a folder of that name, are taken.

    Raises:
        AssetError: a video or its keypoints cannot be read.
    """
    files = find_videos(paths)
    folder = files["body"].parent / "keypoints" if keypoints is None else keypoints
    videos = {part: open_video(path) for part, path in files.items()}
    if not folder.is_dir():
        raise AssetError(f"{folder}: expected {KEYPOINTS}; --keypoints DIR says where they are")
    return judge_videos(videos, {part: part_keypoints(folder, part, video) for part, video in videos.items()})


def judge_videos(
    videos: Mapping[str, VideoFile], keypoints: Mapping[str, Keypoints], work: Path | None = None
) -> dict[str, Judged]:
    """Look at every frame of the videos and judge them; with a folder, what was seen before is not looked at again."""
    report = Progress("looking", sum(len(found.pixels) for found in keypoints.values()))
    out, done = {}, 0
    for part, video in videos.items():
        out[part] = judge(_glance(video, part, keypoints[part], report, done, work))
        done += len(keypoints[part].pixels)
    return out


def _glance(
    video: VideoFile, part: str, keypoints: Keypoints, report: Progress, done: int, work: Path | None
) -> Glance:
    path = work / part / "glance.npz" if work else None
    if path is not None and path.exists():
        stored = read_npz(path, "what was seen of a video", ("times", "small", "sharpness"))
        return Glance(video, part, stored["times"], stored["small"], stored["sharpness"], keypoints)
    seen = glance(video, part, keypoints, report, done)
    if path is not None:
        with whole_file(path) as file:
            np.savez(file, times=seen.times, small=seen.small, sharpness=seen.sharpness)
    return seen
