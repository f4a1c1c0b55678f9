"""The cameras of the window: orbit, turntable, a path through keys, and one for each frame of a motion or a capture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from avatar.camera import Camera, orbit_camera
from player.scene.camera_path import CameraPath
from player.scene.framing import ELEVATION, FOV, View

STEEPEST = 1.5  # radians; a camera never goes over a pole
TURN_SECONDS = 12.0  # a turntable's round
KINDS = ("orbit", "turntable", "path", "capture")


class Orbit:
    """A camera round a point, turned and brought nearer by hand."""

    def __init__(self, target: Float[np.ndarray, "3"], distance: float, azimuth: float, fov: float = FOV):
        self.home, self.fov = View(np.array(target, np.float64), distance, azimuth, ELEVATION), fov
        self.reset()

    def reset(self) -> None:
        self.look(self.home)

    def look(self, view: View) -> None:
        target, self.distance, self.azimuth, self.elevation = view
        self.target = target.copy()

    def move_home(self, home: View) -> None:
        """Another home; a view that was chosen by hand stays."""
        here = (*self.target, self.distance, self.azimuth, self.elevation)
        was_home, self.home = here == (*self.home.target, *self.home[1:]), home
        if was_home:
            self.reset()

    def turn(self, dx: float, dy: float) -> None:
        """Drag by pixels: half a degree each; never over the poles."""
        self.azimuth = float(np.remainder(self.azimuth - np.radians(0.5 * dx), 2 * np.pi))
        self.elevation = float(np.clip(self.elevation + np.radians(0.5 * dy), -STEEPEST, STEEPEST))

    def shift(self, dx: float, dy: float, height: int) -> None:
        """Move the target in the image plane, so that it follows the pointer."""
        right, down = self.camera((1, 1)).camera_from_world[:2, :3]
        metres = 2 * self.distance * np.tan(self.fov / 2) / max(height, 1)
        self.target -= metres * (dx * right + dy * down)

    def approach(self, clicks: float, beside: tuple[float, float] = (0.0, 0.0)) -> None:
        """Come nearer to what is seen `beside` the middle, right and down in metres at a metre's depth: what is as far
        away as the target stays there in the picture."""
        before, nearer = self.distance, 0.9 ** float(np.clip(clicks, -100, 100))
        self.distance = float(np.clip(before * nearer, 0.05, 1000.0))
        right, down = self.camera((1, 1)).camera_from_world[:2, :3]
        self.target += (before - self.distance) * (beside[0] * right + beside[1] * down)

    def camera(self, size: tuple[int, int], along: Float[np.ndarray, "3"] | None = None) -> Camera:
        """The camera, moved along with the avatar by `along`, metres."""
        target = self.target if along is None else self.target + along
        return orbit_camera(target, self.distance, self.azimuth, self.elevation, size, self.fov)


@dataclass(frozen=True)
class FrameCameras:
    """A camera for each frame of a motion; the last one stays."""

    cameras: Sequence[Camera]
    # frames a second; None: as the first motion
    rate: float | None = None

    def camera(self, seconds: float | int, rate: float | int) -> Camera:
        """The camera at a moment of the timeline, whose first motion has so many frames a second."""
        frame = int(seconds * (self.rate or rate) + 1e-6)
        return self.cameras[min(frame, len(self.cameras) - 1)]


class Cameras:
    """All of them; one is looked through. Which there are depends on what was opened."""

    def __init__(
        self, orbit: Orbit, *, path: CameraPath | None = None, capture: FrameCameras | None = None,
        named: Mapping[str, CameraPath | FrameCameras] | None = None, kind: str = "orbit",
        turn_seconds: float = TURN_SECONDS,
    ):  # fmt: skip
        self.orbit, self.path, self.capture, self.kind = orbit, path, capture, kind
        self.named = dict(named or {})  # further ones by name
        self.turn_seconds = turn_seconds
        # the path that is being recorded
        self.keys: list[tuple[float, Camera]] = []

    @property
    def kinds(self) -> list[str]:
        """Those that can be chosen now."""
        there = {"path": self.path is not None, "capture": self.capture is not None}
        return [*(kind for kind in KINDS if there.get(kind, True)), *self.named]

    def next(self) -> None:
        kinds = self.kinds
        self.kind = kinds[(kinds.index(self.kind) + 1) % len(kinds)]

    def advance(self, dt: float) -> None:
        """Let time pass: the turntable turns."""
        if self.kind == "turntable":
            turned = 2 * np.pi * min(max(dt, 0.0), 1.0) / self.turn_seconds
            self.orbit.azimuth = float(np.remainder(self.orbit.azimuth + turned, 2 * np.pi))

    def turn(self, dx: float, dy: float) -> None:
        """A drag with the left button."""
        if self.kind in ("orbit", "turntable"):
            self.orbit.turn(dx, dy)

    def shift(self, dx: float, dy: float, height: int) -> None:
        """A drag with another button."""
        if self.kind in ("orbit", "turntable"):
            self.orbit.shift(dx, dy, height)

    def approach(self, clicks: float, beside: tuple[float, float] = (0.0, 0.0)) -> None:
        """The wheel; a turntable keeps its middle."""
        if self.kind in ("orbit", "turntable"):
            self.orbit.approach(clicks, beside if self.kind == "orbit" else (0.0, 0.0))

    def camera(
        self, size: tuple[int, int], seconds: float, rate: float | int, along: Float[np.ndarray, "3"] | None = None
    ) -> Camera:
        """What is looked through at a moment of the timeline, whose first motion has `rate` frames a second, fitted to
        `size` pixels."""
        chosen = {"path": self.path, "capture": self.capture, **self.named}.get(self.kind)
        if isinstance(chosen, CameraPath):
            return chosen.camera(seconds, size)
        if chosen is not None:
            return letterboxed(chosen.camera(seconds, rate), size)
        return self.orbit.camera(size, along)

    def add_key(self, seconds: float, now: Camera) -> None:
        """Record what is looked through as a key of the path at this moment; one at the same moment is replaced."""
        kept = [key for key in self.keys if abs(key[0] - seconds) > 1e-3]
        self.keys = sorted([*kept, (seconds, now)], key=lambda key: key[0])
        times, cameras = zip(*self.keys, strict=True)
        self.path = CameraPath.through(times, cameras)

    def clear_keys(self) -> None:
        self.keys, self.path = [], None
        if self.kind == "path":
            self.kind = "orbit"


def letterboxed(camera: Camera, size: tuple[int, int]) -> Camera:
    """The camera with its whole image, in its own proportions, in the middle of `size` pixels."""
    left, top, width, height = inner_box(camera.size, size)
    K = np.diag([width / camera.size[0], height / camera.size[1], 1.0]) @ camera.K
    K[:2, 2] += left, top
    return Camera(K, camera.camera_from_world, size)


def inner_box(image: tuple[int, int], size: tuple[int, int]) -> tuple[float, float, float, float]:
    """Left, top, width, height of the largest box of the image's proportions in the middle of `size`."""
    scale = min(size[0] / image[0], size[1] / image[1])
    width, height = image[0] * scale, image[1] * scale
    return 0.5 * (size[0] - width), 0.5 * (size[1] - height), width, height
