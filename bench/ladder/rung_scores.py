"""How exact the rungs of accuracy against time are: scores over the person, head and hands, and which are dominated."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import binom

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, project
from avatar.skeleton import PARTS, skin_transforms
from avatar.skinning import skin_points
from bench.report.writer import Json
from bench.score.metrics import RUNG_METRICS, ComparedPicture, ImageScores, grown, pooled_score, rectangle
from capture.read.template import part_of

# pixels round a part that what it does to its edge can reach
MARGIN = 3
# pixels; of a smaller part no score can be given
SMALLEST = 7


def crop_of(mask: Bool[np.ndarray, "height width"]) -> tuple[slice, slice]:
    """Where pictures are compared: the rectangle of the person, a little wider."""
    height, width = mask.shape
    return grown(rectangle(mask) or (slice(0, height), slice(0, width)), 4, mask.shape)


def part_boxes(
    avatar: Avatar, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"], camera: Camera
) -> dict[str, tuple[slice, slice]]:
    """Rows and columns of head and hands where they are in the picture."""
    level = avatar.levels[0]
    bones = skin_transforms(axis_angle, avatar.joint_positions, root, rest=avatar.canonical_pose)
    pixels, depth = project(camera, skin_points(level.positions, level.skin, bones).astype(np.float64))
    part = part_of(level.skin)
    width, height = camera.size
    boxes = {}
    for name in PARTS[1:]:
        points = pixels[(part == PARTS.index(name)) & (depth > 0)]
        if not len(points):
            continue
        left, top = np.clip(points.min(0) - MARGIN, 0, (width, height)).astype(int)
        right, bottom = np.clip(np.ceil(points.max(0)) + MARGIN, 0, (width, height)).astype(int)
        if min(right - left, bottom - top) >= SMALLEST:
            boxes[name] = slice(int(top), int(bottom)), slice(int(left), int(right))
    return boxes


def compared(
    references: list,
    drawn: list,
    crops: list[tuple[slice, slice]],
    masks: list[Bool[np.ndarray, "height width"]] | None = None,
) -> Json:
    """RUNG_METRICS over the pictures' rectangles and, with masks, over those; null with the reason for equal ones."""
    pictures = ImageScores(RUNG_METRICS if masks is not None else tuple(m for m in RUNG_METRICS if "mask" not in m.key))
    for k, (reference, picture, where) in enumerate(zip(references, drawn, crops, strict=True)):
        pictures.add(ComparedPicture(reference, picture, where, mask=None if masks is None else masks[k]))
    scores = pictures.scores()
    out: Json = {n: None if s.value is None else round(s.value, 4) for n, s in scores.items()}
    each = [pooled_score([sample]).value for sample in pictures.samples.get("flip", [])]
    out["flip_each"] = [None if value is None else round(value, 5) for value in each]
    reasons = {n: s.reason for n, s in scores.items() if s.value is None}
    return out | ({"reasons": reasons} if reasons else {})


def person_scores(
    references: list,
    crops: list[tuple[slice, slice]],
    masks: list[Bool[np.ndarray, "height width"]],
    boxes: list[dict[str, tuple[slice, slice]]],
    drawn: list,
) -> Json:
    """Scores of the person and, as "parts", of head and hands, over their rectangles in the pictures that show them."""
    parts = {}
    for name, kinds in (("head", ("head",)), ("hands", ("hand_left", "hand_right"))):
        seen = [(a, b, box[kind]) for a, b, box in zip(references, drawn, boxes) for kind in kinds if kind in box]
        if seen:
            scores = compared(*map(list, zip(*seen)))
            parts[name] = {key: scores[key] for key in ("psnr_db", "ssim", "flip")}
    return compared(references, drawn, crops, masks) | {"parts": parts}


def row_of(name: str, ms: Float[np.ndarray, "n"], size: int) -> Json:
    """Name, time and memory of a rung, as bench.json holds them; `ms` are single frames, `size` is bytes."""
    median, tail = round(float(np.median(ms)), 3), round(float(np.percentile(ms, 95)), 3)
    interval = [round(edge, 3) for edge in median_interval(ms)]
    return {"name": name, "ms_median": median, "ms_interval": interval, "ms_p95": tail, "bytes": int(size)}


def median_interval(values: Float[np.ndarray, "n"]) -> tuple[float, float]:
    """Between which two of the values the median lies with 95 % confidence, whatever their distribution; all of them
    are too few under 6 values."""
    ordered = np.sort(values)
    outside = int(binom.ppf(0.025, len(ordered), 0.5)) if len(ordered) > 5 else 1
    return float(ordered[outside - 1]), float(ordered[len(ordered) - outside])


def mark_dominated(
    rows: list[Json], times: Sequence[Float[np.ndarray, "rounds"] | None] | None = None, against: str | None = None
) -> None:
    """A rung is dominated when another is surely faster and no less exact in any picture.

    Surely faster: of `times` (of those measured in alternating rounds) the interval of the ratios lies below 1, or the
    intervals of the two medians do not overlap. `dominated_by` names the most exact that does. `against` names
    other scores of each row to judge by.
    """
    scores, times = [row if against is None else row[against] for row in rows], times or [None] * len(rows)
    for k, row in enumerate(rows):
        better = [
            i for i, other in enumerate(rows)
            if i != k and no_less_exact(scores[i], scores[k]) and surely_faster(other, row, times[i], times[k])
        ]  # fmt: skip
        scores[k]["dominated"] = bool(better)
        scores[k]["dominated_by"] = rows[min(better, key=lambda i: scores[i]["flip"])]["name"] if better else None


def no_less_exact(a: Json, b: Json) -> bool:
    """Whether a's FLIP is nowhere above b's."""
    return all((x or 0.0) <= (y or 0.0) for x, y in zip(a["flip_each"], b["flip_each"], strict=True))


def surely_faster(
    a: Json, b: Json, times_a: Float[np.ndarray, "rounds"] | None, times_b: Float[np.ndarray, "rounds"] | None
) -> bool:
    """Whether a's time lies below b's beyond what the measurement leaves open; times of those that took turns."""
    if times_a is not None and times_b is not None:
        return median_interval(times_a / times_b)[1] < 1
    return a["ms_interval"][1] < b["ms_interval"][0]
