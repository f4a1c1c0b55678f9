"""Squared errors of colors in [0, 1], gathered over pictures, and their PSNR: that of the pooled mean, since a mean of
decibels flatters."""

import math
from collections.abc import Iterable
from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float


def decibels(mean_square: float) -> float:
    """PSNR = -10 log10 of a mean squared error of colors in [0, 1]; infinite for 0, NaN for NaN."""
    return math.inf if mean_square == 0 else -10 * math.log10(mean_square)


class PooledError(NamedTuple):
    """Sum of squares and count of errors, over pixels and channels."""

    square: float = 0.0
    count: int = 0

    def plus(self, other: "PooledError") -> "PooledError":
        return PooledError(self.square + other.square, self.count + other.count)

    def psnr(self) -> float:
        """dB; infinite where there is no error, NaN where there are no values."""
        return decibels(self.square / self.count) if self.count else math.nan

    def rounded(self, digits: int) -> float | None:
        """dB for JSON; None where it is no finite number."""
        value = self.psnr()
        return round(value, digits) if math.isfinite(value) else None


def error_between(
    a: Float[np.ndarray, "*pixels 3"], b: Float[np.ndarray, "*pixels 3"], mask: Bool[np.ndarray, "..."] | None = None
) -> PooledError:
    """The error of one picture beside another, over `mask` where given."""
    error = np.square(np.asarray(a, np.float64) - b)
    chosen = error if mask is None else error[mask]
    return PooledError(float(chosen.sum()), chosen.size)


def pooled(errors: Iterable[PooledError]) -> PooledError:
    return reduce(PooledError.plus, errors, PooledError())
