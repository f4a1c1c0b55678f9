"""Landmarks of the head: named pixels in two or more frames, triangulated in the head video's own frame.

    {"pixels": {"nose_tip": {"000003.png": [x, y], "000017.png": [x, y]}, ...},
     "vertices": {"my_freckle": 3071}}

x to the right, y down, pixels; (0, 0) is the corner of the picture, (.5, .5) the middle of its first pixel.
Names are those of `capture/read/places.py`; any other needs its vertex of the body model under "vertices".
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.camera import Camera, pixel_rays, project
from command.errors import AssetError
from files.input_file import read_json

MAX_BYTES = 1 << 22
LEAST = 6  # landmarks
# share of the picture's longer side: reprojection, root mean square over a landmark's frames
LARGEST_ERROR = 0.01
# degrees between the two rays that differ most: under it depth is a guess
LEAST_ANGLE = 3.0


def read_pixels(path: Path) -> tuple[dict[str, dict[str, Array]], dict[str, int]]:
    """Pixels by landmark and picture, and the vertices that the file names itself.

    Raises:
        AssetError: absent, not such a file, a pixel that is not two numbers.
    """
    content = read_json(path, "landmarks", most=MAX_BYTES)
    pixels = content.get("pixels") if isinstance(content, dict) else None
    vertices = content.get("vertices", {}) if isinstance(content, dict) else None
    if not isinstance(pixels, dict) or not isinstance(vertices, dict):
        raise AssetError(
            f'{path}: expected {{"pixels": {{name: {{picture: [x, y]}}}}}}, and "vertices" where names are new'
        )
    for name, index in vertices.items():
        if type(index) is not int or index < 0:
            raise AssetError(f"{path}: vertices.{name} should be the number of a vertex, is {str(index)[:40]}")
    return {name: _seen(path, name, frames) for name, frames in pixels.items()}, vertices


def _seen(path: Path, name: str, frames: Any) -> dict[str, Array]:
    if not isinstance(frames, dict):
        raise AssetError(f"{path}: pixels.{name} should be {{picture: [x, y]}}, is {str(frames)[:40]}")
    found = {}
    for picture, pixel in frames.items():
        pair = isinstance(pixel, list) and len(pixel) == 2
        if not (pair and all(type(v) in (int, float) and abs(v) < 1e6 for v in pixel)):
            raise AssetError(f"{path}: pixels.{name}.{picture} should be [x, y], is {str(pixel)[:40]}")
        found[picture] = np.array(pixel, np.float64)
    return found


def triangulated(place: str, cameras: list[Camera], pixels: Float[Array, "views 2"]) -> tuple[Float[Array, "3"], float]:
    """The point whose pictures lie nearest to `pixels`, and their distance in pixels, root mean square.

    First the linear solution (DLT, Hartley and Zisserman 2004, 12.2) on undistorted rays, u x (R X + t) = 0, each
    camera's rows weighted by its focal length; then least squares of the pixels themselves, lens included.

    Raises:
        AssetError: fewer than two views, rays within LEAST_ANGLE of each other, a point behind a camera, pixels
            that no point explains.
    """
    from scipy.optimize import least_squares

    if len(cameras) < 2:
        raise AssetError(f"{place} should be marked in at least 2 registered pictures, is in {len(cameras)}")
    rays = np.stack([pixel_rays(camera, pixel[None])[1][0] for camera, pixel in zip(cameras, pixels)])
    apart = float(np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1))))
    if apart < LEAST_ANGLE:
        raise AssetError(
            f"{place} should be marked in pictures from {LEAST_ANGLE:g} degrees apart or more, they are {apart:.2g} "
            "apart"
        )
    rows = []
    for camera, ray in zip(cameras, rays):
        local = camera.camera_from_world[:3, :3] @ ray
        x, y = local[:2] / local[2]
        P = camera.camera_from_world[:3]
        rows += [camera.K[0, 0] * (x * P[2] - P[0]), camera.K[1, 1] * (y * P[2] - P[1])]
    A = np.stack(rows)
    point = np.linalg.lstsq(A[:, :3], -A[:, 3], rcond=None)[0]
    point = least_squares(lambda at: _missed(cameras, pixels, at), point, method="lm", xtol=1e-14, ftol=1e-14).x
    depth = min(float(project(camera, point[None])[1][0]) for camera in cameras)
    if not depth > 0:
        raise AssetError(f"{place} should lie before its cameras, its pixels meet behind one")
    error = float(np.sqrt((_missed(cameras, pixels, point) ** 2).sum() / len(cameras)))
    limit = LARGEST_ERROR * max(max(camera.size) for camera in cameras)
    if not error <= limit:
        raise AssetError(
            f"{place} should be one place in all its pictures within {limit:.1f} pixels, its pixels are {error:.1f} "
            "from any"
        )
    return point, error


def _missed(cameras: list[Camera], pixels: Float[Array, "views 2"], point: Float[Array, "3"]) -> Array:
    return (np.concatenate([project(camera, point[None])[0] for camera in cameras]) - pixels).ravel()
