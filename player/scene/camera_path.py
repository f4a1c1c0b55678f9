"""Cameras that move through keys set by hand.

A camera path is a JSON file, times in seconds from the start of the film:

    {"keys": [{"t": 0.0, "eye": [0, 1.4, 3.2], "target": [0, 1.0, 0], "fov_deg": 35},
              {"t": 2.5, "size": [960, 720], "K": [...], "camera_from_world": [...]}]}

A key is an eye that looks at a target (world, metres; `fov_deg` vertical, 35 if left out; optional `up`), or the
content of a camera file, which the path passes through exactly.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.camera import FARTHEST, LARGEST, Camera, camera_from_json, look_at
from command.errors import AssetError
from command.settings import AtLeast, AtMost, Refused, SettingsSource, record_of, settings
from files import input_file
from files.whole import write_json
from player.scene.framing import FOV

# eye (3), target (3), up (3), log of the two focal lengths, skew, principal point from the middle;
# the last five in image heights, so that any image size shows the same vertical field of view
Key = Float[Array, "14"]
Place = tuple[float, float, float]
# the most bytes of a file of camera paths
MAX_BYTES = 1 << 24
SHORTEST = 1e-6  # metres from eye to target under which no direction is left


@dataclass(frozen=True)
class CameraPath:
    """Keys in the order of time, with a smooth way through them."""

    seconds: Float[Array, "keys"]
    keys: Float[Array, "keys 14"]

    @property
    def duration(self) -> float:
        """Time of the last key, seconds."""
        return float(self.seconds[-1])

    def camera(self, seconds: float, size: tuple[int, int]) -> Camera:
        """The camera at a time; before the first key and after the last it stands still.

        Between keys every number follows a Catmull-Rom curve (Catmull and Rom 1974) for keys at any distance in
        time: the slope at a key is that of the parabola through it and its neighbours. Where eye and target
        meet on the way, the last direction before is kept.
        """
        at = self._at(seconds)
        step = 1e-3
        while np.linalg.norm(at[3:6] - at[:3]) < SHORTEST and seconds - step > self.seconds[0]:
            before = self._at(seconds - step)
            at[3:6] = at[:3] + (before[3:6] - before[:3])
            step *= 2
        return camera_of(at, size)

    def _at(self, seconds: float) -> Key:
        times, keys = self.seconds, self.keys
        if len(times) == 1 or seconds <= times[0]:
            return keys[0].copy()
        if seconds >= times[-1]:
            return keys[-1].copy()
        i = int(np.searchsorted(times, seconds, side="right")) - 1
        slopes = slopes_at(times, keys)
        step = times[i + 1] - times[i]
        s = (seconds - times[i]) / step
        return (
            (1 + 2 * s) * (1 - s) ** 2 * keys[i] + s * (1 - s) ** 2 * step * slopes[i]
            + s * s * (3 - 2 * s) * keys[i + 1] - s * s * (1 - s) * step * slopes[i + 1]
        )  # fmt: skip

    @staticmethod
    def through(seconds: Sequence[float], cameras: Sequence[Camera]) -> "CameraPath":
        """The path through cameras at increasing times; each looks at a point 3 metres before it.

        Raises:
            ValueError: no cameras, or times that do not grow.
        """
        times = np.asarray(seconds, np.float64)
        if not (len(times) == len(cameras) > 0 and (np.diff(times) > 0).all()):
            raise ValueError(f"{len(cameras)} cameras need as many growing times, are {times.tolist()}")
        return CameraPath(times, np.stack([key_of(camera) for camera in cameras]))

    @staticmethod
    def read(path: Path | str) -> "CameraPath":
        """Read a camera path file.

        Raises:
            AssetError: not JSON, no keys, times that do not grow, or a key that makes no camera.
        """
        content = read_json(path)
        if not isinstance(content, dict) or not isinstance(content.get("keys"), list) or not content["keys"]:
            raise AssetError(f'{path}: expected {{"keys": [...]}} with at least one key')
        times, keys = [], []
        for number, key in enumerate(content["keys"]):
            place = f"{path}, key {number}"
            if not isinstance(key, dict):
                raise AssetError(f"{place}: expected an object, found {type(key).__name__}")
            times.append(_number(place, key, "t"))
            if number and not times[-1] > times[-2]:
                raise AssetError(f"{place}: t should be after {times[-2]:g}, is {times[-1]:g}")
            keys.append(_read_key(place, key))
        return CameraPath(np.array(times), np.stack(keys))

    def write(self, path: Path | str) -> None:
        """Write the path; `read` gives the same cameras at its keys, to rounding.

        Keys with square pixels and the principal point in the middle are written as eye and target, others as
        camera files of an image 1000 pixels high.
        """
        rows = []
        for seconds, key in zip(self.seconds, self.keys, strict=True):
            row: dict[str, object] = {"t": float(seconds)}
            if key[9] == key[10] and not key[11:].any():
                row |= {"eye": key[:3].tolist(), "target": key[3:6].tolist(), "up": key[6:9].tolist()}
                row["fov_deg"] = math.degrees(2 * math.atan(0.5 / math.exp(key[10])))
            else:
                camera = camera_of(key, (1000, 1000))
                row |= {"size": [1000, 1000], "K": camera.K.tolist()}
                row["camera_from_world"] = camera.camera_from_world.tolist()
            rows.append(row)
        write_json(path, {"keys": rows})


def is_path(path: Path | str) -> bool:
    """Whether a JSON file holds a camera path, not one camera.

    Raises:
        AssetError: it is not JSON.
    """
    content = read_json(path)
    return isinstance(content, dict) and "keys" in content


def read_json(path: Path | str) -> input_file.Json:
    return input_file.read_json(path, "front, orbit, turntable, or a camera (path) in JSON", most=MAX_BYTES)


def slopes_at(times: Float[Array, "keys"], values: Float[Array, "keys numbers"]) -> Float[Array, "keys numbers"]:
    """Derivatives of the parabolas through each key and its neighbours; at the ends, of the same parabola."""
    if len(times) < 3:
        return np.repeat(np.diff(values, axis=0) / np.diff(times)[:, None], len(times), axis=0)
    return np.gradient(values, times, axis=0, edge_order=2)


def key_of(camera: Camera) -> Key:
    """The numbers of a camera, its target 3 metres ahead; lens distortion is left out, as in drawing."""
    R, height = camera.camera_from_world[:3, :3], camera.size[1]
    fx, skew, cx = camera.K[0]
    _, fy, cy = camera.K[1]
    lens = [
        math.log(fx / height), math.log(fy / height), skew / height,
        (cx - 0.5 * camera.size[0]) / height, (cy - 0.5 * height) / height,
    ]  # fmt: skip
    return np.concatenate([camera.eye, camera.eye + 3.0 * R[2], -R[1], lens])


def camera_of(key: Key, size: tuple[int, int]) -> Camera:
    """The camera of a key's numbers on an image of `size` pixels."""
    width, height = size
    fx, fy, (skew, cx, cy) = math.exp(key[9]) * height, math.exp(key[10]) * height, key[11:] * height
    K = np.array([[fx, skew, 0.5 * width + cx], [0, fy, 0.5 * height + cy], [0, 0, 1.0]])
    return Camera(K, look_at(key[:3], key[3:6], key[6:9]), size)


