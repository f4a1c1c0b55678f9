"""MediaPipe's landmarks in the picture (avatar/motion/landmark_file.py has the files): pose of 33 points, hands of 21.

Its coordinates are parts of the picture, so the size has to be known: from the file, or given. A point of the body has
its visibility for confidence; one of a hand has 1, since MediaPipe gives it none. The face's mesh is left out.
"""

from pathlib import Path

import numpy as np

from avatar.errors import AssetError
from avatar.motion.landmark_file import Frame, Told
from capture.keypoints.record import SIDES, Keypoints, hand_points, keypoints_of

Array = np.ndarray

# of the 33; None: a point that no other detector has, or that its hand's own points are better for
POSE: tuple[str | None, ...] = (
    "nose", None, "left_eye", None, None, "right_eye", None, "left_ear", "right_ear", None, None,
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    None, None, None, None, None, None, "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "left_heel", "right_heel", "left_big_toe", "right_big_toe",
)  # fmt: skip
USED = [k for k, name in enumerate(POSE) if name]
NAMES = (*(name for name in POSE if name), *hand_points("left"), *hand_points("right"))


def mediapipe_keypoints(
    path: Path, frames: list[Frame], told: Told, size: tuple[int, int] | None, notes: list[str]
) -> Keypoints:
    """The record of frames of landmarks; `size` is the pictures' where the file does not tell it.

    Raises:
        AssetError: the size is not known, or only world landmarks are there, which are not in the picture.
    """
    if told.width is not None and told.height is not None:
        size = (round(told.width), round(told.height))
    if size is None:
        raise AssetError(f"{path}: landmarks are parts of a picture whose size is not told (image_width, image_height)")
    rows = np.zeros((len(frames), len(NAMES), 3))
    for k, frame in enumerate(frames):
        if frame.pose is not None:
            visible = frame.pose[USED, 3]
            if (visible < 0).any() or (visible > 1).any():
                visible = 1 / (1 + np.exp(-np.clip(visible, -50, 50)))
            rows[k, : len(USED), :2] = frame.pose[USED, :2] * size
            rows[k, : len(USED), 2] = np.where(np.isfinite(visible), visible, 1.0)
        for n, side in enumerate(SIDES):
            if side in frame.hands and not frame.hands[side][1]:
                first = len(USED) + 21 * n
                rows[k, first : first + 21, :2] = frame.hands[side][0][:, :2] * size
                rows[k, first : first + 21, 2] = 1.0
    if not rows[:, :, 2].any():
        raise AssetError(f"{path}: no pose_landmarks or hand landmarks in the picture in {len(frames)} frames")
    notes.append("confidence of hands' points: 1 where the hand was found")
    return keypoints_of(NAMES, rows, size, notes)
