"""COLMAP models: cameras and the poses of registered images, text or binary (Schoenberger and Frahm 2016).

    cameras.txt   CAMERA_ID MODEL WIDTH HEIGHT PARAMS...
    images.txt    IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of points, which may be empty
    cameras.bin   count u64; id u32, model i32, width u64, height u64, parameters f64 ...
    images.bin    count u64; id u32, q 4 f64, t 3 f64, camera u32, name to a zero byte, count u64, points 24 bytes each

x_camera = R(q) x_model + t, q = w x y z; pixel centres at .5, as ours. The model has a frame and a unit of its own.
Counts in binary files are checked against the bytes that are there before anything is made of them.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
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


# number, model, width, height and parameters; name, number of the camera, quaternion and translation
LensRow = tuple[int, str, int, int, tuple[float, ...]]
ImageRow = tuple[str, int, tuple[float, ...], tuple[float, ...]]


class Lens(NamedTuple):
    """Intrinsics of one COLMAP camera."""

    K: Array
    distortion: Array
    size: tuple[int, int]


def read_colmap(folder: Path | str) -> dict[str, Camera]:
    """Camera of each registered image, by the image's name.

    Raises:
        AssetError: no model in the folder, a damaged or lying file, a camera model that is not read here.
    """
    folder = Path(folder)
    for suffix, lenses_in, images_in in (("bin", _binary_lenses, _binary_images), ("txt", _text_lenses, _text_images)):
        for inside in SUBFOLDERS:
            lens_file, image_file = (folder / inside / f"{name}.{suffix}" for name in ("cameras", "images"))
            if lens_file.is_file() and image_file.is_file():
                lenses = {row[0]: _lens(f"{lens_file}, camera {row[0]}", *row[1:]) for row in lenses_in(lens_file)}
                cameras: dict[str, Camera] = {}
                for name, camera, q, t in images_in(image_file):
                    place = f"{image_file}, image {name[:80]}"
                    if name in cameras:
                        raise AssetError(f"{place}: is there twice")
                    cameras[name] = _posed(place, lenses.get(camera), camera, q, t)
                return cameras
    raise AssetError(f"{folder}: expected a COLMAP model (cameras and images, .bin or .txt), found none")


def _lens(place: str, model: str, width: int, height: int, p: tuple[float, ...]) -> Lens:
    expected = dict(MODELS).get(model)
    if model not in READ:
        raise AssetError(
            f"{place}: camera model should be one of {', '.join(READ)}, is {str(model)[:40]}; undistort with "
            "`colmap image_undistorter` first"
        )
    if len(p) != expected:
        raise AssetError(f"{place}: {model} has {expected} parameters, found {len(p)}")
    d = np.zeros(5)
    if model in ("PINHOLE", "OPENCV"):
        fx, fy, cx, cy = p[:4]
        d[: len(p) - 4] = p[4:]  # k1 k2 p1 p2, in OpenCV's order
    else:
        fx = fy = p[0]
        cx, cy = p[1:3]
        d[: len(p) - 3] = p[3:]  # k, or k1 k2
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    checked_camera(place, K, np.eye(4), (width, height), d)  # names the camera, not each of its images
    return Lens(K, d, (width, height))


def _posed(place: str, lens: Lens | None, camera: int, q: tuple[float, ...], t: tuple[float, ...]) -> Camera:
    if lens is None:
        raise AssetError(f"{place}: no camera {camera} in the cameras file")
    w, x, y, z = q
    length = float(np.sqrt(w * w + x * x + y * y + z * z))
    if not 0.99 < length < 1.01:
        raise AssetError(f"{place}: the quaternion should have length 1, has {length:.4g}")
    pose = np.eye(4)
    pose[:3, :3] = matrix_from_quaternion(np.array([x, y, z, w]) / length)
    pose[:3, 3] = t
    return checked_camera(place, lens.K, pose, lens.size, lens.distortion)


# text


def _lines(path: Path) -> list[str]:
    try:
        text = read_bytes(path, "a COLMAP model", most=MAX_BYTES).decode("utf-8")
    except UnicodeDecodeError:
        raise AssetError(f"{path}: expected a COLMAP text file, found bytes that are no text") from None
    return [line for line in text.splitlines() if not line.startswith("#")]


def _text_lenses(path: Path) -> Iterator[LensRow]:
    for line in _lines(path):
        words = line.split()
        if not words:
            continue
        try:
            number, model, width, height = int(words[0]), words[1], int(words[2]), int(words[3])
            parameters = tuple(float(word) for word in words[4:16])
        except (ValueError, IndexError):
            raise AssetError(f"{path}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, found {line[:60]!r}") from None
        yield number, model, width, height, parameters


def _text_images(path: Path) -> Iterator[ImageRow]:
    lines = _lines(path)
    while lines and not lines[-1].strip() and len(lines) % 2:
        lines.pop()
    # every second line holds points, and may be empty
    for line in lines[::2]:
        words = line.split(maxsplit=9)
        try:
            numbers = [float(word) for word in words[1:8]]
            camera, name = int(words[8]), words[9].strip()
        except (ValueError, IndexError):
            raise AssetError(
                f"{path}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME in every second line, found "
                f"{line[:60]!r}"
            ) from None
        yield name, camera, tuple(numbers[:4]), tuple(numbers[4:])


# binary


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


def _binary_lenses(path: Path) -> Iterator[LensRow]:
    file = _Bytes(path)
    for _ in range(file.count(48, "cameras")):
        number, model, width, height = file.take("<IiQQ")
        place = f"{path}, camera {number}"
        if not 0 <= model < len(MODELS):
            raise AssetError(f"{place}: camera model should be 0 to {len(MODELS) - 1}, is {model}")
        name, parameters = MODELS[model]
        if max(width, height) > 65536:
            raise AssetError(f"{place}: size should be at most 65536 pixels, is {width} x {height}")
        yield number, name, width, height, file.take(f"<{parameters}d")
    file.end()


def _binary_images(path: Path) -> Iterator[ImageRow]:
    file = _Bytes(path)
    for _ in range(file.count(73, "images")):
        _, *q, x, y, z, camera = file.take("<I4d3dI")
        yield file.name(), camera, tuple(q), (x, y, z)
        points = file.count(24, "points")
        file.at += 24 * points
    file.end()
