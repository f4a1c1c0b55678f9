"""COCO-WholeBody's 133 points, as MMPose, ViTPose and others write them.

    MMPose 1.x     {"instance_info": [{"frame_id", "instances": [...]}]}, or a list of instances for one picture, each
                   with keypoints (133 of x, y) and keypoint_scores
    COCO results   a list of {"image_id", "keypoints": 399 numbers x, y, score}; a frame an image_id

Pixels count from the middle of the first one, ours from its corner: half a pixel is added.
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from capture.keypoints.record import FACE, Keypoints, checked, hand_points, keypoints_of_people, number, triples
from command.errors import AssetError

BODY_17 = (
    "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow left_wrist "
    "right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle"
).split()
FEET = "left_big_toe left_small_toe left_heel right_big_toe right_small_toe right_heel".split()
NAMES = (*BODY_17, *FEET, *FACE, *hand_points("left"), *hand_points("right"))


def is_wholebody(content: Any) -> bool:
    """Whether parsed JSON is of one of these kinds."""
    if isinstance(content, dict):
        return isinstance(content.get("instance_info"), list)
    first = content[0] if isinstance(content, list) and content else None
    return isinstance(first, dict) and "keypoints" in first


def wholebody_keypoints(frames: list[tuple[Path, Any]]) -> Keypoints:
    """The record of parsed files: one that holds all frames, or one a frame, in order.

    Raises:
        AssetError: another number of points than 133, numbers that are not finite, no person in any frame.
    """
    pictures: list[list[Float[Array, "133 3"]]] = []
    for path, content in frames:
        pictures += _pictures(path, content, one=len(frames) > 1)
    return keypoints_of_people(frames[0][0], NAMES, pictures)


def _pictures(path: Path, content: Any, *, one: bool) -> list[list[Float[Array, "133 3"]]]:
    """The people of each picture in one file."""
    if isinstance(content, dict) and isinstance(content.get("instance_info"), list):
        out = []
        for k, info in enumerate(content["instance_info"]):
            if not isinstance(info, dict) or not isinstance(info.get("instances"), list):
                raise AssetError(f"{path}: instance_info[{k}] should be an object with instances")
            out.append([_person(f"{path}: frame {k}", person) for person in info["instances"]])
        return out
    if not isinstance(content, list):
        raise AssetError(f"{path}: expected keypoints of COCO-WholeBody, a list of people or an object of MMPose")
    by_image: dict[Any, list[Array]] = {}
    for k, person in enumerate(content):
        rows = _person(f"{path}: person {k}", person)
        image = person.get("image_id", 0)
        if type(image) not in (int, str):
            raise AssetError(f"{path}: person {k}: image_id should be a number or a name, is {str(image)[:40]!r}")
        by_image.setdefault(image, []).append(rows)
    if len({type(image) for image in by_image}) > 1:
        raise AssetError(f"{path}: image_id should be numbers throughout, or names")
    if one and len(by_image) > 1:
        raise AssetError(f"{path}: expected one picture a file in a folder, found {len(by_image)}")
    return [by_image[image] for image in sorted(by_image)] or [[]]


def _person(place: str, person: Any) -> Float[Array, "133 3"]:
    if not isinstance(person, dict) or not isinstance(person.get("keypoints"), list):
        raise AssetError(f"{place} should be an object with keypoints")
    value = person["keypoints"]
    if len(value) == 3 * len(NAMES):
        return triples(f"{place}: keypoints", value, len(NAMES))
    scores = person.get("keypoint_scores")
    if len(value) != len(NAMES):
        found = f"{len(value)} entries"
        raise AssetError(f"{place}: keypoints should be the {len(NAMES)} points of COCO-WholeBody, are {found}")
    rows = np.zeros((len(NAMES), 3))
    for k, point in enumerate(value):
        if not isinstance(point, list) or len(point) not in (2, 3):
            raise AssetError(f"{place}: keypoints[{k}] should be [x, y] or [x, y, score], is {str(point)[:40]}")
        rows[k, : len(point)] = [number(f"{place}: keypoints[{k}]", v) for v in point]
        if len(point) == 2:
            if not isinstance(scores, list) or len(scores) != len(NAMES):
                raise AssetError(f"{place}: keypoint_scores should be {len(NAMES)} numbers")
            rows[k, 2] = number(f"{place}: keypoint_scores[{k}]", scores[k])
    return checked(f"{place}: keypoints", rows)
