"""Keypoints of a video by MediaPipe, where it is installed and the user has its model files.

Its results are written as avatar/motion/landmark_file.py has them, and read back like any other file.
"""

import importlib
import importlib.util
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from command.errors import AssetError
from files.whole import whole_file

# each person's points
People = Sequence[Sequence[Any]]

MODELS = {"pose": "pose_landmarker*.task", "hand": "hand_landmarker*.task", "face": "face_landmarker*.task"}
INSTALL = "pip install mediapipe"


def model_files(folder: Path | None) -> dict[str, Path]:
    """The three model files in a folder.

    Raises:
        AssetError: MediaPipe is not installed, no folder is given, or a model is not in it.
    """
    if importlib.util.find_spec("mediapipe") is None:
        raise AssetError(f"--keypoints auto: finds keypoints with MediaPipe, which is not installed; {INSTALL}")
    if folder is None:
        raise AssetError(f"--keypoints auto: --models DIR should hold MediaPipe's {', '.join(MODELS.values())}")
    found = {kind: sorted(folder.glob(pattern)) for kind, pattern in MODELS.items()}
    absent = [MODELS[kind] for kind, files in found.items() if not files]
    if absent:
        raise AssetError(f"{folder}: expected MediaPipe's model files, found no {', '.join(absent)}")
    return {kind: files[0] for kind, files in found.items()}


def detect(
    path: Path, pictures: Iterable[tuple[float, UInt8[Array, "height width 3"]]], models: dict[str, Path]
) -> None:
    """Write the landmarks of pictures, each with its time in seconds, to `path`."""
    mp: Any = importlib.import_module("mediapipe")
    from mediapipe.tasks.python import BaseOptions, vision

    kinds: dict[str, tuple[Any, Any, dict[str, int]]] = {
        "pose": (vision.PoseLandmarker, vision.PoseLandmarkerOptions, {"num_poses": 2}),
        "hand": (vision.HandLandmarker, vision.HandLandmarkerOptions, {"num_hands": 2}),
        "face": (vision.FaceLandmarker, vision.FaceLandmarkerOptions, {"num_faces": 1}),
    }
    mode = vision.RunningMode.VIDEO
    finders = {
        kind: finder.create_from_options(
            options(base_options=BaseOptions(model_asset_path=str(models[kind])), running_mode=mode, **number)
        )
        for kind, (finder, options, number) in kinds.items()
    }
    frames, size = [], (1, 1)
    try:
        for time, picture in pictures:
            size = (picture.shape[1], picture.shape[0])
            image = mp.Image(image_format=mp.ImageFormat.SRGB, data=np.ascontiguousarray(picture))
            at = round(1000 * time)
            pose, hands, face = (finders[kind].detect_for_video(image, at) for kind in ("pose", "hand", "face"))
            labels = [categories[0].category_name for categories in hands.handedness]
            frames.append(frame_json(pose.pose_landmarks, hands.hand_landmarks, labels, face.face_landmarks))
    finally:
        for finder in finders.values():
            finder.close()
    with whole_file(path, "w") as file:
        json.dump({"image_width": size[0], "image_height": size[1], "frames": frames}, file)


def frame_json(poses: People, hands: People, labels: Sequence[str], faces: People) -> dict:
    """One frame of avatar/motion/landmark_file.py; points are objects with x, y, z and, of a pose, visibility."""
    rows = lambda points: [{"x": float(p.x), "y": float(p.y), "z": float(p.z)} for p in points]
    out: dict[str, Any] = {}
    if poses:
        out["pose_landmarks"] = [
            [row | {"visibility": float(p.visibility)} for row, p in zip(rows(pose), pose)] for pose in poses
        ]
    for hand, label in zip(hands, labels):
        if poses:
            out[f"{_side(hand, poses[0])}_hand_landmarks"] = rows(hand)
        else:
            # the reader knows by how fingers bend, and where that is not clear by the label
            out.setdefault("hand_landmarks", []).append(rows(hand))
            out.setdefault("handedness", []).append([{"category_name": label}])
    if faces:
        out["face_landmarks"] = rows(faces[0])
    return out


def _side(hand: Sequence[Any], pose: Sequence[Any]) -> str:
    """Left or right: that of the body's wrist nearer to the hand's."""
    wrists = {"left": pose[15], "right": pose[16]}
    return min(wrists, key=lambda side: float(np.hypot(hand[0].x - wrists[side].x, hand[0].y - wrists[side].y)))
