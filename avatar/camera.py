"""Cameras: OpenCV intrinsics and extrinsics, files, rays, and the exact OpenGL matrices of the same camera."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.rotation import affine
from command.errors import AssetError
from files.input_file import read_json_object, short
from files.npz import read_npz
from files.whole import whole_file, write_json

Vector = Sequence[float | int] | Array

# the largest camera file
MAX_BYTES = 1 << 20
# pixels that leave every product of them finite
LARGEST = 1e9
# metres from the origin; some times farther, single precision cannot order the depths of a body (docs/limits.md)
FARTHEST = 1e6


@dataclass(frozen=True)
class Camera:
    """A pinhole camera, OpenCV convention: +x right, +y down, +z forward; pixel centres at .5."""

    K: Float[Array, "3 3"]  # pixels
    camera_from_world: Float[Array, "4 4"]  # rigid, metres
    size: tuple[int, int]  # width, height in pixels
    distortion: Float[Array, "5"] = field(default_factory=lambda: np.zeros(5))  # k1 k2 p1 p2 k3 (Brown 1971)

    @property
    def eye(self) -> Float[Array, "3"]:
        """Centre of projection in the world, metres."""
        return -self.camera_from_world[:3, :3].T @ self.camera_from_world[:3, 3]

    def resized(self, size: tuple[int, int]) -> "Camera":
        """The same view on another pixel grid."""
        scale = np.diag([size[0] / self.size[0], size[1] / self.size[1], 1.0])
        return Camera(scale @ self.K, self.camera_from_world, size, self.distortion)

    def cropped(self, left: int, top: int, size: tuple[int, int]) -> "Camera":
        """The view of a rectangle of its pixels, which may reach beyond them."""
        K = self.K.copy()
        K[:2, 2] -= left, top
        return Camera(K, self.camera_from_world, size, self.distortion)


def pinhole(size: tuple[int, int], fov: float) -> Float[Array, "3 3"]:
    """Intrinsics with the principal point in the middle; `fov` is the vertical field of view, radians."""
    focal = 0.5 * size[1] / np.tan(0.5 * fov)
    return np.array([[focal, 0, 0.5 * size[0]], [0, focal, 0.5 * size[1]], [0, 0, 1.0]])


def look_at(eye: Vector, target: Vector, up: Vector = (0.0, 1.0, 0.0)) -> Float[Array, "4 4"]:
    """camera_from_world of a camera at `eye` that sees `target` in its middle, `up` pointing up in the image.

    Raises:
        ValueError: eye and target coincide. Looking straight along `up`, another up direction is taken.
    """
    eye, target, up = (np.asarray(v, np.float64) for v in (eye, target, up))
    forward = target - eye
    length = np.linalg.norm(forward)
    if not length > 0:
        raise ValueError(f"eye and target coincide at {eye.tolist()}")
    forward = forward / length
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9 * max(float(np.linalg.norm(up)), 1e-30):
        right = np.cross(forward, [0.0, 0.0, -1.0] if abs(forward[2]) < 0.9 else [1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    return affine(R, -R @ eye)


def orbit_camera(
    target: Vector, distance: float | int, azimuth: float | int, elevation: float | int, size: tuple[int, int],
    fov: float | int = 0.61,
) -> Camera:  # fmt: skip
    """Camera on a sphere round `target`; azimuth 0 looks at the chest (from +z), growing towards +x; radians.

    `fov` is the vertical field of view, radians: 35 degrees.
    """
    target = np.asarray(target, np.float64)
    return Camera(pinhole(size, fov), look_at(target + distance * direction(azimuth, elevation), target), size)


def direction(azimuth: float | int, elevation: float | int) -> Float[Array, "3"]:
    """Unit vector; azimuth 0 is +z, growing towards +x; radians."""
    flat = np.cos(elevation)
    return np.array([np.sin(azimuth) * flat, np.sin(elevation), np.cos(azimuth) * flat])


def project(camera: Camera, points: Float[Array, "n 3"]) -> tuple[Float[Array, "n 2"], Float[Array, "n"]]:
    """Pixel positions and depths (metres along the optical axis) of world points, distortion included.

    Points at depth <= 0 are behind the camera; their pixels are meaningless, as their depth shows.
    """
    local = points @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    depth = local[:, 2]
    safe = np.where(np.abs(depth) > 1e-12, depth, 1e-12)
    x, y = local[:, 0] / safe, local[:, 1] / safe
    if camera.distortion.any():
        x, y = _distorted(x, y, camera.distortion)
    u = camera.K[0, 0] * x + camera.K[0, 1] * y + camera.K[0, 2]
    v = camera.K[1, 1] * y + camera.K[1, 2]
    return np.stack([u, v], 1), depth


def pixel_rays(
    camera: Camera, pixels: Float[Array, "n 2"] | None = None
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Origins and unit directions, world, of the rays through `pixels` (default: every pixel centre, row by row)."""
    if pixels is None:
        width, height = camera.size
        pixels = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), -1).reshape(-1, 2)
    K = camera.K
    y = (pixels[:, 1] - K[1, 2]) / K[1, 1]
    x = (pixels[:, 0] - K[0, 2] - K[0, 1] * y) / K[0, 0]
    # fixed-point inverse of the distortion; contracts for every lens one can buy
    if camera.distortion.any():
        x0, y0 = x, y
        for _ in range(20):
            dx, dy = _distorted(x, y, camera.distortion)
            x, y = x + (x0 - dx), y + (y0 - dy)
    directions = np.stack([x, y, np.ones_like(x)], 1) @ camera.camera_from_world[:3, :3]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.broadcast_to(camera.eye, directions.shape).copy(), directions


