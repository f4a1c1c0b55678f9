"""MediaPipe's landmarks in a file: frames of 33 points of the body and 21 of each hand, as text or JSON of many shapes.

A frame is an object with some of these, under these names, the same in camelCase, or without "landmarks" or "list":

    pose_world_landmarks       metres from the middle of the hips
    pose_landmarks             x, y in parts of the picture's width and height, z as x
    left_hand_landmarks, left_hand_world_landmarks, right_hand_...
    hand_landmarks             with handedness
    face_landmarks             468 or 478, x and y as of the pose (for keypoints alone: no motion comes of them)
    landmarks                  33 or 21, these with classifications

A landmark is {"x", "y", "z", "visibility"} or a row of numbers; a list of them may stand in {"landmark": [...]}, be
flat (3 or 4 numbers a point), or stand in a list of people, of whom the largest is taken. A file holds one frame, a
list of frames, or {"frames": [...]} with "fps", "image_width" and "image_height" where they are known; a folder holds
one frame a file, in the order of the names; .jsonl one frame a line; .pbtxt is protobuf's text format.
"""

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.errors import AssetError
from avatar.input_file import MAX_JSON_BYTES, name_order, parse_json, read_bytes, read_json
from avatar.motion.landmark_pose import BODY_POINTS, HAND_POINTS, curl_sign
from avatar.motion.protobuf_text import read_protobuf_text

Array = np.ndarray

WHAT = "landmarks of MediaPipe"
TEXT = (".pbtxt", ".prototxt", ".textproto")
MOST_FRAMES = 1_000_000
# of lists in lists: a list of people, each a list of landmarks
MAX_DEPTH = 4
# of a face, without and with irises
FACE_POINTS = (468, 478)
LARGEST = 1e5  # of a coordinate: pixels, parts of the picture, metres
# of curl_sign, beyond which it is certain which hand it is
CERTAIN = 0.1
# what people call the same thing, once letters are small and "landmarks" is left out
POSE, POSE_WORLD = ("pose", "body"), ("poseworld", "bodyworld", "pose3d")
HANDS = {"left": (("lefthand",), ("lefthandworld",)), "right": (("righthand",), ("righthandworld",))}
FACES = ("face", "multiface", "facemesh")
SEVERAL = (("hand", "multihand", "hands"), ("handworld", "multihandworld"))
ANY, ANY_WORLD = ("",), ("world",)
SIDES_OF = ("handedness", "handednesses", "multihandedness", "classifications")


class Told(NamedTuple):
    """What a file tells beside the points; None where it does not."""

    fps: float | None = None
    width: float | None = None
    height: float | None = None


@dataclass
class Frame:
    """One frame's points, as they are in the file; None where nothing was found."""

    pose: Float[Array, "33 4"] | None = None
    pose_world: Float[Array, "33 4"] | None = None
    # points, and whether they are metres rather than parts of the picture
    hands: dict[str, tuple[Float[Array, "21 4"], bool]] = field(default_factory=dict)
    face: Float[Array, "points 4"] | None = None


def is_mediapipe(content: Any) -> bool:
    """Whether parsed JSON looks like landmarks: some object near its top has a field of a known name."""
    for _ in range(4):
        if isinstance(content, list):
            content = next((item for item in content if item), None)
        elif isinstance(content, dict):
            if any(_known(key) for key in content):
                return True
            content = next(
                (value for key, value in content.items() if _plain(key) in ("frames", "results", "data")), None
            )
    return False


def read_landmarks(path: Path | str, notes: list[str]) -> tuple[list[Frame], Told]:
    """The frames of a file or folder, and what it tells beside them.

    Raises:
        AssetError: no landmarks, lists of other lengths than 33 or 21, numbers that are not finite. File, frame and
            field are named.
    """
    path = Path(path)
    told: dict[str, float] = {}
    frames = [_frame(place, content, notes) for place, content in _contents(path, told, notes)]
    if not any(f.pose is not None or f.pose_world is not None or f.hands for f in frames):
        raise AssetError(f"{path}: no landmarks of a body or a hand in {len(frames)} frames")
    return frames, Told(**told)


