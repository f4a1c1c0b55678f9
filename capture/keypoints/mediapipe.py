"""MediaPipe's landmarks in the picture (avatar/motion/landmark_file.py has the files): body of 33 points, hands, face.

Its coordinates are parts of the picture, so the size has to be known: from the file, or given. A point of the body has
its visibility for confidence; one of a hand or the face has 1, since MediaPipe gives it none. Of the face's mesh those
of its points are taken that lie where iBUG's 68 do.
"""

from pathlib import Path

import numpy as np

from avatar.motion.landmark_file import FilmFacts, Frame
from capture.keypoints.record import FACE, SIDES, Keypoints, check_count, hand_points, keypoints_of
from command.errors import AssetError

# names of the 33; None: a point that no other detector has, or that its hand's own points are better for
POSE: tuple[str | None, ...] = (
    "nose", None, "left_eye", None, None, "right_eye", None, "left_ear", "right_ear", None, None,
    "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    None, None, None, None, None, None, "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "left_heel", "right_heel", "left_big_toe", "right_big_toe",
)  # fmt: skip
USED = [k for k, name in enumerate(POSE) if name]
NAMES = (*(name for name in POSE if name), *hand_points("left"), *hand_points("right"), *FACE)
# points of the mesh: jaw, brows, nose, eyes, lips outside and inside, from the person's right to the left
MESH = (
    162, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 389,
    71, 63, 105, 66, 107, 336, 296, 334, 293, 301,
    168, 197, 5, 4, 75, 97, 2, 326, 305,
    33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,
    61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181,
    78, 82, 13, 312, 308, 317, 14, 87,
)  # fmt: skip


def mediapipe_keypoints(path: Path, frames: list[Frame], facts: FilmFacts, size: tuple[int, int] | None) -> Keypoints:
    """The record of frames of landmarks; `size` is the pictures' where the file does not have it.

    Raises:
        AssetError: the size is not known, or only world landmarks are there, which are not in the picture.
    """
    if facts.width is not None and facts.height is not None:
        size = (round(facts.width), round(facts.height))
    if size is None:
        raise AssetError(f"{path}: landmarks are parts of a picture of unknown size (image_width, image_height)")
    check_count(path, len(frames))
    rows = np.zeros((len(frames), len(NAMES), 3))
    for k, frame in enumerate(frames):
        if frame.pose is not None:
            visible = frame.pose[USED, 3]
            if (visible < 0).any() or (visible > 1).any():
                visible = 1 / (1 + np.exp(-np.clip(visible, -50, 50)))
            rows[k, : len(USED), :2] = frame.pose[USED, :2] * size
            rows[k, : len(USED), 2] = np.where(np.isfinite(visible), visible, 1.0)
        for n, side in enumerate(SIDES):
            if side in frame.hands:
                first = len(USED) + 21 * n
                rows[k, first : first + 21, :2] = frame.hands[side][:, :2] * size
                rows[k, first : first + 21, 2] = 1.0
        if frame.face is not None:
            rows[k, -len(FACE) :, :2] = frame.face[list(MESH), :2] * size
            rows[k, -len(FACE) :, 2] = 1.0
    if not rows[:, :, 2].any():
        raise AssetError(f"{path}: no pose_landmarks or hand landmarks in the picture in {len(frames)} frames")
    return keypoints_of(NAMES, rows, size, order="MediaPipe")
