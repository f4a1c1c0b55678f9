"""MediaPipe's landmarks in a file: the results of its Python API as plain JSON, all frames in one file.

    {"frames": [dataclasses.asdict(result), ...], "fps": 30, "image_width": 1280, "image_height": 720}

The last three stand there where they are known. A frame in which nothing was found is null; else it has some of the
fields of PoseLandmarkerResult, HandLandmarkerResult, FaceLandmarkerResult and HolisticLandmarkerResult:

    pose_landmarks, pose_world_landmarks                33 points
    left_hand_landmarks, left_hand_world_landmarks      21 points, and the same of the right hand
    hand_landmarks, hand_world_landmarks, handedness    a list of hands
    face_landmarks                                      468 or 478 points (for keypoints alone: no motion comes of them)
    face_blendshapes                                    {"category_name": "jawOpen", "score": .3} of ARKit's shapes
    facial_transformation_matrixes                      4x4 in rows: the head, where there is no body

A landmark is {"x", "y", "z", "visibility"}, the last perhaps absent or null. World landmarks are metres, others parts
of the picture's width and height, z as x. A field holds one list of landmarks, or one a person, of whom the largest is
taken; of blend shapes and matrices the first.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeGuard

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.face_names import weights_of
from avatar.motion.landmark_pose import BODY_POINTS, HAND_POINTS, curl_sign
from avatar.rotation import nearest_rotation
from command.errors import AssetError
from files.input_file import read_json

WHAT = "landmarks of MediaPipe"
# an hour at 60 a second
MOST_FRAMES = 216_000
SCORES, MATRICES = "face_blendshapes", "facial_transformation_matrixes"
# a face's points, without and with irises
FACE_POINTS = (468, 478)
LARGEST = 1e5  # the largest coordinate: pixels, parts of the picture, metres
# the least size of curl_sign from which it is certain which hand it is
CERTAIN = 0.1
SIDES = ("left", "right")
# fields that hold lists of landmarks, and how many a list has
POINTS = {
    "pose_landmarks": (BODY_POINTS,),
    "pose_world_landmarks": (BODY_POINTS,),
    **{f"{side}_hand_{kind}": (HAND_POINTS,) for side in SIDES for kind in ("landmarks", "world_landmarks")},
    "hand_landmarks": (HAND_POINTS,),
    "hand_world_landmarks": (HAND_POINTS,),
    "face_landmarks": FACE_POINTS,
}


class FilmFacts(NamedTuple):
    """What a file says beside the points; None where it does not."""

    fps: float | None = None
    width: float | None = None
    height: float | None = None


@dataclass
class Frame:
    """One frame's points, as they are in the file; None where nothing was found."""

    pose: Float[Array, "33 4"] | None = None
    pose_world: Float[Array, "33 4"] | None = None
    # by side: parts of the picture, and metres
    hands: dict[str, Float[Array, "21 4"]] = field(default_factory=dict)
    hands_world: dict[str, Float[Array, "21 4"]] = field(default_factory=dict)
    face: Float[Array, "points 4"] | None = None
    # weights of avatar.face.SHAPES, and the head's rotation in axes like ours
    shapes: Float[Array, "52"] | None = None
    head: Float[Array, "3 3"] | None = None


def is_mediapipe(content: object) -> bool:
    """Whether parsed JSON holds frames of which the first that is not empty has a field of MediaPipe's results."""
    frames = content.get("frames") if isinstance(content, dict) else None
    first = next((frame for frame in frames if frame), None) if isinstance(frames, list) else None
    return isinstance(first, dict) and bool((POINTS.keys() | {SCORES}) & first.keys())


def read_landmarks(path: Path | str, notes: list[str]) -> tuple[list[Frame], FilmFacts]:
    """The frames of a file, and what it says beside them.

    Raises:
        AssetError: no landmarks, lists of other lengths than 33 or 21, numbers that are not finite. File, frame and
            field are named.
    """
    path = Path(path)
    content = read_json(path, WHAT)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not 0 < len(frames) <= MOST_FRAMES:
        raise AssetError(f'{path}: expected {WHAT}: an object with "frames", 1 to {MOST_FRAMES} of them')
    facts = [content.get(key) for key in ("fps", "image_width", "image_height")]
    for key, value in zip(("fps", "image_width", "image_height"), facts, strict=True):
        if value is not None and not (_number(value) and 0 < value < LARGEST):
            raise AssetError(f"{path}: {key} should be a positive number, is {str(value)[:40]!r}")
    read = [_frame(f"{path}: frame {k}", frame, notes) for k, frame in enumerate(frames)]
    bodiless = all(f.pose is None and f.pose_world is None and not f.hands and not f.hands_world for f in read)
    if bodiless and all(f.shapes is None for f in read):
        raise AssetError(f"{path}: no landmarks of a body or a hand in {len(read)} frames")
    return read, FilmFacts(*(None if value is None else float(value) for value in facts))