def _contents(path: Path, told: dict[str, float], notes: list[str]) -> list[tuple[str, Any]]:
    """What each frame holds, with its place for messages."""
    if path.is_dir():
        endings = (*TEXT, ".json")
        names = sorted((n for n in os.listdir(path) if n.lower().endswith(endings) and n[0] != "."), key=name_order)
        if not names:
            raise AssetError(f"{path}: expected {WHAT} ({', '.join(endings)}), found none")
        notes.append(f"frames: {len(names)} files in the order of their names, {names[0]} to {names[-1]}")
        found = [frame for name in names for frame in _contents(path / name, told, notes)]
    elif path.suffix.lower() in TEXT:
        found = [(str(path), read_protobuf_text(path, WHAT))]
    elif path.suffix.lower() == ".jsonl":
        lines = read_bytes(path, WHAT, most=MAX_JSON_BYTES).splitlines()
        found = [
            (f"{path}: line {k}", parse_json(line, f"{path}: line {k}", WHAT))
            for k, line in enumerate(lines, start=1)
            if line.strip()
        ]
    else:
        found = _json_frames(path, read_json(path, WHAT), told)
    if not 0 < len(found) <= MOST_FRAMES:
        raise AssetError(f"{path}: expected {WHAT}, 1 to {MOST_FRAMES} frames, found {len(found)}")
    return found


def _json_frames(path: Path, content: Any, told: dict[str, float]) -> list[tuple[str, Any]]:
    """The frames of one parsed JSON file; what else it tells goes to `told`."""
    if isinstance(content, dict):
        for place in (content, content.get("metadata"), content.get("video_info"), content.get("info")):
            if isinstance(place, dict):
                _take_told(path, place, told)
        inner = next(
            (
                v
                for k, v in content.items()
                if _plain(k) in ("frames", "results", "data", "", "sequence")
                and isinstance(v, list)
                and _frames_like(v)
            ),
            None,
        )
        if inner is None:
            return [(str(path), content)]
        content = inner
    if isinstance(content, list) and content and isinstance(content[0], dict):
        # some write the picture's size into every frame
        _take_told(path, content[0], told)
    if not isinstance(content, list):
        raise AssetError(f"{path}: expected {WHAT}, an object or a list, found a {type(content).__name__}")
    if content and all(_is_landmark(item) for item in content):
        # one frame: the list of its landmarks
        return [(str(path), {"landmarks": content})]
    return [
        (f"{path}: frame {k}", {"landmarks": item} if isinstance(item, list) else item)
        for k, item in enumerate(content)
    ]


def _frames_like(values: list[Any]) -> bool:
    """Whether a list holds frames (objects with fields of landmarks, or nothing) rather than landmarks."""
    return bool(values) and all(
        item is None or (isinstance(item, dict) and not _is_landmark(item)) for item in values
    ) and not all(item is None for item in values)  # fmt: skip


def _take_told(path: Path, place: dict[str, Any], told: dict[str, float]) -> None:
    for name, keys in (
        ("fps", ("fps", "framerate")),
        ("width", ("imagewidth", "width", "framewidth", "videowidth")),
        ("height", ("imageheight", "height", "frameheight", "videoheight")),
    ):
        for key, value in place.items():
            if _letters(key) in keys and value is not None:
                if type(value) not in (int, float) or not 0 < value < LARGEST:
                    raise AssetError(f"{path}: {key} should be a positive number, is {str(value)[:40]!r}")
                told[name] = float(value)


