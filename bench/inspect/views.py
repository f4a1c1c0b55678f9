"""Where one stands to look: the whole person from front and back, the head, the hands."""

import numpy as np
from jaxtyping import Float, UInt8

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, orbit_camera
from avatar.skeleton import JOINTS, joint_transforms

# metres: far, so that lengths in the middle and at the edge compare
DISTANCE = 4.0
MARGIN = 1.06


def standard_views(avatar: Avatar, size: int) -> dict[str, Camera]:
    """Front and back at `size`, then at half of it the head from front and side and each hand from above."""
    points = avatar.levels[0].positions.astype(np.float64)
    low, high = points.min(0), points.max(0)
    middle, across = (low + high) / 2, float((high - low)[:2].max())
    joints = _joints(avatar)
    face, height = _face(avatar)
    views = {
        "front": _camera(middle, 0.0, 0.0, across, size),
        "back": _camera(middle, np.pi, 0.0, across, size),
        "head": _camera(face, 0.35, 0.05, height, size // 2),
        "head, side": _camera(face, 1.5, 0.05, height, size // 2),
    }
    for side in ("left", "right"):
        wrist, tip = joints[JOINTS.index(f"{side}_wrist")], joints[JOINTS.index(f"{side}_middle3")]
        length = float(np.linalg.norm(tip - wrist))
        target = wrist + 0.6 * (tip - wrist)
        views[f"{side} hand"] = _camera(target, 0.0, 1.15, 1.5 * length, size // 2)
    return views


def face_views(avatar: Avatar, size: int) -> dict[str, Camera]:
    """The face, filling the picture: from the front, and from a little to either side."""
    face, height = _face(avatar)
    turns = {"face": 0.0, "face, from its left": 0.7, "face, from its right": -0.7}
    return {name: _camera(face, azimuth, 0.0, height - 0.02, size) for name, azimuth in turns.items()}


def _joints(avatar: Avatar) -> Float[np.ndarray, "52 3"]:
    return joint_transforms(avatar.canonical_pose, avatar.joint_positions.astype(np.float64))[:, :3, 3]


def _face(avatar: Avatar) -> tuple[Float[np.ndarray, "3"], float]:
    """Middle of the head and the height of a picture of it, metres."""
    points = avatar.levels[0].positions.astype(np.float64)
    head = _joints(avatar)[JOINTS.index("head")]
    above = points[(points[:, 1] > head[1]) & (np.abs(points[:, 0] - head[0]) < 0.2)]
    top = float(above[:, 1].max()) if len(above) else float(head[1]) + 0.2
    return np.array([head[0], (head[1] - 0.06 + top) / 2, head[2]]), top - float(head[1]) + 0.10


def _camera(target: np.ndarray, azimuth: float, elevation: float, height: float, size: int) -> Camera:
    fov = 2 * np.arctan(0.5 * MARGIN * height / DISTANCE)
    return orbit_camera(target, DISTANCE, azimuth, elevation, (size, size), fov)


def strip(pictures: list[UInt8[np.ndarray, "_ _ 3"]]) -> UInt8[np.ndarray, "_ _ 3"]:
    """Front, back, and the four small views in a square, side by side."""
    front, back, *small = pictures
    square = np.vstack([np.hstack(small[:2]), np.hstack(small[2:])])
    return np.hstack([front, back, square])