def _number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _frame(place: str, content: object, notes: list[str]) -> Frame:
    if content is None:
        return Frame()
    if not isinstance(content, dict):
        raise AssetError(f"{place}: expected {WHAT}, an object, found a {type(content).__name__}")
    found = {name: _people(f"{place}: {name}", content.get(name), counts) for name, counts in POINTS.items()}
    pose, world = found["pose_landmarks"], found["pose_world_landmarks"]
    best = 0
    if len(pose) > 1:
        best = int(np.argmax([_area(points) for points in pose]))
        notes.append(f"people: {len(pose)} in a frame, the largest is read")
    hands, in_metres = found["hand_landmarks"], found["hand_world_landmarks"]
    shapes = [*in_metres, *hands[len(in_metres) :]]
    sides = [_side(shape, _label(content.get("handedness"), k), notes) for k, shape in enumerate(shapes)]

    def by_side(kind: str) -> dict[str, Float[Array, "21 4"]]:
        """The first hand of each side; those of a field of its own side go before those of the list."""
        first: dict[str, Array] = {}
        own = [(side, points) for side in SIDES for points in found[f"{side}_hand_{kind}"]]
        for side, points in [*own, *zip(sides, found[f"hand_{kind}"], strict=False)]:
            first.setdefault(side, points)
        return first

    return Frame(
        pose=pose[best] if pose else None,
        pose_world=world[min(best, len(world) - 1)] if world else None,
        hands=by_side("landmarks"),
        hands_world=by_side("world_landmarks"),
        face=max(found["face_landmarks"], key=_area, default=None),
        shapes=_shapes(f"{place}: {SCORES}", content.get(SCORES)),
        head=_head(f"{place}: {MATRICES}", content.get(MATRICES)),
    )


def _first(value: object) -> list | None:
    """The first list of a list of lists, or the list itself; None: nothing was found."""
    if not isinstance(value, list) or not value:
        return None
    return value[0] if isinstance(value[0], list) and (not value[0] or not _number(value[0][0])) else value


def _shapes(place: str, value: object) -> Float[Array, "52"] | None:
    """Weights of a face's scores."""
    items = _first(value)
    if not items:
        return None
    scores: dict[str, float] = {}
    for item in items:
        name, score = (item.get("category_name"), item.get("score")) if isinstance(item, dict) else (None, None)
        if not (isinstance(name, str) and _number(score) and -LARGEST < score < LARGEST):
            raise AssetError(f"{place} should be objects of category_name and score, has {str(item)[:60]!r}")
        scores[name] = float(score)
    return weights_of(scores)


def _head(place: str, value: object) -> Float[Array, "3 3"] | None:
    """The rotation of a face's matrix, which maps the canonical face to the camera's space, y up."""
    rows = _first(value)
    if rows is None:
        return None
    if not all(isinstance(row, list) and len(row) == 4 and all(map(_number, row)) for row in rows) or len(rows) != 4:
        raise AssetError(f"{place} should be 4 rows of 4 numbers, is {str(rows)[:60]!r}")
    R = np.array([row[:3] for row in rows[:3]], np.float64)
    if not (np.abs(R).max() < LARGEST and np.linalg.det(R) > 1e-6):
        raise AssetError(f"{place} should be a rotation, is {str(rows)[:60]!r}")
    return nearest_rotation(R)


def _area(points: Float[Array, "points 4"]) -> float:
    """Of the box round the points in the picture."""
    return float(np.prod(np.ptp(points[:, :2], axis=0)))


def _people(place: str, value: object, counts: tuple[int, ...]) -> list[Float[Array, "points 4"]]:
    """The lists of landmarks of a field: none, one, or one a person."""
    if value is None or value == []:
        return []
    lists = value if isinstance(value, list) and isinstance(value[0], list) else [value]
    return [_points(place, items, counts) for items in lists]


def _points(place: str, items: object, counts: tuple[int, ...]) -> Float[Array, "points 4"]:
    """Rows of x, y, z and visibility (NaN: not in the file)."""
    if not isinstance(items, list):
        raise AssetError(f"{place} should be a list of landmarks, is {str(items)[:40]!r}")
    if len(items) not in counts:
        raise AssetError(f"{place} should be {' or '.join(map(str, counts))} landmarks, are {len(items)}")
    out = np.full((len(items), 4), np.nan)
    for k, item in enumerate(items):
        if not isinstance(item, dict):
            raise AssetError(f"{place}: landmark {k} should be an object with x, y and z, is {str(item)[:40]!r}")
        for column, name in enumerate(("x", "y", "z", "visibility")):
            value = item.get(name)
            if value is None and name == "visibility":
                continue
            if not (_number(value) and abs(value) < LARGEST):
                raise AssetError(f"{place}: landmark {k}: {name} should be a finite number, is {str(value)[:40]!r}")
            out[k, column] = value
    return out


def _label(handedness: object, number: int) -> str:
    """ "left" or "right": the first category of a hand; "" where the file does not have it."""
    for key in (number, 0):
        if not isinstance(handedness, list) or key >= len(handedness):
            return ""
        handedness = handedness[key]
    name = handedness.get("category_name") if isinstance(handedness, dict) else None
    return name.lower() if isinstance(name, str) and name.lower() in SIDES else ""


def _side(points: Float[Array, "21 4"], label: str, notes: list[str]) -> str:
    """Which hand it is: by the side its fingers bend to where that is certain, else by its label.

    MediaPipe's labels of single hands are those of a mirrored picture in some of its versions.
    """
    bent = curl_sign(points[None, :, :3])
    shape = "right" if bent > 0 else "left"
    if abs(bent) <= CERTAIN:
        if not label:
            notes.append(f"hands: one without a label, taken for the {shape} one")
        return label or shape
    if label and label != shape:
        notes.append(f"hands: one labelled {label} bends as a {shape} one, as mirrored pictures are labelled; {shape}")
    return shape
