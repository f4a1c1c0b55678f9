"""A scene opened for filming: avatars, their poses and the camera at every frame.

All of it follows from the scene and the frame number alone, so any machine that opens the same scene draws the same
frame.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from avatar.camera import Camera, orbit_camera
from avatar.hull import hull_of, outermost, posed_hull
from avatar.motion.clip import spread_frames
from command.errors import AssetError
from player.scene.acting import ALONE
from player.scene.camera_path import CameraPath, is_path
from player.scene.framing import FOV, View, facing, fitted, fitted_round, view_from
from player.scene.motions import BLOCK
from player.scene.opened import notes_of, opened_avatars, opened_camera, opened_capture, opened_tracks, still_seconds
from player.scene.renderer import Pose
from player.scene.scene import FITTED, Scene, SceneCamera

# a function of the frame number, which may lie between two frames, and the first avatar's pelvis
CameraAt = Callable[[float, Float[np.ndarray, "3"]], Camera]
SIZE = (640, 640)
FITTED_TO = 64  # frames of each block of a film that fitted cameras look at
TURN = 6.0  # seconds of a turntable's round when nothing on it moves


@dataclass(frozen=True)
class Fit:
    """What a fitted camera must see, and the side it begins from: found once, then good for every machine."""

    # world metres, or about the first pelvis for a camera that goes along with it
    points: Float[np.ndarray, "points 3"]
    azimuth: float  # radians


class Stage:
    """A scene with its files read; of the avatars the `levels` finest levels of detail (None: all).

    Raises:
        AssetError: a file is absent or broken, or the scene is live.
    """

    def __init__(self, scene: Scene, levels: int | None = None):
        self.scene = scene
        if not scene.avatars:
            raise AssetError("the scene has no avatar")
        for actor in scene.avatars:
            if actor.live is not None:
                raise AssetError(f"{actor.path}: live = {actor.live!r} is for `selfscan play`; a film needs a motion")
        self.avatars = opened_avatars(scene, levels)
        self.camera = scene.cameras[0] if scene.cameras else SceneCamera()
        capture = opened_capture(self.camera)
        self.tracks = opened_tracks(scene, self.avatars, scene.cameras[:1], capture)
        self.notes = notes_of(self.tracks)
        self.rate = float(scene.rate or self.tracks[0].motion.rate)
        self.kept = opened_camera(self.camera, capture) if self.camera.kind not in FITTED else None
        self.frames = self._frames()
        # the moment that a turntable holds, seconds
        self.still: float | None = None
        if self.camera.kind == "turntable" and self.frames == 1:
            self.hold(0.0)

    @property
    def name(self) -> str:
        """Of the motion, or of several as the scene, for messages."""
        return self.tracks[0].name if len(self.tracks) == 1 else "the scene"

    @property
    def turn(self) -> float:
        """Seconds of a turntable's round."""
        return self.camera.seconds or (TURN if self.still is not None else self.frames / self.rate)

    def hold(self, seconds: float) -> None:
        """A turntable shows this moment from all sides: a film of one round."""
        self.still = seconds
        self.frames = max(1, round(self.turn * self.rate))

    def film_at(self, rate: float) -> None:
        """Show the same seconds at another rate. The scene carries it: all machines that open it film the same."""
        self.rate, self.scene = rate, replace(self.scene, rate=rate)
        self.frames = self._frames() if self.still is None else max(1, round(self.turn * rate))

    def _frames(self) -> int:
        seconds = max(still_seconds(self.tracks, self.kept), *(track.lasts(ALONE) for track in self.tracks))
        return max(1, int(np.ceil(seconds * self.rate - 1e-6)))

    def _moment(self, frame: int) -> float:
        """Seconds into the motions at a frame of the film."""
        return frame / self.rate if self.still is None else self.still

    def size(self) -> tuple[int, int]:
        """Pixels: the scene's, the camera file's, or 640 x 640."""
        if self.scene.size is not None:
            return self.scene.size
        return SIZE if self.kept is None or isinstance(self.kept, CameraPath) else self.kept.cameras[0].size

    def poses(self, frame: int) -> list[Pose]:
        """One pose for each avatar. A motion that has ended stays at its last frame."""
        return [track.pose(self._moment(frame), frame / self.rate) for track in self.tracks]

    def poses_beside(self, frame: int, share: float) -> list[Pose]:
        """The poses so many frames (-1 to 1) from a frame, between those of the motions."""
        if self.still is not None:
            return self.poses(frame)
        return [track.pose_beside(frame / self.rate, share / self.rate) for track in self.tracks]

    def faced(self, poses: list[Pose], frame: float | int, camera: Camera) -> list[Pose]:
        """The poses with what faces do at a frame of the film, seen through this camera."""
        seconds = frame / self.rate
        return [track.faced(pose, seconds, camera.eye) for track, pose in zip(self.tracks, poses, strict=True)]

    def fit(self, start: int, stop: int) -> Fit | None:
        """What the fitted cameras of a film of these frames look at; None for cameras from files, and placed ones."""
        if self.camera.kind not in FITTED or self.camera.eye is not None:
            return None
        if self.still is not None:
            start, stop = 0, 1
        following = self.camera.kind in ("follow", "orbit")
        everything, azimuth = np.zeros((0, 3)), 0.0
        hulls = [hull_of(avatar) for avatar in self.avatars]
        for first in range(start, stop, BLOCK):
            # so many frames of a block show its extent; a motion of any length takes the memory of one block
            count = min(BLOCK, stop - first)
            chosen = first + spread_frames(count, FITTED_TO)
            poses = [[track.pose(self._moment(frame)) for track in self.tracks] for frame in chosen.tolist()]
            for k, avatar in enumerate(self.avatars):
                axis_angle = np.stack([row[k][0] for row in poses])
                root = np.stack([row[k][1] for row in poses])
                # over the ground, along with the first avatar
                if following:
                    root = root - np.stack([row[0][1] for row in poses]) * [1.0, 0.0, 1.0]
                if k == 0 and first == start:
                    azimuth = facing(axis_angle[0], avatar.joint_positions.astype(np.float64))
                points = posed_hull(hulls[k], axis_angle, root).reshape(-1, 3)
                everything = np.concatenate([everything, points[outermost(points)]])
                everything = everything[outermost(everything)]
        return Fit(everything, azimuth)

    def camera_at(self, fit: Fit | None, start: int, stop: int, size: tuple[int, int]) -> CameraAt:
        """The camera of a film of the frames start .. stop - 1."""
        kept = self.kept
        if self.camera.kind in FITTED:
            return self._fitted_at(fit, start, stop, size)
        if isinstance(kept, CameraPath):
            return lambda frame, _root: kept.camera(frame / self.rate, size)
        assert kept is not None
        cameras = [camera.resized(size) if camera.size != size else camera for camera in kept.cameras]
        seen, rate = replace(kept, cameras=cameras), self.tracks[0].motion.rate
        # moments beside a frame are seen through the frame's camera
        return lambda frame, _root: seen.camera(int(frame + 0.5) / self.rate, rate)

    def _fitted_at(self, fit: Fit | None, start: int, stop: int, size: tuple[int, int]) -> CameraAt:
        """A camera that stands, goes along with the first avatar, round it, or both."""
        kind, fov = self.camera.kind, FOV if self.camera.fov_deg is None else float(np.radians(self.camera.fov_deg))
        view, origin = self._view(fit, size, fov)

        def seen(turn: float, root: Float[np.ndarray, "3"]) -> Camera:
            target, azimuth = view.target + (root - origin) * [1.0, 0.0, 1.0], view.azimuth + 2 * np.pi * turn
            return orbit_camera(target, view.distance, azimuth, view.elevation, size, fov)

        if kind == "front":
            return lambda _frame, _root: seen(0.0, origin)
        if kind == "follow":
            return lambda _frame, root: seen(0.0, root)
        if kind == "orbit":
            seconds = self.camera.seconds or (stop - start) / self.rate
            return lambda frame, root: seen((frame - start) / self.rate / seconds, root)
        # the turn joins: a film of one turn runs in a loop
        return lambda frame, _root: seen(math.fmod((frame - start) / self.rate / self.turn, 1.0), origin)

    def _view(self, fit: Fit | None, size: tuple[int, int], fov: float) -> tuple[View, Float[np.ndarray, "3"]]:
        """How a camera that is fitted or placed begins, and where the first pelvis is then."""
        if self.camera.eye is not None and self.camera.target is not None:
            return view_from(self.camera.eye, self.camera.target), self.tracks[0].pose(0.0)[1]
        assert fit is not None
        find = fitted_round if self.camera.kind in ("orbit", "turntable") else fitted
        return find(fit.points, fit.azimuth, size, fov=fov), np.zeros(3)


def camera_from_option(text: str) -> SceneCamera:
    """The camera that --camera names: front, orbit, turntable, a camera file, a camera path, or a capture folder.

    Raises:
        AssetError: a .json that is none.
    """
    if text in FITTED:
        return SceneCamera(text)
    folder, _, part = text.partition(":") if not Path(text).exists() else (text, "", "")
    if Path(folder).is_dir():
        return SceneCamera("capture", folder, part or None)
    if Path(text).suffix.lower() == ".npz":
        return SceneCamera("file", text)
    return SceneCamera("path" if is_path(text) else "file", text)
