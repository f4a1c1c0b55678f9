"""What the window shows: a scene with its files opened, its live sources, and cameras to switch between."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar
from avatar.rotation import matrix_from_axis_angle
from player.live.playback import LivePlayback
from player.scene.camera_path import CameraPath
from player.scene.cameras import TURN_SECONDS, Cameras, Orbit
from player.scene.capture_view import CaptureView
from player.scene.framing import FOV, extent, facing, fitted, view_from
from player.scene.motions import BLOCK
from player.scene.opened import opened_camera, opened_capture, opened_tracks, still_seconds
from player.scene.scene import BUILTIN_AVATARS, Scene, SceneCamera
from player.window.playback import Playback

# what a scene's camera is in the window, where it has another name
KINDS = {"front": "orbit", "follow": "orbit", "orbit": "turntable"}


# what differs when a file is replaced
Stamp = tuple[int, int]


@dataclass
class Show:
    """A scene and what was opened of it: avatars, their playback, the cameras."""

    scene: Scene
    avatars: list[Avatar]
    playback: Playback
    cameras: Cameras
    capture: CaptureView | None
    # whether the orbit goes along with the first avatar from the start
    follow: bool
    # what the avatars' files were before they were read, where they may be replaced while they are shown
    stamps: dict[str, Stamp | None] | None = None

    def fit_orbit(self, size: tuple[int, int]) -> None:
        """Put the orbit's home in front of the first avatar, so near that a picture of this size holds all of them."""
        points: list[Float[np.ndarray, "points 3"]] = []
        for avatar, track in zip(self.avatars, self.playback.tracks, strict=True):
            turned = matrix_from_axis_angle(np.array([0.0, track.turn, 0.0]))
            points.append(extent(avatar, track.motion.read(0, min(BLOCK, track.motion.frames))) @ turned.T + track.at)
        everything = np.concatenate(points)
        first = self.playback.tracks[0].pose(0.0)[0]
        azimuth = facing(first, self.avatars[0].joint_positions.astype(np.float64))
        orbit = self.cameras.orbit
        orbit.move_home(fitted(everything, azimuth, size, fov=orbit.fov))


def opened_show(
    scene: Scene,
    avatars: Sequence[Avatar],
    live: Sequence[tuple[LivePlayback, Sequence[int]]] = (),
    stamps: dict[str, Stamp | None] | None = None,
) -> Show:
    """Open the motions, cameras and capture of a scene whose avatars were read; `live` poses some of them. With the
    `stamps` that their files had before (file_stamps), avatars are shown anew when those are replaced.

    Raises:
        AssetError: a file cannot be read.
    """
    capture, path, named = None, None, {}
    for camera in scene.cameras:
        if camera.kind == "capture" and capture is None:
            capture = opened_capture(camera)
        elif camera.kind in ("path", "file", "capture"):
            opened = opened_camera(camera)
            if camera.kind == "path" and path is None and isinstance(opened, CameraPath):
                path = opened
            else:
                named[camera.name or Path(camera.path or "").stem] = opened
    tracks = opened_tracks(scene, avatars, scene.cameras, capture)
    first = scene.cameras[0] if scene.cameras else SceneCamera()
    kind = next(iter(named)) if first.kind == "file" else KINDS.get(first.kind, first.kind)
    cameras = Cameras(
        Orbit(np.zeros(3), 3.0, 0.0, FOV if first.fov_deg is None else float(np.radians(first.fov_deg))),
        path=path,
        capture=capture.frame_cameras if capture else None,
        named=named,
        kind=kind,
        turn_seconds=first.seconds or TURN_SECONDS,
    )
    if first.eye is not None and first.target is not None:
        cameras.orbit.look(view_from(first.eye, first.target))
    playback = Playback(tracks, live, rate=scene.rate, least=still_seconds(tracks, named.get(kind)))
    return Show(scene, list(avatars), playback, cameras, capture, first.kind in ("follow", "orbit"), stamps)


def file_stamps(scene: Scene) -> dict[str, Stamp | None]:
    """What the files of a scene's avatars are now, by path."""
    return {entry.path: stamp_of(Path(entry.path)) for entry in scene.avatars if entry.path not in BUILTIN_AVATARS}


def stamp_of(file: Path) -> Stamp | None:
    """What differs when a file is replaced; None where there is none."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_ino
