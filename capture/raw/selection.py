"""Which frames of a video are fitted: evenly over the movement, the sharpest near each, none that would harm."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage

from capture.raw.glance import SURE, Glance
from capture.raw.judge import BLURRED, Judged

# seconds over which keypoints are averaged before their way is measured: detectors tremble
STEADY = 0.4
# a frame's points off their own track, in units of what is usual, beyond which the frame is an outlier
OUTLIER = 6.0
# share of the eyes' usual opening: below it they blink; the mouth's height over the nose's beyond its usual: it is open
BLINK, AJAR = 0.55, 0.2
# share of the height of the body's points: how far trunk and legs may be to the side of where they usually are; beyond
# it the person steps in or out, which is no turn
ASIDE = 0.12
UPRIGHT = ("hip", "shoulder", "knee", "ankle")
# numbers of the face's points: a length, then heights of the opening
EYES = (((36, 39), (37, 41), (38, 40)), ((42, 45), (43, 47), (44, 46)))
# a mouth against the nose, which no turn of the head makes narrower
MOUTH = (((27, 33), (61, 67), (62, 66), (63, 65)),)


@dataclass(frozen=True)
class KeptFrames:
    """The frames of one video that are fitted."""

    frames: Int[Array, "kept"]
    # how many frames were passed over, by reason
    left_out: dict[str, int]

    def line(self, name: str) -> str:
        """What was chosen, in words."""
        out = ", ".join(f"{count} {reason}" for reason, count in self.left_out.items() if count)
        return f"{name}: {len(self.frames)} frames kept" + (f"; left out: {out}" if out else "")


def select(judged: Judged, most: int) -> KeptFrames:
    """At most `most` frames, evenly over the movement of what is filmed."""
    at = judged.glance
    found = at.found
    usual = np.median(at.sharpness[found]) if found.any() else 0.0
    blurred = found & (at.sharpness < BLURRED * usual)
    astray, (blinking, talking), aside = _astray(at) & found, moving_face(at), _aside(at)
    left_out = {
        "blurred": int(blurred.sum()), "with closed eyes": int((blinking & ~blurred).sum()),
        "with an open mouth": int((talking & ~blurred).sum()),
        "whose keypoints jump": int((astray & ~blurred).sum()), "of stepping in": int((aside & judged.usable).sum()),
        "cut off or with another person": int((found & ~judged.usable & ~blurred).sum()),
    }  # fmt: skip
    good = judged.usable & ~blurred & ~astray & ~blinking & ~talking & ~aside
    # where all would go, harm is taken over nothing
    if good.sum() < min(most, 0.3 * judged.usable.sum()):
        good, left_out = judged.usable, {}
    rows = np.flatnonzero(good)
    if len(rows) <= most:
        return KeptFrames(rows, left_out)
    way = movement(at)
    goals = np.linspace(way[rows[0]], way[rows[-1]], most + 1)
    kept = []
    for low, high in zip(goals[:-1], goals[1:]):
        near = rows[(way[rows] >= low) & (way[rows] <= high)]
        if len(near):
            # nearer to the middle of the stretch where two are as sharp
            middle = np.abs(way[near] - (low + high) / 2) / max(high - low, 1e-9)
            kept.append(near[np.argmax(at.sharpness[near] * (1 - 0.3 * middle))])
    return KeptFrames(np.unique(kept), left_out)


def movement(at: Glance) -> Float[Array, "frames"]:
    """How far the keypoints have moved up to each frame: their summed way, trembling averaged out.

    Over it a turn is even whatever its speed, and who pauses is not seen more often.
    """
    steady = _track(at)
    with np.errstate(invalid="ignore"):
        step = np.linalg.norm(np.diff(steady, axis=0), axis=2)
    known = np.isfinite(step)
    way = np.where(known, step, 0).sum(1) / np.maximum(known.sum(1), 1)
    # what trembling is left is no way
    moving = way[at.found[1:]]
    floor = 0.3 * float(np.median(moving)) if len(moving) else 0.0
    return np.concatenate([[0.0], np.cumsum(np.maximum(way - floor, 1e-6))])


def _track(at: Glance) -> Float[Array, "frames points 2"]:
    """Points averaged over STEADY seconds, by confidence; NaN where a point is not seen about then."""
    sure = np.where(at.keypoints.confidence > SURE, at.keypoints.confidence, 0.0)
    pixels = np.nan_to_num(at.keypoints.pixels)
    sigma = STEADY * at.video.rate / 2
    weight = ndimage.gaussian_filter1d(sure, sigma, axis=0, mode="constant")
    total = ndimage.gaussian_filter1d(pixels * sure[..., None], sigma, axis=0, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(weight[..., None] > 0.05, total / weight[..., None], np.nan)


def _astray(at: Glance) -> Bool[Array, "frames"]:
    """Frames in which half of the sure points lie far off their own track."""
    off = np.linalg.norm(at.keypoints.pixels - _track(at), axis=2)
    off = np.where(at.keypoints.confidence > SURE, off, np.nan)
    rows = np.isfinite(off).sum(1) >= 3
    middle = np.full(len(off), 0.0)
    middle[rows] = np.nanmedian(off[rows], axis=1)
    if not rows.any():
        return rows
    return rows & (middle > OUTLIER * np.median(middle[rows]) + 1)


def _aside(at: Glance) -> Bool[Array, "frames"]:
    """Frames of the body's video in which the person is not yet, or no longer, where the turn is."""
    out = np.zeros(len(at.times), bool)
    rows = [k for k, name in enumerate(at.keypoints.names) if name.endswith(UPRIGHT)]
    sure = at.keypoints.confidence[:, rows] > SURE
    seen = sure.any(1)
    if at.part != "body" or not seen.any():
        return out
    middle = np.nanmedian(np.where(sure, at.keypoints.pixels[:, rows, 0], np.nan)[seen], axis=1)
    height = float(np.nanmedian(at.boxes[:, 3] - at.boxes[:, 1]))
    out[seen] = np.abs(middle - np.median(middle)) > ASIDE * height
    return out


