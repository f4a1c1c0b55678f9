"""OpenPose's JSON: one file a frame (`..._000000000000_keypoints.json`), a body, hands of 21 and a face of 70 points.

Its pixels count from the middle of the first one, ours from its corner: half a pixel is added. A point with confidence
0 was not found (its place is then 0, 0). Of the face's 70 points the last two, the pupils, are left out.
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from capture.keypoints.orders import BODY_25, COUNTS, keypoints_of_people
from capture.keypoints.record import FACE, SIDES, Keypoints, hand_points, triples
from command.errors import AssetError

FACE_POINTS = 70
MORE = (*hand_points("left"), *hand_points("right"), *FACE)
NAMES = (*BODY_25, *MORE)


def is_openpose(content: Any) -> bool:
    return isinstance(content, dict) and isinstance(content.get("people"), list)


def openpose_keypoints(frames: list[tuple[Path, Any]], like: str) -> Keypoints:
    """The record of parsed frames, in order; `like` is the order of the person's other films, where it is known.

    Raises:
        AssetError: no frame of OpenPose, lists of other lengths, numbers that are not finite, no person in any frame.
    """
    pictures = []
    for path, content in frames:
        if not is_openpose(content):
            raise AssetError(f"{path}: expected a frame of OpenPose, an object with people")
        pictures.append([_person(f"{path}: people[{n}]", person) for n, person in enumerate(content["people"])])
    place = frames[0][0] if len(frames) == 1 else frames[0][0].parent
    bodies = [person["pose_keypoints_2d"] for _, content in frames for person in content["people"]]
    more = () if bodies and len(bodies[0]) > 3 * len(MORE) else MORE
    found = keypoints_of_people(place, pictures, like, more)
    if np.nanmax(found.pixels, initial=0) <= 1.5:
        raise AssetError(f"{frames[0][0]}: expected pixels, found parts of the picture (OpenPose's keypoint_scale 3)")
    return found


def _person(place: str, person: Any) -> Float[Array, "points 3"]:
    """The points of one person; lists that are absent or empty were not asked for, and BODY_135 needs none."""
    if not isinstance(person, dict):
        raise AssetError(f"{place} should be an object, is {str(person)[:40]!r}")
    out = [triples(f"{place}.pose_keypoints_2d", person.get("pose_keypoints_2d"), COUNTS)]
    if len(out[0]) > len(MORE):
        return out[0]
    for side in SIDES:
        out.append(_optional(place, person, f"hand_{side}_keypoints_2d", 21))
    out.append(_optional(place, person, "face_keypoints_2d", FACE_POINTS)[: len(FACE)])
    return np.concatenate(out)


def _optional(place: str, person: dict[str, Any], key: str, points: int) -> Float[Array, "points 3"]:
    value = person.get(key)
    return np.zeros((points, 3)) if value in (None, []) else triples(f"{place}.{key}", value, (points,))
