"""Image scores: pooled PSNR, SSIM, FLIP, and LPIPS where its weights exist (they are not shipped).

Images are float arrays (H, W, 3) in [0, 1], sRGB, row 0 at the top. A score that cannot be given as a finite
number is None with the reason in words: identical images have an infinite PSNR, an empty mask has none.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import flip_evaluator
import numpy as np
from jaxtyping import Bool, Float
from skimage.metrics import structural_similarity

SSIM_WINDOW = 7  # pixels, scikit-image's default: uniform window
# pixels: twice FLIP's widest filter, feature after color
FLIP_REACH = 21
LPIPS_REASON = "LPIPS needs network weights under their own licence; none are shipped"


class Score(NamedTuple):
    """A finite number, or None and why."""

    value: float | None
    reason: str = ""

    def text(self, digits: int = 2) -> str:
        return f"{self.value:.{digits}f}" if self.value is not None else ("inf" if "infinite" in self.reason else "-")


@dataclass
class PooledError:
    """Squared error summed over many images, so that PSNR is that of the pooled mean (mean dB flatters).

    PSNR = -10 log10(sum of squared errors / number of values), for colors in [0, 1].
    """

    squared: float = 0.0
    values: int = 0

    def add(
        self,
        truth: Float[np.ndarray, "height width 3"],
        image: Float[np.ndarray, "_ _ 3"],
        mask: Bool[np.ndarray, "height width"] | None = None,
    ) -> None:
        check_images(truth, image)
        error = np.square(truth.astype(np.float64) - image)
        if mask is not None:
            error = error[mask]
        self.squared += float(error.sum())
        self.values += error.size

    def merged(self, other: "PooledError") -> "PooledError":
        return PooledError(self.squared + other.squared, self.values + other.values)

    def psnr(self) -> Score:
        if self.values == 0:
            return Score(None, "no pixels to compare")
        if self.squared == 0.0:
            return Score(None, "infinite: the images are identical")
        return Score(-10.0 * math.log10(self.squared / self.values))


def psnr(
    truth: Float[np.ndarray, "height width 3"],
    image: Float[np.ndarray, "_ _ 3"],
    mask: Bool[np.ndarray, "height width"] | None = None,
) -> Score:
    """Peak signal-to-noise ratio of one image in dB, over `mask` where given."""
    error = PooledError()
    error.add(truth, image, mask)
    return error.psnr()


def ssim(truth: Float[np.ndarray, "height width 3"], image: Float[np.ndarray, "_ _ 3"]) -> Score:
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


def flip(truth: Float[np.ndarray, "height width 3"], image: Float[np.ndarray, "_ _ 3"]) -> Score:
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


def lpips(truth: Float[np.ndarray, "height width 3"], image: Float[np.ndarray, "_ _ 3"]) -> Score:
    """Learned perceptual distance (Zhang et al. 2018): not measured, because its weights are not shipped."""
    check_images(truth, image)
    return Score(None, LPIPS_REASON)


def rectangle(mask: Bool[np.ndarray, "height width"]) -> tuple[slice, slice] | None:
    """Smallest rows and columns that hold the mask; None when it is empty."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if len(rows) == 0:
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def grown(where: tuple[slice, slice], margin: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """A rectangle widened by `margin` pixels, inside an image of `shape`."""
    rows, columns = where
    return (
        slice(max(0, rows.start - margin), min(shape[0], rows.stop + margin)),
        slice(max(0, columns.start - margin), min(shape[1], columns.stop + margin)),
    )


def mean_score(scores: list[Score]) -> Score:
    """Mean of the scores that exist; the reason of the first that does not when none does."""
    values = [s.value for s in scores if s.value is not None]
    if values:
        return Score(float(np.mean(values)))
    return Score(None, scores[0].reason if scores else "no images")


def check_images(truth: np.ndarray, image: np.ndarray) -> None:
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
