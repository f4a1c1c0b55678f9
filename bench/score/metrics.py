"""Scores, one line of METRICS each: P2S, its way back, Chamfer and F; pooled PSNR, SSIM, FLIP, and LPIPS where its
weights exist (they are not shipped).

Images are float arrays (H, W, 3) in [0, 1], sRGB, row 0 at the top. A score that cannot be given as a finite
number is None with the reason in words: identical images have an infinite PSNR, an empty mask has none.
"""

import ctypes
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import flip_evaluator
import numpy as np
from flip_evaluator import nbflip  # pyright: ignore[reportAttributeAccessIssue]
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy import ndimage
from skimage.metrics import structural_similarity

from avatar.psnr import PooledError, error_between, pooled
from bench.score.surface_distance import SurfaceDistance

SSIM_WINDOW = 7  # pixels, scikit-image's default: uniform window
# FLIP on one thread: its own (libgomp's) wait for each other by spinning, and a hand of 60 x 70 pixels took 48 ms of
# processor time for 6, a person of 226 x 476 took 217 for 148
ctypes.CDLL(nbflip.__file__).omp_set_num_threads(1)
# pixels: twice FLIP's widest filter, feature after color
FLIP_REACH = 21


class Score(NamedTuple):
    """A finite number, or None and why."""

    value: float | None
    reason: str = ""


Sample = Score | PooledError
Perceive = Callable[[Float[Array, "height width 3"], Float[Array, "_ _ 3"]], Score]  # LPIPS


class ComparedPicture(NamedTuple):
    """One picture beside its truth, and where a region of it is compared."""

    truth: Float[Array, "height width 3"]
    image: Float[Array, "height width 3"]
    # rows and columns; of those the pixels of `box`, None: all
    where: tuple[slice, slice]
    box: Bool[Array, "height width"] | None = None
    # the true person or part; None: not known
    mask: Bool[Array, "height width"] | None = None
    # LPIPS, where its weights are at hand
    perceive: Perceive | None = None
    # what `image` holds of the whole person; None: of a region
    shown: Bool[Array, "height width"] | None = None

    def cut(self) -> tuple[Array, Array]:
        return self.truth[self.where], self.image[self.where]

    def box_error(self) -> PooledError:
        return checked_error(*self.cut(), None if self.box is None else self.box[self.where])


class Metric(NamedTuple):
    """One line of METRICS: everything that measures, merges, prints or plots scores reads it."""

    # in JSON
    key: str
    # heading of a column, with its unit
    title: str
    digits: int
    better: Literal["lower", "higher"]
    # measures one picture; None: nothing can be said of it
    of_picture: Callable[[ComparedPicture], Sample | None] | None = None
    # chosen from the distances of a region over all poses, centimetres
    of_surfaces: Callable[[SurfaceDistance], float | None] | None = None
    # whether rungs of the player have it as well
    of_rungs: bool = False
    # what the scores of many pictures make together; errors are pooled in any case
    pool: Callable[[list[float]], float | np.floating] = np.mean


def psnr_score(error: PooledError) -> Score:
    """PSNR of the pooled error, or why there is none."""
    if error.count == 0:
        return Score(None, "no pixels to compare")
    return Score(error.psnr()) if error.square else Score(None, "infinite: the images are identical")


def checked_error(
    truth: Float[Array, "height width 3"], image: Float[Array, "_ _ 3"], mask: Bool[Array, "height width"] | None = None
) -> PooledError:
    """The squared error of pictures that can be compared, over `mask` where given."""
    check_images(truth, image)
    return error_between(truth, image, mask)


def ssim(truth: Float[Array, "height width 3"], image: Float[Array, "_ _ 3"]) -> Score:
    """Structural similarity (Wang et al. 2004), 7 x 7 uniform window, data range 1, mean over channels.

    Smaller images are scored with the largest odd window that fits; under 3 px there is none.
    """
    check_images(truth, image)
    side = min(truth.shape[:2])
    window = min(SSIM_WINDOW, side - 1 + side % 2)
    if window < 3:
        return Score(None, f"image of {truth.shape[1]} x {truth.shape[0]} px is smaller than any SSIM window")
    value = structural_similarity(truth, image, data_range=1.0, channel_axis=-1, win_size=window)
    return Score(float(np.asarray(value)))


def flip(truth: Float[Array, "height width 3"], image: Float[Array, "_ _ 3"]) -> Score:
    """Mean LDR-FLIP (Andersson et al. 2020) at 67 pixels per degree: 0 is equal, 1 the worst.

    Black ground that both images share is left out of the work and counted as equal, which it is: FLIP's widest
    filter reaches 10 px, and a rim of FLIP_REACH is kept.
    """
    check_images(truth, image)
    if truth.size == 0:
        return Score(None, "no pixels to compare")
    where = rectangle(np.asarray((truth > 0).any(-1) | (image > 0).any(-1)))
    if where is None:
        return Score(0.0)  # both are black
    where = grown(where, FLIP_REACH, truth.shape[:2])
    a = np.ascontiguousarray(np.clip(truth[where], 0, 1), dtype=np.float32)
    b = np.ascontiguousarray(np.clip(image[where], 0, 1), dtype=np.float32)
    _, mean, _ = flip_evaluator.evaluate(a, b, "LDR", applyMagma=False)
    return Score(float(mean) * (a.size / truth.size))


def outline_iou(compared: ComparedPicture) -> Score | None:
    """Intersection over union of the true outline and ours, where the whole person is compared."""
    if compared.mask is None or compared.shown is None:
        return None
    true, ours = compared.mask, compared.shown
    return Score(float((true & ours).sum() / max(int((true | ours).sum()), 1)))


