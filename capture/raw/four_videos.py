"""The videos of a person as files: which is which, their keypoints, and what is to be said of each."""

import filecmp
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from avatar.skeleton import PARTS
from capture.keypoints.orders import described
from capture.keypoints.read import WHAT, read_keypoints
from capture.keypoints.record import Keypoints
from capture.raw.glance import Glance, glance
from capture.raw.judge import Judged, judge
from capture.raw.masks import masked_by
from capture.raw.video_file import VideoFile, open_video
from command.errors import AssetError
from command.progress import Progress
from files.npz import read_npz
from files.whole import whole_file

# what files and folders of a part may be called
NAMES = {
    "body": ("body",), "head": ("head",), "hand_left": ("hand_left", "left"), "hand_right": ("hand_right", "right"),
}  # fmt: skip
# the same of the film of a face, which is no part's
FACE_FILM = "face"
# a part's height over that of the box round a person's keypoints
SHARES = {"head": 0.14, "hand_left": 0.11, "hand_right": 0.11}
ENDINGS = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi")
# fields of what was seen of a video that are kept
SEEN = ("times", "small", "sharpness")
KEYPOINTS = f"{WHAT} of body, head, hand_left and hand_right"


def films_in(folder: Path) -> list[Path]:
    """The films in a folder; phones write .MOV."""
    films = [path for path in folder.iterdir() if path.suffix.lower() in ENDINGS and path.is_file()]
    return sorted(films, key=lambda path: (ENDINGS.index(path.suffix.lower()), path.name))


def named_parts(films: Sequence[Path]) -> dict[str, Path]:
    """Films by the part that their name says, in the order of PARTS; the first of a part."""
    found = {name: path for path in reversed(films) for name, names in NAMES.items() if path.stem.lower() in names}
    return {part: found[part] for part in PARTS if part in found}


def face_film(paths: Sequence[Path]) -> Path | None:
    """The film of a face among films, or in their folder; None: there is none."""
    films = films_in(paths[0]) if len(paths) == 1 and paths[0].is_dir() else paths
    return next((path for path in films if path.stem.lower() == FACE_FILM), None)


def find_videos(paths: Sequence[Path]) -> dict[str, Path]:
    """The videos by part: files that are called so, the body's among them; of other names the body's alone, or four in
    the order body, head, left, right; or a folder that holds the body's and any of the others, or one film alone. A
    film of a face is left out.

    Raises:
        AssetError: nothing is there, the body's is missing, a name says no part, or two files are one film.
    """
    for path in paths:
        if not path.exists():
            raise AssetError(f"{path}: expected a film, or a folder of them, found nothing")
    face = face_film(paths)
    if len(paths) == 1 and paths[0].is_dir():
        films = [film for film in films_in(paths[0]) if film != face]
        out = {PARTS[0]: films[0]} if len(films) == 1 and not named_parts(films) else named_parts(films)
        if "body" not in out:
            raise AssetError(f"{paths[0]}: expected body.mp4, and head.mp4, left.mp4, right.mp4 as far as "
                             f"filmed, found {', '.join(p.name for p in films) or 'no film'}")  # fmt: skip
    else:
        films = [path for path in paths if path != face]
        out = named_parts(films)
        if len(out) < len(films) and len(films) in (1, len(PARTS)):
            out = {str(part): path for part, path in zip(PARTS, films)}
        if "body" not in out or len(out) < len(films):
            found = ", ".join(path.name for path in paths)
            raise AssetError(f"expected BODY HEAD LEFT RIGHT, or files called body, head, left, right; found {found}")
    every = list(out.values()) if face is None else [*out.values(), face]
    for a, b in combinations(every, 2):
        if a.is_file() and b.is_file() and filecmp.cmp(a, b, shallow=False):
            raise AssetError(f"{b}: is the same film as {a}; leave it out: what is missing is cut from the body's")
    return out


def found_lines(videos: Mapping[str, Judged], masks: str | None = None) -> list[str]:
    """What keypoints are there of each video, and what its masks are made by (None: `masked_by`)."""
    seen = {at.glance.video.name: (at.empty, at.glance.keypoints) for at in videos.values()}
    return [f"{name}: keypoints: {described(points)}; masks: {masks or masked_by(empty)}"
            for name, (empty, points) in seen.items()]  # fmt: skip


def unfilmed_lines(videos: Mapping[str, Judged]) -> list[str]:
    """What the body's film gives for each part without one."""
    at = videos["body"].glance
    tall = float(np.nanmedian(at.boxes[:, 3] - at.boxes[:, 1]))
    return [
        f"{part}: no film of its own; {at.video.name} shows it about {share * tall:.0f} pixels high, 200 are wanted"
        for part, share in SHARES.items() if part not in videos
    ]  # fmt: skip


def holds_videos(folder: Path) -> bool:
    """Whether this is a file, which no capture is, or a folder that has a video in it and is no capture folder."""
    return folder.is_file() or (folder.is_dir() and not (folder / "capture.json").exists() and bool(films_in(folder)))


def all_keypoints(folder: Path, videos: Mapping[str, VideoFile]) -> dict[str, Keypoints]:
    """The keypoints of each video out of a folder; where orders are told by bone lengths the body's, which come first,
    hold for all. Errors: `part_keypoints`."""
    out: dict[str, Keypoints] = {}
    for part in sorted(videos, key=PARTS.index):
        out[part] = part_keypoints(folder, part, videos[part], out["body"].order if "body" in out else "")
    return out


def part_keypoints(folder: Path, part: str, video: VideoFile, like: str = "") -> Keypoints:
    """The keypoints of one video out of a folder of four, whose other films have their points in the order `like`.

    Raises:
        AssetError: there are none, or they are of pictures of another size.
    """
    for name in NAMES.get(part, (part,)):
        for path in (folder / name, folder / f"{name}.json"):
            if path.exists():
                found = read_keypoints(path, size=video.size, frames=video.frames, like=like)
                if found.size is not None and found.size != video.size:
                    raise AssetError(f"{path}: keypoints of {found.size} pictures, {video.path} has {video.size}")
                return found
    raise AssetError(f"{folder / part}: expected {KEYPOINTS}, found nothing of {video.name}")


def examine_videos(paths: Sequence[Path], keypoints: Path | None) -> dict[str, Judged]:
    """Judge videos; without `keypoints` those beside them, in a folder of that name, are taken.

    Raises:
        AssetError: a video or its keypoints cannot be read.
    """
    files = find_videos(paths)
    folder = files["body"].parent / "keypoints" if keypoints is None else keypoints
    videos = {part: open_video(path) for part, path in files.items()}
    if not folder.is_dir():
        raise AssetError(f"{folder}: expected {KEYPOINTS}; --keypoints DIR says where they are")
    return judge_videos(videos, all_keypoints(folder, videos))


def judge_videos(
    videos: Mapping[str, VideoFile], keypoints: Mapping[str, Keypoints], work: Path | None = None
) -> dict[str, Judged]:
    """Look at every frame of the videos and judge them; with a folder, what was seen before is not looked at again."""
    report = Progress("looking", sum(len(found.pixels) for found in keypoints.values()))
    out, done = {}, 0
    for part, video in videos.items():
        points, path = keypoints[part], work / part / "glance.npz" if work else None
        if path is not None and path.exists():
            seen = Glance(video, part, **read_npz(path, "what was seen of a video", SEEN), keypoints=points)
        else:
            seen = glance(video, part, points, report, done)
            if path is not None:
                with whole_file(path) as file:
                    np.savez(file, **{name: getattr(seen, name) for name in SEEN})
        out[part] = judge(seen)
        done += len(points.pixels)
    return out
