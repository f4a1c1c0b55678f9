"""COLMAP models: cameras and the poses of registered images, binary (Schoenberger and Frahm 2016).

    cameras.bin   count u64; id u32, model i32, width u64, height u64, parameters f64 ...
    images.bin    count u64; id u32, q 4 f64, t 3 f64, camera u32, name to a zero byte, count u64, points 24 bytes each

x_camera = R(q) x_model + t, q = w x y z; pixel centres at .5, as ours. The model has a frame and a unit of its own.
Counts are checked against the bytes that are there before anything is made of them.
"""

import math
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.camera import Camera, checked_camera
from avatar.rotation import matrix_from_quaternion
from command.errors import AssetError
from files.input_file import read_bytes

MAX_BYTES = 1 << 30  # a file's
MODELS = (  # name by number, parameters
    ("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8), ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4), ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12),
)  # fmt: skip
READ = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
SUBFOLDERS = ("", "0", "sparse/0", "sparse")


def read_colmap(folder: Path | str) -> dict[str, Camera]:
    """Camera of each registered image, by the image's name.

    Raises:
        AssetError: no model in the folder, a damaged or lying file, a camera model that is not read here.
    """
    folder = Path(folder)
    for inside in SUBFOLDERS:
        lenses, images = folder / inside / "cameras.bin", folder / inside / "images.bin"
        if lenses.is_file() and images.is_file():
            return _images(images, _lenses(lenses))
    raise AssetError(
        f"{folder}: expected a COLMAP model, cameras.bin and images.bin, found none (`colmap model_converter "
        "--output_type BIN` makes them of text)"
    )


def _lens(place: str, model: str, size: tuple[int, int], p: tuple[float, ...]) -> Camera:
    if model not in READ:
        raise AssetError(
            f"{place}: camera model should be one of {', '.join(READ)}, is {model}; undistort with "
            "`colmap image_undistorter` first"
        )
    d = np.zeros(5)
    if model in ("PINHOLE", "OPENCV"):
        fx, fy, cx, cy = p[:4]
        d[: len(p) - 4] = p[4:]  # k1 k2 p1 p2, in OpenCV's order
    else:
        fx = fy = p[0]
        cx, cy = p[1:3]
        d[: len(p) - 3] = p[3:]  # k, or k1 k2
    # names the camera, not each of its images
    return checked_camera(place, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), np.eye(4), size, d)


def _posed(place: str, lens: Camera | None, camera: int, q: Float[Array, "4"], t: Sequence[float]) -> Camera:
    """The camera of an image; `q` is x y z w."""
    if lens is None:
        raise AssetError(f"{place}: no camera {camera} in the cameras file")
    length = math.hypot(*q)
    if not 0.99 < length < 1.01:
        raise AssetError(f"{place}: the quaternion should have length 1, has {length:.4g}")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = matrix_from_quaternion(q / length), t
    return checked_camera(place, lens.K, pose, lens.size, lens.distortion)


class _Bytes:
    """Reads forward through a file that may lie about its counts."""

    def __init__(self, path: Path):
        self.path, self.data, self.at = path, read_bytes(path, "a COLMAP model", most=MAX_BYTES), 0

    def take(self, layout: str) -> tuple:
        size = struct.calcsize(layout)
        if self.at + size > len(self.data):
            raise AssetError(f"{self.path}: expected {size} bytes at byte {self.at}, the file ends at {len(self.data)}")
        values = struct.unpack_from(layout, self.data, self.at)
        self.at += size
        return values

    def count(self, least: int, what: str) -> int:
        """A count of items that take at least so many bytes each."""
        (count,) = self.take("<Q")
        if count * least > len(self.data) - self.at:
            raise AssetError(
                f"{self.path}: {count} {what} at byte {self.at - 8} should take {count * least} bytes, "
                f"{len(self.data) - self.at} are left"
            )
        return count

    def name(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + 4096)
        if end < 0:
            raise AssetError(f"{self.path}: expected a name that ends, at byte {self.at}")
        piece, self.at = self.data[self.at : end], end + 1
        return piece.decode("utf-8", "replace")

    def end(self) -> None:
        """Refuse bytes that are left over."""
        if self.at != len(self.data):
            raise AssetError(f"{self.path}: expected {self.at} bytes, found {len(self.data)}")


def _lenses(path: Path) -> dict[int, Camera]:
    """The cameras by their numbers, each at its own origin."""
    file, lenses = _Bytes(path), {}
    for _ in range(file.count(48, "cameras")):
        number, model, width, height = file.take("<IiQQ")
        place = f"{path}, camera {number}"
        if not 0 <= model < len(MODELS):
            raise AssetError(f"{place}: camera model should be 0 to {len(MODELS) - 1}, is {model}")
        name, parameters = MODELS[model]
        if max(width, height) > 65536:
            raise AssetError(f"{place}: size should be at most 65536 pixels, is {width} x {height}")
        lenses[number] = _lens(place, name, (width, height), file.take(f"<{parameters}d"))
    file.end()
    return lenses


def _images(path: Path, lenses: dict[int, Camera]) -> dict[str, Camera]:
    file, cameras = _Bytes(path), {}
    for _ in range(file.count(73, "images")):
        _, w, x, y, z, *t, camera = file.take("<I4d3dI")
        name = file.name()
        place = f"{path}, image {name[:80]}"
        if name in cameras:
            raise AssetError(f"{place}: is there twice")
        cameras[name] = _posed(place, lenses.get(camera), camera, np.array([x, y, z, w]), t)
        points = file.count(24, "points")
        file.at += 24 * points
    file.end()
    return cameras