def rectangle(mask: Bool[Array, "height width"]) -> tuple[slice, slice] | None:
    """Smallest rows and columns that hold the mask; None when it is empty."""
    return ndimage.find_objects(mask.astype(np.uint8), 1)[0]


def grown(where: tuple[slice, slice], margin: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """A rectangle widened by `margin` pixels, inside an image of `shape`."""
    rows, columns = where
    return (
        slice(max(0, rows.start - margin), min(shape[0], rows.stop + margin)),
        slice(max(0, columns.start - margin), min(shape[1], columns.stop + margin)),
    )


def pooled_score(samples: Sequence[Sample], pool: Callable[[list[float]], float | np.floating] = np.mean) -> Score:
    """One score of many pictures: PSNR of the pooled errors, else what `pool` makes of the scores that exist; where
    none does, the first one's reason."""
    errors = [sample for sample in samples if isinstance(sample, PooledError)]
    if errors:
        return psnr_score(pooled(errors))
    values = [s.value for s in samples if isinstance(s, Score) and s.value is not None]
    if values:
        return Score(float(pool(values)))
    return next((s for s in samples if isinstance(s, Score)), Score(None, "no images"))


def check_images(truth: Array, image: Array) -> None:
    """Refuse images that cannot be compared: other shapes, not finite, or 0..255 where 0..1 is meant."""
    if truth.shape != image.shape:
        raise ValueError(f"images to compare differ in shape: {truth.shape} and {image.shape}")
    for name, pixels in [("truth", truth), ("image", image)]:
        if pixels.size == 0:
            continue
        low, high = float(pixels.min()), float(pixels.max())
        if not (math.isfinite(low) and math.isfinite(high)):
            raise ValueError(f"{name} holds pixels that are not finite")
        if low < -1e-3 or high > 1.001:
            raise ValueError(f"{name} should lie in [0, 1], lies in [{low:g}, {high:g}]")


NO_LPIPS = Score(None, "LPIPS needs network weights under their own licence; none are shipped")
METRICS = (
    Metric("p2s_cm", "P2S cm", 2, "lower", of_surfaces=lambda d: d.p2s),
    Metric("back_cm", "back cm", 2, "lower", of_surfaces=lambda d: d.back),
    Metric("back_95_cm", "back 95 %", 2, "lower", of_surfaces=lambda d: d.back_95),
    Metric("chamfer_cm", "CD cm", 2, "lower", of_surfaces=lambda d: d.chamfer),
    Metric("f_5mm", "F 5 mm", 2, "higher", of_surfaces=lambda d: d.f_5mm),
    Metric("f_1cm", "F 1 cm", 2, "higher", of_surfaces=lambda d: d.f_1cm),
    # pictures of the whole person; the standing person's and its parts' outlines: bench/score/standing.py
    Metric("outline_iou", "IoU", 3, "higher", outline_iou),
    Metric("outline_worst", "IoU worst", 3, "higher", outline_iou, pool=min),
    # features of the standing head: bench/score/standing.py
    Metric("face_mm", "face mm", 1, "lower"),
    Metric("face_on_head_mm", "face on head mm", 1, "lower"),
    Metric("psnr_db", "box dB", 2, "higher", lambda p: p.box_error(), of_rungs=True),
    Metric("psnr_mask_db", "mask dB", 2, "higher",
           lambda p: None if p.mask is None else checked_error(p.truth, p.image, p.mask), of_rungs=True),
    Metric("ssim", "SSIM", 3, "higher", lambda p: ssim(*p.cut()), of_rungs=True),
    Metric("flip", "FLIP", 3, "lower", lambda p: flip(*p.cut()), of_rungs=True),
    Metric("lpips", "LPIPS", 3, "lower", lambda p: p.perceive(*p.cut()) if p.perceive else NO_LPIPS),
)  # fmt: skip
PICTURE_METRICS = tuple(metric for metric in METRICS if metric.of_picture is not None)
RUNG_METRICS = tuple(metric for metric in METRICS if metric.of_rungs)


@dataclass
class ImageScores:
    """Samples of one region gathered over pictures, by metric."""

    metrics: tuple[Metric, ...] = PICTURE_METRICS
    samples: dict[str, list[Sample]] = field(default_factory=dict)
    pictures: int = 0

    def merged(self, other: "ImageScores") -> "ImageScores":
        samples = {m.key: self.samples.get(m.key, []) + other.samples.get(m.key, []) for m in self.metrics}
        return ImageScores(self.metrics, samples, self.pictures + other.pictures)

    def add(self, compared: ComparedPicture) -> None:
        """Measure one picture by every metric."""
        self.pictures += 1
        for metric in self.metrics:
            sample = metric.of_picture(compared) if metric.of_picture is not None else None
            if sample is not None:
                self.samples.setdefault(metric.key, []).append(sample)

    def scores(self) -> dict[str, Score]:
        """By metric; of no pictures each with its reason."""
        return {m.key: pooled_score(self.samples.get(m.key, []), m.pool) for m in self.metrics}


def text_of(scores: Mapping[str, Any], metric: Metric) -> str:
    """One cell of a table: the number in JSON, "inf" of equal pictures, else a dash."""
    value = scores.get(metric.key)
    if value is None:
        return "inf" if "infinite" in scores.get("reasons", {}).get(metric.key, "") else "-"
    return f"{value:.{metric.digits}f}"
