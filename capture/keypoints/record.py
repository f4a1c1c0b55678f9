"""The keypoints of one person through a video, whichever detector found them.

Points are called as our joints where they are those joints (`left_elbow`, `right_index2`); `left` is the person's left.
Beside them: nose, eyes, ears; `shoulders` and `hips`, the middles that some detectors add; heels, big and small toes;
`left_hand`, the wrist as the hand's own detector sees it, and the finger tips `left_index_tip` ...; `face_00` to
`face_67`, the 68 points of a face in iBUG's order.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from command.errors import AssetError

SIDES = ("left", "right")
FACE = tuple(f"face_{k:02d}" for k in range(68))
# pixels
LARGEST = 1e5
# a quarter of an hour at 60 a second: a turn takes some 20 s, and each frame takes memory, seen or not
MOST_FRAMES = 54_000
# confidences that are zeros
TINY = 1e-6


def hand_points(side: str) -> tuple[str, ...]:
    """The 21 points of a hand in the order of all detectors: wrist, then thumb to little finger, each to its tip."""
    fingers = ("thumb", "index", "middle", "ring", "pinky")
    return (f"{side}_hand", *(f"{side}_{finger}{n}" for finger in fingers for n in (1, 2, 3, "_tip")))


@dataclass(frozen=True)
class Keypoints:
    """Pixels of named points, frame by frame. What was not seen has confidence 0, and its pixel is NaN."""

    names: tuple[str, ...]
    # x to the right, y down; the middle of the first pixel is (.5, .5)
    pixels: Float[Array, "frames points 2"]
    confidence: Float[Array, "frames points"]  # 0 to 1
    size: tuple[int, int] | None  # width and height of the pictures, where the files have them
    # size of the second largest person, of the largest one's; 0: alone. None: the files hold one person at most
    others: Float[Array, "frames"] | None = None
    # the order that the files list the body's points in (capture/keypoints/orders.py)
    order: str = ""

    def seen(self, name: str) -> Float[Array, "frames 3"]:
        """x, y and confidence of one point; confidence 0 throughout where the detector has no such point."""
        out = np.full((len(self.pixels), 3), np.nan)
        out[:, 2] = 0
        if name in self.names:
            k = self.names.index(name)
            out[:, :2], out[:, 2] = self.pixels[:, k], self.confidence[:, k]
        return out

    def of_frames(self, frames: Int[Array, "kept"]) -> "Keypoints":
        others = None if self.others is None else self.others[frames]
        return replace(self, pixels=self.pixels[frames], confidence=self.confidence[frames], others=others)


def keypoints_of(
    names: tuple[str, ...],
    rows: Float[Array, "frames points 3"],
    size: tuple[int, int] | None,
    others: Float[Array, "frames"] | None = None,
    order: str = "",
) -> Keypoints:
    """The record of rows of x, y and confidence; what has confidence 0 loses its pixel, confidences are cut at 1."""
    confidence = np.clip(rows[:, :, 2], 0, 1)
    pixels = np.where(confidence[:, :, None] > 0, rows[:, :, :2], np.nan)
    return Keypoints(names, pixels, confidence, size, others, order)


def largest_people(
    place: Path, pictures: list[list[Float[Array, "points 3"]]]
) -> tuple[Float[Array, "frames points 3"], Float[Array, "frames"]]:
    """The largest person in each picture, and how large the next one is; pixels that count from the middle of the first
    one now count from its corner.

    Raises:
        AssetError: no person in any picture, people of different numbers of points, or too many pictures; the message
            begins with `place`.
    """
    check_count(place, len(pictures))
    counts = sorted({len(person) for people in pictures for person in people})
    if not counts:
        raise AssetError(f"{place}: no person in any of {len(pictures)} frames")
    if len(counts) > 1:
        raise AssetError(f"{place}: expected as many points throughout, found people of {counts[0]} and {counts[1]}")
    rows, others = np.zeros((len(pictures), counts[0], 3)), np.zeros(len(pictures))
    for k, people in enumerate(pictures):
        if people:
            rows[k], others[k] = _largest(people)
    rows[:, :, :2] += 0.5
    return rows, others


def check_count(place: Path, frames: int) -> None:
    """Refuse more than MOST_FRAMES, before memory is taken for them."""
    if frames > MOST_FRAMES:
        raise AssetError(f"{place}: expected keypoints of at most {MOST_FRAMES} frames, found {frames}")


def _largest(people: list[Float[Array, "points 3"]]) -> tuple[Float[Array, "points 3"], float]:
    """The person whose seen points span most of the picture, and the next one's height as a share of this one's."""
    if len(people) == 1:
        return people[0], 0.0
    extents = []
    for rows in people:
        seen = rows[rows[:, 2] > 0, :2]
        extents.append(np.ptp(seen, axis=0) if len(seen) else np.zeros(2))
    order = sorted(range(len(people)), key=lambda k: float(np.prod(extents[k])), reverse=True)
    first, second = (float(np.linalg.norm(extents[k])) for k in order[:2])
    return people[order[0]], second / first if first > 0 else 0.0


def triples(place: str, value: Any, counts: tuple[int, ...]) -> Float[Array, "points 3"]:
    """x, y, confidence of one of so many points in one list of numbers.

    Raises:
        AssetError: another length, or what is no finite number; the message begins with `place`.
    """
    if not isinstance(value, list) or len(value) % 3 or len(value) // 3 not in counts:
        found = f"{len(value)} numbers" if isinstance(value, list) else repr(value)[:40]
        raise AssetError(f"{place} should be {in_words(counts)} times x, y, confidence, is {found}")
    return checked(place, np.reshape([number(place, v) for v in value], (-1, 3)))


def in_words(counts: tuple[int, ...]) -> str:
    """ "17, 18 or 25" """
    first, last = ", ".join(map(str, counts[:-1])), str(counts[-1])
    return f"{first} or {last}" if first else last


def number(place: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        raise AssetError(f"{place} should be finite numbers below {LARGEST:g}, has {str(value)[:40]!r}")
    return float(value)


def checked(place: str, rows: Float[Array, "points 3"]) -> Float[Array, "points 3"]:
    """The rows, if no confidence is negative; OpenPose writes -1e-9 for some of its zeros."""
    if (rows[:, 2] < -TINY).any():
        raise AssetError(f"{place}: confidence should not be negative, is {rows[:, 2].min():g}")
    return rows
