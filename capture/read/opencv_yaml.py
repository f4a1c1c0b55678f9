"""EasyMocap's cameras: intri.yml and extri.yml, as OpenCV's FileStorage writes them.

    %YAML:1.0
    names:
       - "1"
    K_1: !!opencv-matrix
       rows: 3
       cols: 3
       dt: d
       data: [1180., 0., 960., ...]

Only the matrices are read: a key in the first column, its lines indented. In intri.yml
K_NAME (3,3) and dist_NAME (k1 k2 p1 p2 k3); in extri.yml Rot_NAME (3,3), or R_NAME (3,1) as axis-angle, and
T_NAME (3,1): x_camera = R x_world + T, metres. Pixel centres lie on whole numbers; ours at .5.
"""

import re
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from avatar.camera import Camera, checked_camera
from avatar.rotation import matrix_from_axis_angle
from command.errors import AssetError
from files.input_file import read_text

MAX_BYTES = 1 << 20
MAX_VALUES = 1024  # one matrix'

# a key in the first column, then lines that are indented
_MATRIX = re.compile(r"^([A-Za-z_][\w.\-]*):[ \t]*!!opencv-matrix[ \t]*\n((?:[ \t].*(?:\n|\Z))*)", re.MULTILINE)


def read_opencv_yaml(path: Path) -> dict[str, Array]:
    """Matrices of a FileStorage file; other entries are passed over.

    Raises:
        AssetError: absent, without matrices, or with one whose data do not fill its rows and columns.
    """
    text = read_text(path, "EasyMocap's cameras (OpenCV YAML)", most=MAX_BYTES)
    matrices: dict[str, Array] = {}
    for match in _MATRIX.finditer("\n".join(text.splitlines())):
        if match[1] in matrices:
            raise AssetError(f"{path}: {match[1]} is there twice")
        matrices[match[1]] = _matrix(path, match[1], match[2])
    if not matrices:
        raise AssetError(f"{path}: expected OpenCV YAML with matrices, found {text[:40]!r}")
    return matrices


def _matrix(path: Path, key: str, text: str) -> Array:
    sizes = {name: re.search(rf"\b{name}:\s*(\d{{1,6}})\b", text) for name in ("rows", "cols")}
    data = re.search(r"data:\s*\[([^\]]*)\]", text)
    if not all(sizes.values()) or data is None:
        raise AssetError(f"{path}: {key} should be a matrix with rows, cols and data")
    rows, cols = (int(match[1]) for match in sizes.values() if match)
    words = data[1].replace(",", " ").split()
    if len(words) > MAX_VALUES or rows * cols != len(words):
        raise AssetError(f"{path}: {key} should have {rows} x {cols} numbers, has {len(words)}")
    try:
        # .nan and .inf are no floats to Python either
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise AssetError(f"{path}: {key} should be finite numbers, is {data[1][:60]!r}")
    return values.reshape(rows, cols)


def read_easymocap_camera(folder: Path, name: str | None, size: tuple[int, int]) -> Camera:
    """The camera `name` of intri.yml and extri.yml in `folder`; None: the only one there is.

    Raises:
        AssetError: a file, matrix or name is absent, several cameras and none named, or numbers that make no
            camera (zero focal length, no rotation).
    """
    intrinsics, extrinsics = folder / "intri.yml", folder / "extri.yml"
    K_of = read_opencv_yaml(intrinsics)
    R_of = read_opencv_yaml(extrinsics)
    names = sorted(key[2:] for key in K_of if key.startswith("K_"))
    if not names:
        raise AssetError(f"{intrinsics}: no K_NAME; it has {sorted(K_of)[:12]}")
    if name not in names:
        if len(names) > 1:
            raise AssetError(f"{intrinsics}: expected camera {name!r}, the folder of its images, found {names[:12]}")
        name = names[0]
    K = _shaped(intrinsics, K_of, f"K_{name}", 9).reshape(3, 3)
    distortion = np.zeros(5)
    if f"dist_{name}" in K_of:
        given = K_of[f"dist_{name}"].ravel()
        if len(given) not in (4, 5):
            raise AssetError(f"{intrinsics}: dist_{name} should be k1 k2 p1 p2 and k3, is {len(given)} numbers")
        distortion[: len(given)] = given
    if f"Rot_{name}" in R_of:
        R = _shaped(extrinsics, R_of, f"Rot_{name}", 9).reshape(3, 3)
    else:
        R = matrix_from_axis_angle(_shaped(extrinsics, R_of, f"R_{name}", 3).reshape(3))
    T = _shaped(extrinsics, R_of, f"T_{name}", 3).reshape(3)
    return opencv_camera(f"{intrinsics} and extri.yml, camera {name}", K, R, T, size, distortion)


def opencv_camera(place: str, K: Array, R: Array, T: Array, size: tuple[int, int], distortion: Array) -> Camera:
    """A camera whose pixel centres lie on whole numbers, as one of ours; `place` begins what is refused."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, T
    return checked_camera(place, K + [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]], pose, size, distortion)


def _shaped(path: Path, matrices: dict[str, Array], key: str, count: int) -> Array:
    if key not in matrices:
        raise AssetError(f"{path}: no {key}; it has {sorted(matrices)[:12]}")
    if matrices[key].size != count:
        raise AssetError(f"{path}: {key} should be {count} numbers, is {matrices[key].shape}")
    return matrices[key]
