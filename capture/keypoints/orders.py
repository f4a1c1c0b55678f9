"""Orders in which detectors list the points of a person, by how many there are, and which of several it is.

Sources: COCO's and COCO-WholeBody's annotations (Lin et al. 2014; Jin et al. 2020), OpenPose's model parameters
(Cao et al. 2019; BODY_25B and BODY_135: Hidalgo et al. 2019), Halpe full body (Fang et al. 2022), Human3.6M's 17.
Where two orders have as many points, bone lengths over the film tell them apart: a person's left and right bones are
equal, a shin is as long as a thigh, a forearm nearly as an upper arm.
"""

from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from capture.keypoints.record import FACE, SIDES, Keypoints, hand_points, keypoints_of, largest_people

SIDED = ("eye", "ear", "shoulder", "elbow", "wrist", "hip", "knee", "ankle")
PUPILS = ("right_pupil", "left_pupil")


def _of_side(side: str, names: str) -> tuple[str, ...]:
    return tuple(f"{side}_{name}" for name in names.split())


def _hands(first: int = 0) -> tuple[str, ...]:
    return tuple(name for side in SIDES for name in hand_points(side)[first:])


ARM, LEG, FOOT = "shoulder elbow wrist", "hip knee ankle", "big_toe small_toe heel"
FEET = (*_of_side("left", FOOT), *_of_side("right", FOOT))
COCO_17 = ("nose", *(f"{side}_{name}" for name in SIDED for side in SIDES))
HUMAN36M_17 = (
    "hips", *_of_side("right", LEG), *_of_side("left", LEG), "middle_spine", "shoulders", "upper_neck", "head_top",
    *_of_side("left", ARM), *_of_side("right", ARM),
)  # fmt: skip
EYES_EARS = ("right_eye", "left_eye", "right_ear", "left_ear")
COCO_18 = (
    "nose", "shoulders", *_of_side("right", ARM), *_of_side("left", ARM), *_of_side("right", LEG),
    *_of_side("left", LEG), *EYES_EARS,
)  # fmt: skip
BODY_25 = (
    "nose", "shoulders", *_of_side("right", ARM), *_of_side("left", ARM), "hips", *_of_side("right", LEG),
    *_of_side("left", LEG), *EYES_EARS, *FEET,
)  # fmt: skip
BODY_25B = (*COCO_17, "upper_neck", "head_top", *FEET)
HALPE_26 = (
    *COCO_17, "head_top", "upper_neck", "hips", *(f"{side}_{name}" for name in FOOT.split() for side in SIDES),
)  # fmt: skip
COCO_WHOLEBODY = (*COCO_17, *FEET, *FACE, *_hands())
# by name, those of one length in order of how common they are; all hold the body, the long ones face and hands too
ORDERS = {
    "COCO": COCO_17,
    "Human3.6M": HUMAN36M_17,
    "OpenPose's COCO": COCO_18,
    "COCO and neck": (*COCO_17, "shoulders"),
    "BODY_25": BODY_25,
    "BODY_25B": BODY_25B,
    "Halpe": HALPE_26,
    "COCO-WholeBody": COCO_WHOLEBODY,
    # a wrist of the body is the hand's as well
    "BODY_135": (*BODY_25B, *_hands(1), *FACE, *PUPILS),
    "Halpe and hands": (*HALPE_26, *FACE, *_hands()),
}
COUNTS = tuple(sorted({len(names) for names in ORDERS.values()}))
# bones, each with one that is about as long, and how much shorter the second is
LIKE = tuple(
    [((f"left_{a}", f"left_{b}"), (f"right_{a}", f"right_{b}"), 1.0)
     for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "shoulder"))]
    + [((f"{side}_{a}", f"{side}_{b}"), (f"{side}_{b}", f"{side}_{c}"), share)
       for side, (a, b, c, share) in product(SIDES, (("hip", "knee", "ankle", 0.97),
                                                     ("shoulder", "elbow", "wrist", 0.85)))]
    + [(("nose", "left_eye"), ("nose", "right_eye"), 1.0), (("left_eye", "left_ear"), ("right_eye", "right_ear"), 1.0)]
)  # fmt: skip
# cost of bones that are not seen: an order that has them elsewhere is none
UNSEEN = 1.0


def order_of(rows: Float[Array, "frames points 3"], like: str = "") -> str:
    """The order of a film's points: `like` where that one is as long, else the one whose bones are most a person's."""
    named = [name for name, names in ORDERS.items() if len(names) == rows.shape[1]]
    if like in named or len(named) == 1:
        return like if like in named else named[0]
    return min(named, key=lambda name: _strangeness(ORDERS[name], rows))


def _strangeness(names: tuple[str, ...], rows: Float[Array, "frames points 3"]) -> float:
    """How far the bones are from those of a person: the mean of | log of their ratio |."""
    out = 0.0
    for first, second, share in LIKE:
        a, b = _length(names, rows, first), _length(names, rows, second)
        out += min(abs(np.log(b / a / share)), 2.0) if a > 0 and b > 0 else UNSEEN
    return out / len(LIKE)


def _length(names: tuple[str, ...], rows: Float[Array, "frames points 3"], bone: tuple[str, str]) -> float:
    """Median length of a bone over the frames that show it, pixels; 0: none does."""
    if not set(bone) <= set(names):
        return 0.0
    p, q = (rows[:, names.index(name)] for name in bone)
    seen = (p[:, 2] > 0) & (q[:, 2] > 0)
    return float(np.median(np.linalg.norm((p - q)[seen, :2], axis=1))) if seen.any() else 0.0


def keypoints_of_people(
    place: Path, pictures: list[list[Float[Array, "points 3"]]], like: str, more: tuple[str, ...] = ()
) -> Keypoints:
    """The record of the largest person in each picture: points of one of the orders, then `more`.

    Raises:
        AssetError: no person in any picture, or people of different numbers of points; the message begins with `place`.
    """
    rows, others = largest_people(place, pictures)
    order = order_of(rows[:, : rows.shape[1] - len(more)], like)
    names = (*ORDERS[order], *more)
    for side in SIDES:
        if f"{side}_thumb1" in names and f"{side}_hand" not in names:
            wrist = names.index(f"{side}_wrist")
            names, rows = (*names, f"{side}_hand"), np.concatenate([rows, rows[:, [wrist]]], 1)
    return keypoints_of(names, rows, None, others, order)


def described(found: Keypoints) -> str:
    """What a detector found, in words: how many points and whose order; and where bone lengths told it, from which."""
    seen = int((found.confidence > 0).any(0).sum())
    rivals = [name for name, names in ORDERS.items() if found.order in ORDERS and name != found.order
              and len(names) == len(ORDERS[found.order])]  # fmt: skip
    by = f", by bone lengths and not of {' or '.join(rivals)}" if rivals else ""
    return f"{seen} of {len(found.names)} points seen, in the order of {found.order}{by}"
