"""The cameras of the window: orbit, first person, turntable, a path through keys, and those of a capture."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from avatar.camera import Camera, direction, look_at, orbit_camera, pinhole
from player.scene.camera_path import CameraPath
from player.scene.framing import ELEVATION, FOV

STEEPEST = 1.5  # radians; a camera never goes over a pole
WALK = 1.5  # metres a second
TURN_SECONDS = 12.0  # a turntable's round
NAMES = {name: name for name in ("orbit", "walk", "turntable", "path", "capture")} | {"walk": "first person"}


class Orbit:
    """A camera round a point, turned and brought nearer by hand."""

    def __init__(self, target: Float[np.ndarray, "3"], distance: float, azimuth: float, fov: float = FOV):
        self.home, self.fov = (np.array(target, np.float64), distance, azimuth, ELEVATION), fov
        self.reset()

    def reset(self) -> None:
        target, self.distance, self.azimuth, self.elevation = self.home
        self.target = target.copy()

    def turn(self, dx: float, dy: float) -> None:
        """Drag by pixels: half a degree each; never over the poles."""
        self.azimuth = float(np.remainder(self.azimuth - np.radians(0.5 * dx), 2 * np.pi))
        self.elevation = float(np.clip(self.elevation + np.radians(0.5 * dy), -STEEPEST, STEEPEST))

    def shift(self, dx: float, dy: float, height: int) -> None:
        """Move the target in the image plane, so that it follows the pointer."""
        right, down = self.camera((1, 1)).camera_from_world[:2, :3]
        metres = 2 * self.distance * np.tan(self.fov / 2) / max(height, 1)
        self.target -= metres * (dx * right + dy * down)

    def approach(self, clicks: float) -> None:
        nearer = 0.9 ** float(np.clip(clicks, -100, 100))
        self.distance = float(np.clip(self.distance * nearer, 0.05, 1000.0))

    def camera(self, size: tuple[int, int], along: Float[np.ndarray, "3"] | None = None) -> Camera:
        """The camera, moved along with the avatar by `along`, metres."""
        target = self.target if along is None else self.target + along
        return orbit_camera(target, self.distance, self.azimuth, self.elevation, size, self.fov)


class Walk:
    """A camera that one carries: looks by dragging, goes by keys."""

    def __init__(self, eye: Float[np.ndarray, "3"], azimuth: float, elevation: float, fov: float = FOV):
        self.eye, self.azimuth, self.fov = np.array(eye, np.float64), azimuth, fov
        self.elevation = float(np.clip(elevation, -STEEPEST, STEEPEST))

    def turn(self, dx: float, dy: float) -> None:
        """Drag by pixels: a quarter of a degree each, and the world follows the pointer."""
        self.azimuth = float(np.remainder(self.azimuth + np.radians(0.25 * dx), 2 * np.pi))
        self.elevation = float(np.clip(self.elevation + np.radians(0.25 * dy), -STEEPEST, STEEPEST))

    def go(self, right: float, up: float, ahead: float) -> None:
        """Go metres to the right, up along the world's y, and where one looks."""
        facing = direction(self.azimuth, self.elevation)
        side = np.array([-np.cos(self.azimuth), 0.0, np.sin(self.azimuth)])
        self.eye = np.clip(self.eye + right * side + [0.0, up, 0.0] + ahead * facing, -1e4, 1e4)

    def camera(self, size: tuple[int, int]) -> Camera:
        ahead = self.eye + direction(self.azimuth, self.elevation)
        return Camera(pinhole(size, self.fov), look_at(self.eye, ahead), size)


class Cameras:
    """All of them; one is looked through. Which there are depends on what was opened."""

    def __init__(
        self, orbit: Orbit, *, path: CameraPath | None = None, capture: Sequence[Camera] = (),
        named: Mapping[str, CameraPath | Sequence[Camera]] | None = None, kind: str = "orbit",
        turn_seconds: float = TURN_SECONDS,
    ):  # fmt: skip
        self.orbit, self.path, self.capture, self.kind = orbit, path, capture, kind
        self.named = dict(named or {})  # further ones by name: a path, or a camera for each frame (the last stays)
        self.turn_seconds = turn_seconds
        self.walk = Walk(np.zeros(3), 0.0, 0.0)
        # the path that is being recorded
        self.keys: list[tuple[float, Camera]] = []
        if kind not in self.kinds:
            raise ValueError(f"camera should be one of {', '.join(self.kinds)}, is {kind!r}")

    @property
    def kinds(self) -> list[str]:
        """Those that can be chosen now."""
        there = {"path": self.path is not None, "capture": bool(self.capture)}
        return [*(kind for kind in NAMES if there.get(kind, True)), *self.named]

    def choose(self, kind: str, now: Camera) -> None:
        """Look through another camera; first person starts where one looked from."""
        if kind == "walk":
            ahead = now.camera_from_world[2, :3]
            azimuth = float(np.arctan2(ahead[0], ahead[2]))
            elevation = float(np.arcsin(np.clip(ahead[1], -1, 1)))
            self.walk = Walk(now.eye, azimuth, elevation, self.orbit.fov)
        self.kind = kind

    def next(self, now: Camera) -> None:
        kinds = self.kinds
        self.choose(kinds[(kinds.index(self.kind) + 1) % len(kinds)], now)

    def advance(self, dt: float) -> None:
        """Let time pass: the turntable turns."""
        if self.kind == "turntable":
            turned = 2 * np.pi * min(max(dt, 0.0), 1.0) / self.turn_seconds
            self.orbit.azimuth = float(np.remainder(self.orbit.azimuth + turned, 2 * np.pi))

    def turn(self, dx: float, dy: float) -> None:
        """A drag with the left button."""
        if self.kind in ("orbit", "turntable"):
            self.orbit.turn(dx, dy)
        elif self.kind == "walk":
            self.walk.turn(dx, dy)

    def shift(self, dx: float, dy: float, height: int) -> None:
        """A drag with another button."""
        if self.kind in ("orbit", "turntable"):
            self.orbit.shift(dx, dy, height)
        elif self.kind == "walk":
            self.walk.go(-0.005 * dx, 0.005 * dy, 0.0)

    def approach(self, clicks: float) -> None:
        """The wheel."""
        if self.kind in ("orbit", "turntable"):
            self.orbit.approach(clicks)
        elif self.kind == "walk":
            self.walk.go(0.0, 0.0, 0.2 * float(np.clip(clicks, -100, 100)))

    def camera(
        self, size: tuple[int, int], seconds: float, frame: int, along: Float[np.ndarray, "3"] | None = None
    ) -> Camera:
        """What is looked through, at a moment of the path and a frame of the capture, fitted to `size` pixels."""
        chosen = {"path": self.path, "capture": self.capture, **self.named}.get(self.kind)
        if isinstance(chosen, CameraPath):
            return chosen.camera(seconds, size)
        if chosen:
            return letterboxed(chosen[min(frame, len(chosen) - 1)], size)
        return self.walk.camera(size) if self.kind == "walk" else self.orbit.camera(size, along)

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


def moved_into(camera: Camera, area: tuple[int, int, int, int], size: tuple[int, int]) -> Camera:
    """A camera for the area (left, top, width, height) as a camera for the whole window."""
    return camera.cropped(-area[0], -area[1], size)