def _read_key(place: str, key: dict[str, object]) -> Key:
    if "camera_from_world" in key or "K" in key:
        return key_of(camera_from_json(place, key))
    own = {name: value for name, value in key.items() if name != "t"}
    try:
        view = record_of(_EyeKey, own, SettingsSource(), shown="a key")
    except Refused as error:
        raise AssetError(f"{place}: {error}") from None
    focal = math.log(0.5 / math.tan(math.radians(view.fov_deg) / 2))
    return np.array([*view.eye, *view.target, *view.up, focal, focal, 0.0, 0.0, 0.0])


@settings
class _EyeKey:
    """An eye that looks at a target; world, metres."""

    eye: Annotated[Place, AtLeast(-FARTHEST), AtMost(FARTHEST), "where the camera is"]
    target: Annotated[Place, AtLeast(-FARTHEST), AtMost(FARTHEST), "what it looks at"]
    up: Annotated[Place, AtLeast(-FARTHEST), AtMost(FARTHEST), "what is up in the picture"] = (0.0, 1.0, 0.0)
    fov_deg: Annotated[float, AtLeast(0.1), AtMost(175), "vertical field of view, degrees"] = math.degrees(FOV)

    def __post_init__(self):
        if math.dist(self.target, self.eye) < SHORTEST:
            raise ValueError(f"target: expected another place than the eye's, found {list(self.eye)}")
        if not math.hypot(*self.up) > SHORTEST:
            raise ValueError(f"up: expected a direction, found {list(self.up)}")


def _number(place: str, key: dict[str, object], name: str) -> float:
    value = key.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        raise AssetError(f"{place}: {name} should be a number below {LARGEST:g}, is {str(value)[:60]}")
    return float(value)
