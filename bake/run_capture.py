"""The videos that a run was trained on, found again: from there its textures are taken."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.light import CaptureLight
from bake.promises import Facts
from capture.fit.refine import with_refined
from capture.folder import Capture, PartVideo, read_capture
from capture.light.frames import light_from_video
from capture.own_face import OwnFace
from command.errors import AssetError
from train.run import lights_of, matrix_of
from train.session import capture_digest

# metres that the head's landmarks may be off the template, in the place that the run found for the head
HEAD_OFF = 0.03


@dataclass(frozen=True)
class RunVideos:
    capture: Path
    # run folder with refined poses of just these videos; None: the capture's own poses
    refined: Path | None
    head_from_canonical: Float[Array, "4 4"]
    # by the part of each video, the head's in the canonical frame if not in its camera's; empty: what is seen holds
    # the light
    lights: dict[str, CaptureLight]
    # poses were estimated, not made: frames may show things beside their places
    estimated: bool
    # canonical height of the chin, metres, where they were and the head was filmed
    chin: float | None
    # how the person sat under the head was found as well
    trunk: bool
    # what a film of the face said; None: there was none
    own_face: OwnFace | None

    def video(self, part: str) -> PartVideo:
        """One video, in the poses that training ended with; one at a time, for they are large."""
        capture = read_capture(self.capture, parts=(part,))
        if self.refined is not None:
            capture = with_refined(capture, self.refined)
        return capture.videos[part]


def run_videos(path: Path, facts: Facts, given: Path | None) -> RunVideos:
    """The videos of the run folder `path`, whose run.json holds `facts`: in the folder `given`, else where it says.

    A capture that is given may be another one of the same person, say of larger frames; its own poses are taken then.

    Raises:
        AssetError: the capture is nowhere, or another one lies there; or the head of the one that is given lies
            elsewhere than the run's.
    """
    said = facts.get("capture_at")
    ways = "name the videos with --capture FOLDER, or take the field's colors with --texture-from field"
    recorded = said.get("folder") if isinstance(said, dict) else None
    if given is None and not isinstance(recorded, str):
        raise AssetError(f"{path / 'run.json'}: capture_at should say where the run's capture lies, is absent: {ways}")
    folder = given if given is not None else path / str(recorded)
    if not (folder / "capture.json").is_file():
        raise AssetError(f"{folder}: expected the capture folder that {path} was trained on, found none: {ways}")
    digest = said.get("digest") if isinstance(said, dict) else None
    same = digest == capture_digest(folder)
    if given is None and not same:
        raise AssetError(f"{folder}: expected the capture that {path} was trained on ({digest}), found another: {ways}")
    capture = read_capture(folder, parts=("head",), frames_on_demand=True)
    estimated = capture.facts.get("pose_noise_deg") != 0
    refined, head_from_canonical = path if same else None, matrix_of(path, facts, "head_from_canonical")
    lights = lights_of(path, facts)
    if lights and lights["head"].frame == "world":
        lights["head"] = _canonical_light(lights["head"], folder, refined, np.linalg.inv(head_from_canonical))
    videos = RunVideos(
        folder, refined, head_from_canonical, lights, estimated, capture.chin if estimated else None,
        capture.videos["head"].trunk is not None, capture.own_face,
    )  # fmt: skip
    if not same:
        _check_head(videos, capture, path)
    return videos


def _canonical_light(
    light: CaptureLight, folder: Path, refined: Path | None, canonical_from_head: Float[Array, "4 4"]
) -> CaptureLight:
    """A head's light of the world in the canonical frame, where the head is held as in the body's video."""
    capture = read_capture(folder, parts=("body", "head"), frames_on_demand=True)
    if refined is not None:
        capture = with_refined(capture, refined)
    world_from_canonical = light_from_video(capture, "head", light.frame, canonical_from_head)[0]
    return light.turned(world_from_canonical.T, light.frame)


def _check_head(videos: RunVideos, capture: Capture, run: Path) -> None:
    """Refuse videos whose head lies in another frame than the run's."""
    video = capture.videos["head"]
    assert video.landmarks is not None and video.landmark_vertices is not None
    canonical_from_head = np.linalg.inv(videos.head_from_canonical)
    found = video.landmarks @ canonical_from_head[:3, :3].T + canonical_from_head[:3, 3]
    off = float(np.median(np.linalg.norm(found - capture.subject.vertices[video.landmark_vertices], axis=1)))
    if not off < HEAD_OFF:
        raise AssetError(
            f"{videos.capture / 'head'}: landmarks should lie within {HEAD_OFF * 1e3:.0f} mm of the template where "
            f"{run} has the head, are {off * 1e3:.0f} mm off: the videos' head frame is not the run's"
        )
