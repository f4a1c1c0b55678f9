"""Rows of x, y, confidence out of parsed JSON."""

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from capture.keypoints.record import LARGEST
from command.errors import AssetError


def triples(place: str, value: Any, points: int) -> Float[Array, "points 3"]:
    """`points` times x, y, confidence in one list of numbers.

    Raises:
        AssetError: another length, or what is no finite number; the message begins with `place`.
    """
    if not isinstance(value, list) or len(value) != 3 * points:
        found = f"{len(value)} numbers" if isinstance(value, list) else repr(value)[:40]
        raise AssetError(f"{place} should be {points} times x, y, confidence, is {found}")
    return checked(place, np.reshape([number(place, v) for v in value], (points, 3)))


def number(place: str, value: Any) -> float:
    """A finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
        raise AssetError(f"{place} should be finite numbers below {LARGEST:g}, has {str(value)[:40]!r}")
    return float(value)


def checked(place: str, rows: Float[Array, "points 3"]) -> Float[Array, "points 3"]:
    """The rows, if no confidence is negative."""
    if (rows[:, 2] < 0).any():
        raise AssetError(f"{place}: confidence should not be negative, is {rows[:, 2].min():g}")
    return rows