def _distorted(x: Array, y: Array, d: Array) -> tuple[Array, Array]:
    r2 = x * x + y * y
    radial = 1 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))
    return (
        x * radial + 2 * d[2] * x * y + d[3] * (r2 + 2 * x * x),
        y * radial + d[2] * (r2 + 2 * y * y) + 2 * d[3] * x * y,
    )


def view_from_world(camera: Camera) -> Float[Array, "4 4"]:
    """The camera's frame as OpenGL has it: +y up, looking down -z."""
    return np.diag([1.0, -1.0, -1.0, 1.0]) @ camera.camera_from_world


def clip_from_view(camera: Camera, near: float, far: float) -> Float[Array, "4 4"]:
    """OpenGL projection that puts a point on exactly the pixel that `project` gives (distortion left out).

    Window coordinates count from the bottom; images here have row 0 at the top, so rows are flipped when read.
    """
    (fx, skew, cx), (_, fy, cy), _ = camera.K
    width, height = camera.size
    out = np.zeros((4, 4))
    out[0, :3] = 2 * fx / width, -2 * skew / width, 1 - 2 * cx / width
    out[1, 1], out[1, 2] = 2 * fy / height, 2 * cy / height - 1
    out[2, 2], out[2, 3] = -(far + near) / (far - near), -2 * far * near / (far - near)
    out[3, 2] = -1
    return out


def write_camera(path: Path | str, camera: Camera) -> None:
    arrays = {"K": camera.K, "camera_from_world": camera.camera_from_world, "distortion": camera.distortion}
    write_json(path, {"size": list(camera.size)} | {name: array.tolist() for name, array in arrays.items()})


def read_camera(path: Path | str) -> Camera:
    """Read a camera file: {"size", "K", "camera_from_world", "distortion"}.

    Raises:
        AssetError: the file is not JSON, a field is absent, misshapen or does not make a camera.
    """
    return camera_from_json(str(path), read_json_object(path, "a camera file", most=MAX_BYTES))


def camera_from_json(place: str, content: dict[str, Any]) -> Camera:
    """The camera of such an object; `place` names it in messages."""
    absent = {"size", "K", "camera_from_world"} - content.keys()
    if absent:
        raise AssetError(f"{place}: no {sorted(absent)}; it has {sorted(key[:40] for key in content)[:20]}")
    distortion = content.get("distortion", [0.0] * 5)
    return checked_camera(place, content["K"], content["camera_from_world"], content["size"], distortion)


