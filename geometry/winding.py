"""Winding number of a sampled surface on a grid: how far a place is inside of sheets that need not close."""

from itertools import product

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from scipy import fft

# cells round the box within which samples count on its own grid; those farther off on one of COARSER times its cell
NEAR, COARSER = 8, 4


def winding_grid(
    points: Float[Array, "n 3"], dipoles: Float[Array, "n 3"], low: Float[Array, "3"], shape: tuple[int, int, int],
    cell: float,
) -> Float32[Array, "x y z"]:  # fmt: skip
    """Winding number at the nodes low + cell * index: 1 inside of a closed surface, 0 outside, smooth between.

    `dipoles` are unit normals, outwards, times the area (square metres) that each sample stands for. Samples count
    wherever they lie. The sum of their fields is a convolution (FFT); Kazhdan (2005), Reconstruction of solid models
    from oriented point sets, section 3. Right to a few hundredths from two cells off the samples on.
    """
    high = low + cell * (np.array(shape) - 1)
    near = ((points > low - NEAR * cell) & (points < high + NEAR * cell)).all(1)
    winding = _convolved((points[near] - low) / cell, dipoles[near] / cell**2, shape)
    if near.all():
        return winding
    fewer = tuple((count - 2) // COARSER + 2 for count in shape)
    coarse = winding_grid(points[~near], dipoles[~near], low, (fewer[0], fewer[1], fewer[2]), COARSER * cell)
    for axis, count in enumerate(shape):
        place = np.arange(count) / COARSER
        before = np.minimum(place.astype(int), fewer[axis] - 2)
        share = (place - before).astype(np.float32).reshape([-1 if i == axis else 1 for i in range(3)])
        coarse = coarse.take(before, axis) * (1 - share) + coarse.take(before + 1, axis) * share
    return winding + coarse


def _convolved(
    places: Float[Array, "n 3"], dipoles: Float[Array, "n 3"], shape: tuple[int, int, int]
) -> Float32[Array, "x y z"]:
    """The sum of the dipoles' fields at the nodes 0 ... shape - 1; places and areas in cells."""
    if len(places) == 0:
        return np.zeros(shape, np.float32)
    corner = np.floor(places).astype(int)
    share = places - corner
    first = corner.min(0)
    corner -= first
    source = corner.max(0) + 2
    spread = np.zeros((3, *source), np.float32)
    for step in product((0, 1), repeat=3):
        weight = np.prod(np.where(np.array(step) == 1, share, 1 - share), axis=1)
        rows = np.ravel_multi_index(tuple((corner + step).T), tuple(source))
        for axis in range(3):
            spread[axis] += np.bincount(rows, weight * dipoles[:, axis], int(source.prod())).reshape(source)
    total = source + np.array(shape) - 1
    size = tuple(fft.next_fast_len(int(n), real=True) for n in total)
    # the way from each node that has samples to each node asked for
    ways = [(np.arange(n) - (s - 1) - f).astype(np.float32) for n, s, f in zip(total, source, first)]
    ways = np.meshgrid(*ways, indexing="ij", sparse=True)
    cubed = (ways[0] ** 2 + ways[1] ** 2 + ways[2] ** 2) ** np.float32(1.5)
    # a node says nothing of its own samples
    field = np.divide(np.float32(-1 / (4 * np.pi)), cubed, out=np.zeros_like(cubed), where=cubed > 0)
    transform = lambda grid: np.asarray(fft.rfftn(grid, size, workers=-1))
    spectrum = np.sum([transform(spread[axis]) * transform(field * way) for axis, way in enumerate(ways)], axis=0)
    winding = np.asarray(fft.irfftn(spectrum, size, workers=-1), np.float32)
    return winding[tuple(slice(int(s) - 1, int(n)) for s, n in zip(source, total))]