def _frame(place: str, content: Any, notes: list[str]) -> Frame:
    """The points of one frame."""
    out = Frame()
    if content is None:
        return out
    if not isinstance(content, dict):
        raise AssetError(f"{place}: expected {WHAT}, an object, found a {type(content).__name__}")
    if set(content) <= {"landmark"}:
        # a bare NormalizedLandmarkList
        content = {"landmarks": content}
    fields = {_plain(str(key)): (str(key), value) for key, value in content.items()}
    for name in SEVERAL[0]:
        # {"hands": {"left": [...], "right": [...]}}
        if name in fields and isinstance(fields[name][1], dict) and fields[name][1].keys() & {"left", "right"}:
            key, pair = fields.pop(name)
            fields |= {f"{side}hand": (f"{key}.{side}", pair.get(side)) for side in ("left", "right")}

    def people(names: tuple[str, ...]) -> list[Float[Array, "points 4"]]:
        found = [fields[name] for name in names if name in fields]
        return [points for key, value in found for points in _lists(f"{place}: {key}", value)]

    generic, generic_world = people(ANY), people(ANY_WORLD)
    for points in [*generic, *generic_world]:
        if len(points) not in (BODY_POINTS, HAND_POINTS):
            raise AssetError(
                f"{place}: landmarks should be {BODY_POINTS} of a body or {HAND_POINTS} of a hand, are {len(points)}"
            )
    pose = people(POSE) + [points for points in generic if len(points) == BODY_POINTS]
    world = people(POSE_WORLD) + [points for points in generic_world if len(points) == BODY_POINTS]
    for name, found in (("pose_landmarks", pose), ("pose_world_landmarks", world)):
        for points in found:
            if len(points) != BODY_POINTS:
                raise AssetError(f"{place}: {name} should be {BODY_POINTS} landmarks, are {len(points)}")
    best = 0
    if len(pose) > 1:
        best = int(np.argmax([np.prod(np.ptp(points[:, :2], axis=0)) for points in pose]))
        notes.append(f"people: {len(pose)} in a frame, the largest is read")
    out.pose = pose[best] if pose else None
    out.pose_world = world[min(best, len(world) - 1)] if world else None
    faces = people(FACES)
    for points in faces:
        if len(points) not in FACE_POINTS:
            raise AssetError(f"{place}: face_landmarks should be 468 or 478 landmarks, are {len(points)}")
    out.face = max(faces, key=lambda points: np.prod(np.ptp(points[:, :2], axis=0)), default=None)
    for side, (names, in_metres) in HANDS.items():
        for points, metric in [(p, False) for p in people(names)] + [(p, True) for p in people(in_metres)]:
            out.hands[side] = (_checked_hand(f"{place}: {side}_hand_landmarks", points), metric)
    several = people(SEVERAL[0]) + [points for points in generic if len(points) == HAND_POINTS]
    several_world = people(SEVERAL[1]) + [points for points in generic_world if len(points) == HAND_POINTS]
    labels = [label for name in SIDES_OF if name in fields for label in _labels(fields[name][1])]
    chosen = several_world if len(several_world) >= len(several) else several
    for k, points in enumerate(chosen):
        _checked_hand(f"{place}: hand_landmarks", points)
        side = _side(points, labels[k] if k < len(labels) else "", notes)
        if side not in out.hands:
            out.hands[side] = (points, chosen is several_world)
    return out


def _checked_hand(place: str, points: Float[Array, "points 4"]) -> Float[Array, "21 4"]:
    if len(points) != HAND_POINTS:
        raise AssetError(f"{place} should be {HAND_POINTS} landmarks, are {len(points)}")
    return points


