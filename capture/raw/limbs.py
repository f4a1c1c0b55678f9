"""Where keypoints say that the person is: thin lines that surely are, and a wide hull that holds all of it."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy import ndimage

from capture.keypoints.record import SIDES, Keypoints
from capture.raw.glance import SURE

# shares of the trunk's length: the hull round limbs, and round a head; a line of limbs, of fingers
HULL, HEAD_HULL, CORE, FINGER_CORE = 0.42, 0.75, 0.05, 0.006
# a line that stays on the person where a detector is some centimetres off, and what is near it
BONE, NEAR, FINGER_NEAR = 0.015, 0.045, 0.012
# pixels of the pictures that lines are drawn in
DRAWN = 240
FINGERS = ("thumb", "index", "middle", "ring", "pinky")


# the middle between the shoulders, and of the head, which no detector sees from behind
THROAT, SKULL, RISE = "throat", "skull", 0.5


def limbs() -> list[tuple[str, str]]:
    """Pairs of points with body between them."""
    out = [("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"), ("nose", "left_ear"), ("nose", "right_ear"),
           (THROAT, "nose"), (THROAT, SKULL)]  # fmt: skip
    for side in SIDES:
        chain = [f"{side}_{name}" for name in ("shoulder", "elbow", "wrist")]
        leg = [f"{side}_{name}" for name in ("shoulder", "hip", "knee", "ankle", "big_toe")]
        out += [*zip(chain, chain[1:]), *zip(leg, leg[1:])]
        for finger in FINGERS:
            knuckles = [f"{side}_hand", *(f"{side}_{finger}{n}" for n in (1, 2, 3, "_tip"))]
            out += zip(knuckles, knuckles[1:])
    return out


LIMBS = limbs()


def trunk_length(keypoints: Keypoints, frame: int, size: tuple[int, int]) -> float:
    """Pixels that half a metre of the person takes, from what is seen: trunk, forearm or hand, else shoulders as wide
    as they nearly ever are in the film: a close-up turns."""
    for a, b, share in (
        ("left_shoulder", "left_hip", 1.0), ("right_shoulder", "right_hip", 1.0), ("left_elbow", "left_wrist", 2.0),
        ("right_elbow", "right_wrist", 2.0), ("left_hand", "left_middle1", 5.5), ("right_hand", "right_middle1", 5.5),
    ):  # fmt: skip
        p, q = keypoints.seen(a)[frame], keypoints.seen(b)[frame]
        if min(p[2], q[2]) > SURE:
            length = share * float(np.hypot(*(p[:2] - q[:2])))
            if length > 0.05 * min(size):
                return length
    p, q = keypoints.seen("left_shoulder"), keypoints.seen("right_shoulder")
    apart = np.hypot(*(p - q)[np.minimum(p[:, 2], q[:, 2]) > SURE, :2].T)
    length = 1.4 * float(np.quantile(apart, 0.8)) if len(apart) else 0.0
    return length if length > 0.05 * min(size) else 0.5 * min(size)


def lines(keypoints: Keypoints, frame: int, shape: tuple[int, int]) -> Bool[Array, "height width"]:
    """Pixels on the lines between sure points, for pictures of `shape`: height, width."""
    return _within(keypoints, frame, shape, lambda name: FINGER_CORE if any(f in name for f in FINGERS) else CORE)


def hull(keypoints: Keypoints, frame: int, shape: tuple[int, int]) -> Bool[Array, "height width"]:
    """Pixels that may show the person; everywhere, where too little is seen."""
    reach = lambda name: HEAD_HULL if any(part in name for part in ("nose", "ear", SKULL)) else HULL
    return _within(keypoints, frame, shape, reach, True)


def bones(keypoints: Keypoints, frame: int, shape: tuple[int, int]) -> Bool[Array, "height width"]:
    """Thinner lines, for what takes them as they are; one shoulder stands for both only where nothing else is seen."""
    reach = lambda name: FINGER_CORE if any(f in name for f in FINGERS) else BONE
    strict = _within(keypoints, frame, shape, reach)
    return strict if strict.any() else _within(keypoints, frame, shape, reach, True)


def near_bones(keypoints: Keypoints, frame: int, shape: tuple[int, int]) -> Bool[Array, "height width"]:
    """Pixels that show the person rather than not."""
    return _within(keypoints, frame, shape, lambda name: FINGER_NEAR if any(f in name for f in FINGERS) else NEAR)


def _places(keypoints: Keypoints, frame: int, trunk: float, loose: bool) -> dict[str, Float[Array, "3"]]:
    """x, y and confidence of the ends of limbs; the head's middle over that of the shoulders, away from the hips;
    `loose` takes one shoulder for both."""
    ends = {name for pair in LIMBS for name in pair} - {THROAT, SKULL}
    out = {name: keypoints.seen(name)[frame] for name in ends}
    out[THROAT], hips = (_middle(out[f"left_{name}"], out[f"right_{name}"]) for name in ("shoulder", "hip"))
    up = (out[THROAT] - hips)[:2]
    length = float(np.hypot(*up))
    if not length > 0:
        up, length = np.array([0.0, -1.0]), 1.0
    if not loose:
        out[THROAT][2] = min(out[f"{side}_shoulder"][2] for side in SIDES)
    out[SKULL] = out[THROAT] + [*(RISE * trunk * up / length), 0.0]
    return out


def _middle(a: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, "3"]:
    """The middle of two points; the surer one where the other is not sure."""
    return (a + b) / 2 if min(a[2], b[2]) > SURE else a.copy() if a[2] > b[2] else b.copy()


def _within(
    keypoints: Keypoints, frame: int, shape: tuple[int, int], reach: Callable[[str], float], loose: bool = False
) -> Bool[Array, "height width"]:
    scale = DRAWN / shape[0]
    small = (DRAWN, round(shape[1] * scale))
    trunk = trunk_length(keypoints, frame, (shape[1], shape[0])) * scale
    out = np.zeros(small, bool)
    places = _places(keypoints, frame, trunk / scale, loose)
    for a, b in LIMBS:
        p, q = places[a], places[b]
        if min(p[2], q[2]) <= SURE:
            continue
        p, q, width = scale * p[:2], scale * q[:2], max(reach(a), reach(b)) * trunk + 0.5
        low = np.clip(np.floor(np.minimum(p, q) - width), 0, small[::-1]).astype(int)
        high = np.clip(np.ceil(np.maximum(p, q) + width), 0, small[::-1]).astype(int)
        y, x = np.mgrid[low[1] : high[1], low[0] : high[0]] + 0.5
        along = q - p
        t = np.clip(((x - p[0]) * along[0] + (y - p[1]) * along[1]) / max(along @ along, 1e-9), 0, 1)
        away = np.hypot(x - p[0] - t * along[0], y - p[1] - t * along[1])
        out[low[1] : high[1], low[0] : high[0]] |= away < width
    if not out.any():
        return np.full(shape, reach("left_knee") == HULL)
    zoomed = ndimage.zoom(out.astype(np.float32), (shape[0] / small[0], shape[1] / small[1]), order=1)
    return np.asarray(zoomed > 0.5)
