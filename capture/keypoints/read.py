"""Opening keypoints: a file or a folder with a file a frame goes to the adapter that knows it."""

from pathlib import Path

from avatar.motion.landmark_file import is_mediapipe, read_landmarks
from avatar.motion.read import frame_files
from capture.keypoints.mediapipe import mediapipe_keypoints
from capture.keypoints.openpose import is_openpose, openpose_keypoints
from capture.keypoints.record import Keypoints
from capture.keypoints.result_lists import is_result_list, result_keypoints
from command.errors import AssetError
from files.input_file import read_json

WHAT = "keypoints (OpenPose, COCO, MMPose, AlphaPose, MediaPipe)"


def read_keypoints(
    path: Path | str, *, size: tuple[int, int] | None = None, frames: int | None = None, like: str = ""
) -> Keypoints:
    """The keypoints of one video: OpenPose's JSON, lists of results, or MediaPipe's landmarks, by their content.

    A folder's files are frames in the order of their names (numbers count as numbers). `size` is the pictures', for
    formats in parts of it; `frames` how many they are, for those that leave empty ones out; `like` the order of points
    in the person's other films.

    Raises:
        AssetError: none of these, or what the adapter refuses; file, field and frame are named.
    """
    path = Path(path)
    files = frame_files(path, ".json", WHAT) if path.is_dir() else [path]
    read = [(file, read_json(file, WHAT)) for file in files]
    # a list of nobody may be the first
    first = next((content for _, content in read if content), read[0][1])
    if is_openpose(first):
        return openpose_keypoints(read, like)
    if is_result_list(first):
        return result_keypoints(read, like, frames)
    if is_mediapipe(first):
        if len(files) > 1:
            raise AssetError(f"{path}: expected all frames of MediaPipe in one file, found {len(files)} files")
        landmarks, facts = read_landmarks(files[0], [])
        return mediapipe_keypoints(files[0], landmarks, facts, size)
    raise AssetError(f"{files[0]}: expected {WHAT}, found JSON of another kind")