def _lists(place: str, value: Any, depth: int = 0) -> list[Float[Array, "points 4"]]:
    """The lists of landmarks that a field holds: none, one, or one a person; x, y, z, visibility (NaN: not told)."""
    if isinstance(value, dict):
        if _is_landmark(value):
            return [_points(place, [value])]
        inner = [value[key] for key in ("landmark", "landmarks", "points") if key in value]
        return _lists(place, inner[0], depth + 1) if inner else []
    if value is None or value == []:
        return []
    if not isinstance(value, list) or depth > MAX_DEPTH:
        raise AssetError(f"{place} should be a list of landmarks, is {str(value)[:40]!r}")
    if all(type(v) in (int, float) for v in value):
        for count in (BODY_POINTS, HAND_POINTS):
            if len(value) in (3 * count, 4 * count):
                return [_points(place, np.reshape(value, (count, -1)).tolist())]
        raise AssetError(f"{place} should be 3 or 4 numbers for each of 33 or 21 points, is {len(value)} numbers")
    if _is_landmark(value[0]):
        return [_points(place, value)]
    return [points for item in value for points in _lists(place, item, depth + 1)]


def _is_landmark(item: Any) -> bool:
    if isinstance(item, dict):
        return "x" in item and "y" in item
    return isinstance(item, list) and 3 <= len(item) <= 5 and all(type(v) in (int, float) for v in item)


def _points(place: str, items: list[Any]) -> Float[Array, "points 4"]:
    """Rows of x, y, z and visibility."""
    if len(items) > 2000:
        raise AssetError(f"{place} should be at most 2000 landmarks, are {len(items)}")
    out = np.full((len(items), 4), np.nan)
    for k, item in enumerate(items):
        if not _is_landmark(item):
            raise AssetError(f"{place}: landmark {k} should have x, y and z, is {str(item)[:40]!r}")
        row = [item.get(key) for key in ("x", "y", "z", "visibility")] if isinstance(item, dict) else [*item, None][:4]
        for column, value in enumerate(row):
            if value is None and column == 3:
                continue
            # protobuf leaves a 0 out
            value = 0.0 if value is None and column == 2 else value
            if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < LARGEST:
                raise AssetError(
                    f"{place}: landmark {k}: {'xyzv'[column]} should be a finite number, is {str(value)[:40]!r}"
                )
            out[k, column] = value
    return out


def _labels(value: Any, depth: int = 0) -> list[str]:
    """ "left" and "right" of handedness, in the order of the hands."""
    if depth > MAX_DEPTH:
        return []
    if isinstance(value, str):
        return [value.lower()] if value.lower() in ("left", "right") else []
    if isinstance(value, dict):
        for key in ("label", "category_name", "categoryName", "display_name", "displayName"):
            if isinstance(value.get(key), str):
                return _labels(value[key])
        return [label for inner in value.values() for label in _labels(inner, depth + 1)][:1]
    if isinstance(value, list):
        return [label for item in value for label in _labels(item, depth + 1)]
    return []


def _side(points: Float[Array, "21 4"], label: str, notes: list[str]) -> str:
    """Which hand it is: by the side its fingers bend to where that is certain, else by its label.

    MediaPipe's labels of single hands are those of a mirrored picture in some of its versions.
    """
    bent = curl_sign(points[None, :, :3])
    shape = "right" if bent > 0 else "left"
    if abs(bent) > CERTAIN:
        if label and label != shape:
            notes.append(
                f"hands: one labelled {label} bends as a {shape} one, as mirrored pictures are labelled; {shape}"
            )
        return shape
    if not label:
        notes.append(f"hands: one without a label, taken for the {shape} one")
    return label or shape


def _letters(key: str) -> str:
    return re.sub(r"[^a-z0-9]", "", key.lower())


def _plain(key: str) -> str:
    """ "lefthand" of "left_hand_landmarks", "leftHandLandmarks", "left_hand", "left_hand_landmark_list"."""
    return re.sub(r"landmarks?|list|keypoints", "", _letters(key))


def _known(key: Any) -> bool:
    if not isinstance(key, str):
        return False
    known = {*POSE, *POSE_WORLD, *SEVERAL[0], *SEVERAL[1]}
    known |= {name for pair in HANDS.values() for names in pair for name in names}
    return _plain(key) in known or ("landmark" in _letters(key) and _plain(key) in ANY + ANY_WORLD)