def write_cameras(path: Path | str, cameras: Sequence[Camera]) -> None:
    """Write cameras.npz of a capture: K (N,3,3), camera_from_world (N,4,4), size (2,), distortion (N,5)."""
    K, pose, size, distortion = zip(*((c.K, c.camera_from_world, c.size, c.distortion) for c in cameras), strict=True)
    with whole_file(path) as file:
        np.savez(file, K=K, camera_from_world=pose, size=size[0], distortion=distortion)


def read_cameras(path: Path | str, frames: int | None = None) -> list[Camera]:
    """Read cameras.npz of a capture; one camera may serve all `frames`.

    Raises:
        AssetError: a field is absent, misshapen, not finite, the focal length is not positive, or cameras are too few.
    """
    fields = read_npz(path, "cameras", ("K", "camera_from_world", "size"), ("distortion",))
    K, pose = np.atleast_1d(fields["K"]), np.atleast_1d(fields["camera_from_world"])
    distortion = np.atleast_1d(fields.get("distortion", np.zeros((len(K), 5))))
    if not len(K) == len(pose) == len(distortion) or len(K) == 0:
        found = f"{len(K)}, {len(pose)}, {len(distortion)}"
        raise AssetError(f"{path}: K, camera_from_world and distortion should be equally many, are {found}")
    if len(K) not in (1, frames or len(K)):
        raise AssetError(f"{path}: should hold 1 or {frames} cameras, holds {len(K)}")
    size, count = fields["size"], range(len(K))
    cameras = [checked_camera(f"{path}, camera {i}", K[i], pose[i], size, distortion[i]) for i in count]
    return cameras * frames if frames is not None and len(K) == 1 else cameras


def checked_camera(place: str, K: object, pose: object, size: object, distortion: object) -> Camera:
    """A camera of numbers from outside; `place` names file and camera in messages.

    Raises:
        AssetError: a number is absent or not finite, a focal length not positive, a rotation not one.
    """
    arrays = {}
    for name, given, shape in [("K", K, (3, 3)), ("camera_from_world", pose, (4, 4)), ("distortion", distortion, (5,)),
                               ("size", size, (2,))]:  # fmt: skip
        shown = short(given.tolist() if isinstance(given, Array) and given.size < 40 else given, 60)
        try:
            array = np.asarray(given, np.float64)
        except (TypeError, ValueError, OverflowError):
            raise AssetError(f"{place}: {name} should be numbers of shape {shape}, is {shown}") from None
        if array.shape != shape or not np.isfinite(array).all():
            raise AssetError(f"{place}: {name} should be finite and of shape {shape}, is {shown}")
        most = FARTHEST if name == "camera_from_world" else LARGEST
        if not (np.abs(array) < most).all():
            raise AssetError(f"{place}: {name} should be below {most:g}, is {shown}")
        arrays[name] = array
    K_, pose_, size_, R = arrays["K"], arrays["camera_from_world"], arrays["size"], arrays["camera_from_world"][:3, :3]
    if not (K_[0, 0] > 0 and K_[1, 1] > 0):
        raise AssetError(f"{place}: focal length should be positive, is {K_[0, 0]:g}, {K_[1, 1]:g}")
    if K_[1, 0] != 0 or (K_[2] != [0, 0, 1]).any():
        raise AssetError(f"{place}: K should be [fx s cx; 0 fy cy; 0 0 1], its lower rows are {K_[1:].tolist()}")
    if (pose_[3] != [0, 0, 0, 1]).any():
        raise AssetError(f"{place}: camera_from_world should end in the row 0 0 0 1, ends in {pose_[3].tolist()}")
    if not (np.abs(R @ R.T - np.eye(3)).max() < 1e-4 and np.linalg.det(R) > 0):
        raise AssetError(f"{place}: camera_from_world should hold a rotation; R Rᵀ differs from 1 or mirrors")
    if not (size_ >= 1).all() or not (size_ <= 65536).all() or (size_ != np.round(size_)).any():
        raise AssetError(f"{place}: size should be two whole numbers from 1 to 65536, is {size_.tolist()}")
    return Camera(K_, pose_, (int(size_[0]), int(size_[1])), arrays["distortion"])
