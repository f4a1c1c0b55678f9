"""Poses of the person's own videos, estimated from all frames together, beside the truth of the same frames.

A single held-out picture leaves the depth of limbs open (fitted_poses.py): the true skeleton's limb joints end 3.5 cm
from the truth there, and distances hold that. The whole person and the head are measured in frames of the body's video,
a hand in frames of its own, in the world of that video's camera: where a camera or a focal length was estimated, its
error counts in place. Head cameras of a capture stand in a frame of their own, so the head's video places nothing.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from avatar.camera import Camera
from avatar.skeleton import PARTS
from bench.score.fitted_poses import in_world
from bench.score.pose_distances import Placement
from capture.fit.refine import kept_frames, with_refined
from capture.folder import PartVideo, read_capture
from capture.held_out import HeldOutView, read_arrays
from command.errors import AssetError
from train.session import capture_digest

# spread over each video
FRAMES = {"body": 8, "hand_left": 4, "hand_right": 4}
REGIONS = {"body": ("total", "skin_beside_hair", "head"), "hand_left": ("left_hand",), "hand_right": ("right_hand",)}


class FilmedPoses(NamedTuple):
    """Placements by part, a whole video each; none, and the reason, where videos or their truth are not at hand."""

    by_part: dict[str, list[Placement]]
    reason: str = ""
    # frames of each video whose surfaces are measured in a quick look; None: FRAMES
    most: int | None = None

    def some(self) -> dict[str, list[Placement]]:
        """FRAMES of each video, or `most`: surfaces are slow to measure."""
        few = {}
        for part, found in self.by_part.items():
            count = min(FRAMES[part], self.most or FRAMES[part])
            few[part] = [found[i] for i in np.unique(np.linspace(0, len(found), count, endpoint=False).astype(int))]
        return few


def filmed_poses(run: Path | None, facts: Mapping[str, object], scan: Path, most: int | None = None) -> FilmedPoses:
    """Frames of the videos that `run` was trained on, whose run.json holds `facts`; `scan` is the folder of the raw
    videos where the capture was imported from such.

    Raises:
        AssetError: a file is broken, or frames are not of those videos.
    """
    if run is None:
        return FilmedPoses({}, "the avatar file holds no videos; give --run")
    said = facts.get("capture_at")
    if not isinstance(said, dict) or not isinstance(said.get("folder"), str):
        return FilmedPoses({}, "run.json does not say where the run's capture lies")
    folder = run / said["folder"]
    if not (folder / "capture.json").is_file() or capture_digest(folder) != said.get("digest"):
        return FilmedPoses({}, f"the capture that the run was trained on is not at {folder}")
    capture_facts = read_capture(folder, parts=()).facts
    numbers, films = capture_facts.get("frame_numbers"), capture_facts.get("filmed", PARTS)
    filmed = folder if numbers is None else scan
    if not (filmed / "truth" / "body" / "video.npz").is_file():
        return FilmedPoses({}, f"no truth of the videos' frames: {filmed / 'truth/body/video.npz'} is absent")

    found = {}
    for part in REGIONS:
        capture = read_capture(folder, parts=(part,), frames_on_demand=True)
        rows = np.arange(len(capture.videos[part].images)) if numbers is None else np.array(numbers[part], np.int64)
        kept = kept_frames(run, part)
        video = with_refined(capture, run).videos[part]
        # what was not filmed alone is of the body's video
        film = filmed / "truth" / (part if part in films else "body")
        found[part] = _placements(film, video, rows if kept is None else rows[kept])
    return FilmedPoses(found, most=most)


def _placements(film: Path, video: PartVideo, rows: Int[np.ndarray, "frames"]) -> list[Placement]:
    """The frames of a video; `rows` are their numbers in the truth of the film that they were taken from."""
    path = film / "video.npz"
    shapes = {"poses": ("n", 52, 3), "root": ("n", 3), "K": (3, 3), "camera_from_world": (4, 4), "size": (2,)}
    true = read_arrays(path, shapes)
    if len(rows) != len(video.cameras) or rows.max() >= len(true["root"]):
        raise AssetError(
            f"{path}: the capture's frames should be of {len(true['root'])} filmed ones, are {len(video.cameras)} up "
            f"to number {rows.max()}"
        )
    camera = Camera(true["K"], true["camera_from_world"], (int(true["size"][0]), int(true["size"][1])))
    assert video.axis_angle is not None and video.root is not None
    found = []
    for i, row in enumerate(int(row) for row in rows):
        truth = HeldOutView(path.parent, f"{row:06d}", video.part, row, true["poses"][row], true["root"][row], camera)
        ours = in_world(truth, video.cameras[i].camera_from_world, video.axis_angle[i], video.root[i])
        found.append(Placement(truth, {REGIONS[video.part]: ours}))
    return found
