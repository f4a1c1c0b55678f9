"""Lists of people as MMPose, ViTPose, AlphaPose and others write them, of as many points as one of the orders has.

    MMPose 1.x     {"instance_info": [{"frame_id", "instances": [...]}]}, or a list of instances for one picture, each
                   with keypoints (lists of x, y; null: not found) and keypoint_scores
    COCO results   a list of {"image_id", "keypoints": x, y, score of each point in turn}; a frame an image_id, in
                   AlphaPose's the name of a picture

Pixels count from the middle of the first one, ours from its corner: half a pixel is added.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from capture.keypoints.orders import COUNTS, keypoints_of_people
from capture.keypoints.record import Keypoints, checked, in_words, number, triples
from command.errors import AssetError
from files.input_file import name_order

# people by image
Images = dict[int | str, list[Float[Array, "points 3"]]]


def is_result_list(content: Any) -> bool:
    if isinstance(content, dict):
        return isinstance(content.get("instance_info"), list)
    first = content[0] if isinstance(content, list) and content else None
    return isinstance(first, dict) and "keypoints" in first


def result_keypoints(frames: list[tuple[Path, Any]], like: str, count: int | None) -> Keypoints:
    """The record of parsed files: one that holds all frames, or one a frame, in order.

    `like` is the order of the person's other films; `count` how many frames the video has: results leave those out in
    which nobody was found.

    Raises:
        AssetError: a number of points that no order has, numbers that are not finite, no person in any frame.
    """
    pictures: list[list[Float[Array, "points 3"]]] = []
    for path, content in frames:
        one = len(frames) > 1
        pictures += _pictures(path, content, one=one, count=None if one else count)
    return keypoints_of_people(frames[0][0], pictures, like)


def _pictures(path: Path, content: Any, *, one: bool, count: int | None) -> list[list[Float[Array, "points 3"]]]:
    """The people of each picture in one file."""
    if isinstance(content, dict) and isinstance(content.get("instance_info"), list):
        out = []
        for k, info in enumerate(content["instance_info"]):
            if not isinstance(info, dict) or not isinstance(info.get("instances"), list):
                raise AssetError(f"{path}: instance_info[{k}] should be an object with instances")
            out.append([_person(f"{path}: frame {k}", person) for person in info["instances"]])
        return out
    if not isinstance(content, list):
        raise AssetError(f"{path}: expected a list of people with keypoints, or an object of MMPose")
    by_image: Images = {}
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
    return [[]] if not by_image else _in_turn(by_image, count)


def _in_turn(by_image: Images, count: int | None) -> list[list[Float[Array, "points 3"]]]:
    """People picture by picture, names as their numbers; in a video of `count` frames at their places, those between
    empty. Pictures count from 0, or from 1 where the last one has the number `count`."""
    images = sorted(by_image, key=lambda image: name_order(str(image)))
    numbers = [int((re.findall(r"\d{1,9}", str(image)) or ["0"])[-1]) for image in images]
    fits = count is not None and len(images) < count and max(numbers) <= count and len(set(numbers)) == len(numbers)
    if not fits or count is None:
        return [by_image[image] for image in images]
    at = {number - (max(numbers) == count): image for number, image in zip(numbers, images)}
    return [by_image[at[k]] if k in at else [] for k in range(count)]


def _person(place: str, person: Any) -> Float[Array, "points 3"]:
    if not isinstance(person, dict) or not isinstance(person.get("keypoints"), list):
        raise AssetError(f"{place} should be an object with keypoints")
    value = person["keypoints"]
    if not any(isinstance(point, list) for point in value):
        return triples(f"{place}: keypoints", value, COUNTS)
    scores = person.get("keypoint_scores")
    if len(value) not in COUNTS:
        raise AssetError(f"{place}: keypoints should be {in_words(COUNTS)} points, are {len(value)} entries")
    rows = np.zeros((len(value), 3))
    for k, point in enumerate(value):
        if point is None:
            continue
        if not isinstance(point, list) or len(point) not in (2, 3):
            raise AssetError(f"{place}: keypoints[{k}] should be [x, y] or [x, y, score], is {str(point)[:40]}")
        rows[k, : len(point)] = [number(f"{place}: keypoints[{k}]", v) for v in point]
        if len(point) == 2:
            if not isinstance(scores, list) or len(scores) != len(value):
                raise AssetError(f"{place}: keypoint_scores should be {len(value)} numbers")
            rows[k, 2] = number(f"{place}: keypoint_scores[{k}]", scores[k])
    return checked(f"{place}: keypoints", rows)
