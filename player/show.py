"""What the window shows: a scene with its files opened, its live sources, and cameras to switch between."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar
from avatar.camera import read_camera
from avatar.rotation import matrix_from_axis_angle
from player.camera_path import CameraPath
from player.cameras import Cameras, Orbit
from player.capture_view import CaptureView, open_capture
from player.effects import Background, Effects
from player.framing import extent, facing, fitted_camera
from player.live.playback import LivePlayback
from player.motions import notes, opened_motion, retargeted, standing
from player.playback import BLOCK, Playback, Track
from player.scene import Scene, SceneAvatar
from player.stage import opened_avatar

KINDS = {
    "front": "orbit",
    "orbit": "turntable",
}  # what a scene's camera is in the window, where it has another name


@dataclass
class Show:
    """Avatars with names, their playback, the cameras, and how they are drawn."""

    avatars: list[Avatar]
    names: list[str]
    playback: Playback
    cameras: Cameras
    effects: Effects = field(default_factory=Effects)
    background: Background = field(default_factory=Background)
    capture: CaptureView | None = None
    notes: list[str] = field(default_factory=list)  # what was assumed, for printing

    def fit_orbit(self, size: tuple[int, int]) -> None:
        """Put the orbit in front of the first avatar, so near that a picture of this size holds all of them."""
        points: list[Float[np.ndarray, "points 3"]] = []
        for avatar, track in zip(self.avatars, self.playback.tracks, strict=True):
            turned = matrix_from_axis_angle(np.array([0.0, track.turn, 0.0]))
            points.append(extent(avatar, track.clip(0, min(BLOCK, track.frames))) @ turned.T + track.at)
        everything = np.concatenate(points)
        first = self.playback.tracks[0].pose(0.0)[0]
        azimuth = facing(first, self.avatars[0].joint_positions.astype(np.float64))
        camera = fitted_camera(everything, azimuth, size)
        target = 0.5 * (everything.min(0) + everything.max(0))
        self.cameras.orbit = Orbit(target, float(np.linalg.norm(camera.eye - target)), azimuth)


def opened_show(
    scene: Scene, avatars: Sequence[Avatar], live: Sequence[tuple[LivePlayback, Sequence[int]]] = ()
) -> Show:
    """Open the motions, cameras and capture of a scene whose avatars were read; `live` poses some of them.

    Raises:
        AssetError: a file cannot be read.
    """
    capture, path, file = None, None, None
    for camera in scene.cameras:
        if camera.path is None:
            continue
        if camera.kind == "capture":
            capture = open_capture(camera.path, camera.name or "body")
        elif camera.kind == "path":
            path = CameraPath.read(camera.path)
        elif camera.kind == "file":
            file = read_camera(camera.path)
    said: list[str] = []
    tracks = [
        _track(entry, avatar, capture if index == 0 else None, said)
        for index, (entry, avatar) in enumerate(zip(scene.avatars, avatars, strict=True))
    ]
    first = scene.cameras[0].kind if scene.cameras else "front"
    cameras = Cameras(
        Orbit(np.zeros(3), 3.0, 0.0), path=path, file=file, capture=capture.cameras if capture else (),
        kind=KINDS.get(first, first),
    )  # fmt: skip
    playback = Playback(tracks, live, rate=scene.rate)
    names = [Path(entry.path).stem for entry in scene.avatars]
    notes_ = list(dict.fromkeys(said))
    return Show(list(avatars), names, playback, cameras, scene.effects, scene.background, capture, notes_)


def _track(entry: SceneAvatar, avatar: Avatar, capture: CaptureView | None, said: list[str]) -> Track:
    at, turn = np.array(entry.at, np.float64), float(np.radians(entry.turn_deg))
    if entry.live is not None:
        return Track(standing(avatar), 1, 30.0, at=at, turn=turn, name=entry.live)
    if entry.motion is None and capture is not None:
        name = f"the {capture.part} video"
        return Track(capture.clip, len(capture.images), capture.rate, at=at, turn=turn, name=name)
    motion = opened_motion(entry.motion, entry.body, entry.hands)
    clip = retargeted(motion, avatar)
    said += notes([clip], 0)
    return Track(clip, motion.frames, motion.rate, entry.start, at, turn, entry.motion or "T-pose")


def read_avatars(scene: Scene) -> list[Avatar]:
    """The avatars of a scene; one that stands several times is read once."""
    read = {path: opened_avatar(path) for path in dict.fromkeys(entry.path for entry in scene.avatars)}
    return [read[entry.path] for entry in scene.avatars]
