"""Opening keypoints: a file or a folder with a file a frame goes to the adapter that knows it."""

from pathlib import Path

from avatar.motion.landmark_file import is_mediapipe, read_landmarks
from avatar.motion.read import frame_files
from capture.keypoints.coco_wholebody import is_wholebody, wholebody_keypoints
from capture.keypoints.mediapipe import mediapipe_keypoints
from capture.keypoints.openpose import is_openpose, openpose_keypoints
from capture.keypoints.record import Keypoints
from command.errors import AssetError
from files.input_file import read_json

WHAT = "keypoints (OpenPose, COCO-WholeBody, MediaPipe)"


def read_keypoints(path: Path | str, *, size: tuple[int, int] | None = None) -> Keypoints:
    """The keypoints of one video: OpenPose JSON, COCO-WholeBody JSON, or MediaPipe's landmarks, by their content.

    A folder's files are frames in the order of their names (numbers count as numbers). `size` is the pictures', for
    formats in parts of it.

    Raises:
        AssetError: none of these, or what the adapter refuses; file, field and frame are named.
    """
    path = Path(path)
    files = frame_files(path, ".json", WHAT) if path.is_dir() else [path]
    first = read_json(files[0], WHAT)
    if is_openpose(first) or is_wholebody(first):
        frames = [(file, first if k == 0 else read_json(file, WHAT)) for k, file in enumerate(files)]
        return (openpose_keypoints if is_openpose(first) else wholebody_keypoints)(frames)
    if is_mediapipe(first):
        if len(files) > 1:
            raise AssetError(f"{path}: expected all frames of MediaPipe in one file, found {len(files)} files")
        frames, facts = read_landmarks(files[0], [])
        return mediapipe_keypoints(files[0], frames, facts, size)
    raise AssetError(f"{files[0]}: expected {WHAT}, found JSON of another kind")
