"""The range of colors that the pixels of videos show round each place of a surface.

A change solved for with pixels of several texels swings over beside an edge that the field has a few millimetres off:
along a dark collar the neck began to glow. What no pixel round a texel shows, and the field did not make, is no color
of it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer

Array = np.ndarray

# beyond the range, of its width: pixels are means, and print is a little stronger than they show it
MARGIN = 0.1
# of cells along an axis, of millimetres: more than a person has
CELLS = 1 << 20


class ShownRange(NamedTuple):
    """Least and largest color in each cell of a grid that some pixel, or one in a neighbouring cell, shows."""

    cell: float  # metres
    keys: Integer[Array, "cells"]  # sorted
    low: Float[Array, "cells 3"]
    high: Float[Array, "cells 3"]

    def of(self, points: Float[Array, "n 3"]) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """The range at points; from infinity to minus infinity where no pixel is near."""
        low, high = np.full((len(points), 3), np.inf, np.float32), np.full((len(points), 3), -np.inf, np.float32)
        if len(self.keys):
            wanted = _keys(points, self.cell)
            row = np.minimum(np.searchsorted(self.keys, wanted), len(self.keys) - 1)
            found = self.keys[row] == wanted
            low[found], high[found] = self.low[row[found]], self.high[row[found]]
        return low, high


def shown_range(points: Float[Array, "pixels 3"], color: Float[Array, "pixels 3"], cell: float) -> ShownRange:
    """Of pixels that show `color` at `points` (metres); `cell` is as large as they are."""
    keys, low, high = _grouped(_keys(points, cell), color, color)
    steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3) @ [CELLS**2, CELLS, 1]
    spread = (keys[:, None] + steps).ravel()
    return ShownRange(cell, *_grouped(spread, np.repeat(low, len(steps), 0), np.repeat(high, len(steps), 0)))


def within_shown(
    color: Float[Array, "n 3"],
    given: Float[Array, "n 3"],
    points: Float[Array, "n 3"],
    ranges: Sequence[ShownRange],
) -> Float[Array, "n 3"]:
    """The colors, none farther than MARGIN outside of what pixels show round their points and the `given` color."""
    low, high = given.astype(np.float32), given.astype(np.float32)
    for one in ranges:
        least, largest = one.of(points)
        low, high = np.minimum(low, least), np.maximum(high, largest)
    margin = MARGIN * (high - low)
    return np.clip(color, low - margin, high + margin)


def _keys(points: Float[Array, "n 3"], cell: float) -> Array:
    return (np.floor(points / cell).astype(np.int64) + CELLS // 2) @ np.array([CELLS**2, CELLS, 1])


def _grouped(keys: Array, low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Each key once, sorted, with the least of its `low` and the largest of its `high`."""
    if len(keys) == 0:
        return keys, low, high
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    first = np.flatnonzero(np.r_[True, np.diff(keys) > 0])
    return keys[first], np.minimum.reduceat(low[order], first), np.maximum.reduceat(high[order], first)