def moving_face(at: Glance) -> tuple[Bool[Array, "frames"], Bool[Array, "frames"]]:
    """Frames of the head video whose eyes are less open than usual, and whose mouth is more.

    Openings are heights over a length (Soukupova and Cech 2016), each against the film's own median: who
    always smiles, or has narrow eyes, loses nothing.
    """
    eyes, mouth = _opening(at, EYES), _opening(at, MOUTH)
    with np.errstate(invalid="ignore"):
        return eyes < BLINK * _usual(eyes), mouth > AJAR + _usual(mouth)


def _usual(opening: Float[Array, "frames"]) -> float:
    return float(np.nanmedian(opening)) if np.isfinite(opening).any() else np.nan


def _opening(at: Glance, lines: Sequence[Sequence[tuple[int, int]]]) -> Float[Array, "frames"]:
    """Mean height over the length where all points are seen, three frames' median; NaN elsewhere and in other videos.

    A blink lasts a tenth of a second, a detector's slip one frame.
    """
    out = np.full(len(at.times), np.nan)
    if at.part != "head":
        return out
    each = []
    for across, *down in lines:
        ends = np.array([[at.keypoints.seen(f"face_{k}") for k in pair] for pair in (across, *down)])
        sure = (ends[..., 2] > 0.5).all((0, 1))
        with np.errstate(invalid="ignore", divide="ignore"):
            length = np.linalg.norm(ends[:, 0, :, :2] - ends[:, 1, :, :2], axis=2)
            each.append(np.where(sure, length[1:].mean(0) / length[0], np.nan))
    seen = np.isfinite(each).all(0)
    if seen.sum() >= 8:
        out[seen] = ndimage.median_filter(np.mean(np.array(each)[:, seen], axis=0), 3)
    return out
