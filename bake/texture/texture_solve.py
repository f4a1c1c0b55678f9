"""The change of an atlas that explains the pixels of the videos best.

    min over d   sum_pixels w (A d - r)^2  +  sum_texels lambda d^2  +  sum_neighbours mu (d_i - d_j)^2
                 +  agree sum_points on chart edges (left(t + d) - right(t + d))^2

t is the atlas as the field has it, r what a pixel shows beyond what it reads in t, A reads pixels from texels
(pixel_reads.py). lambda keeps what no pixel shows, mu what pixels larger than a texel leave open. By conjugate
gradients (Hestenes and Stiefel 1952). The preconditioner is the diagonal (Saad 2003, section 9.2), and where agreement
couples texels of two charts it is that of the rest with the agreement itself, factorised: with the diagonal alone both
sides moved together twenty times too slowly, and stayed behind as lines where the field's color is far off.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer
from numpy import ndarray as Array
from scipy.sparse import csgraph, csr_matrix, diags

from command.workers import on_all_cores
from geometry.least_squares import factorised

ROUNDS = 12
# beyond the range, of its width: pixels are means, and print is a little stronger than they show it
MARGIN = 0.1
# rows of a matrix that one core multiplies at a time
BLOCK = 1 << 18
# cells along an axis, of millimetres: more than a person has
CELLS = 1 << 20


class Equations(NamedTuple):
    """Rows of one least-squares problem, their weights multiplied in: matrix @ change should be `wanted`."""

    matrix: csr_matrix
    wanted: Float[Array, "rows channels"]


class Prior(NamedTuple):
    """How much a texel resists, and how much differences from its neighbours cost."""

    stay: Float[Array, "texels"]  # lambda
    smooth: Float[Array, "texels"]  # mu


def laplacian(pairs: Integer[Array, "pairs 2"], weight: Float[Array, "pairs"], count: int) -> csr_matrix:
    """sum over pairs of weight (x_i - x_j)^2 = x^T L x, float32."""
    rows, columns = np.r_[pairs, pairs[:, ::-1]].T
    joined = csr_matrix((np.r_[weight, weight].astype(np.float32), (rows, columns)), (count, count))
    return csr_matrix(csgraph.laplacian(joined))


def solve_change(
    equations: list[Equations], prior: Prior, pairs: Integer[Array, "pairs 2"], *, stiff: Equations | None = None,
    rounds: int = ROUNDS, start: Float[Array, "texels channels"] | None = None,
) -> Float[Array, "texels channels"]:  # fmt: skip
    """The change d of the atlas, float32, sought from `start` on.

    `stiff` are equations of few texels each, as those of agreement: they are solved for as a whole in each round.
    """
    count = len(prior.stay)
    smooth = laplacian(pairs, 0.5 * (prior.smooth[pairs[:, 0]] + prior.smooth[pairs[:, 1]]), count)
    regular = (smooth + diags(prior.stay.astype(np.float32))).tocsr()
    precondition = preconditioner(regular.diagonal() + support(equations, count), stiff)
    equations = equations if stiff is None else [*equations, stiff]
    residual = np.zeros((count, equations[0].wanted.shape[1]), np.float32)
    for own in equations:
        residual += own.matrix.T @ own.wanted
    blocks = [block for own in equations for block in row_blocks(own.matrix, count)]

    def apply(x: Array) -> Array:
        result = regular @ x
        for part in on_all_cores(lambda block: block.T @ (block @ x), blocks):
            result += part
        return result

    if start is None:
        return conjugate_gradients(apply, precondition, residual, rounds)
    residual -= apply(start)
    return start + conjugate_gradients(apply, precondition, residual, rounds)


def row_blocks(matrix: csr_matrix, columns: int) -> list[csr_matrix]:
    """The matrix in pieces of at most BLOCK rows, which share its memory."""
    edges = np.r_[np.arange(0, len(matrix.indptr) - 1, BLOCK), len(matrix.indptr) - 1]
    pieces = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        own = slice(matrix.indptr[low], matrix.indptr[high])
        pointers = matrix.indptr[low : high + 1] - matrix.indptr[low]
        parts = matrix.data[own], matrix.indices[own], pointers
        pieces.append(csr_matrix(parts, (high - low, columns), copy=False))
    return pieces


def conjugate_gradients(
    apply: Callable[[Array], Array], precondition: Callable[[Array], Array], residual: Float[Array, "texels channels"],
    rounds: int,
) -> Float[Array, "texels channels"]:  # fmt: skip
    """Some rounds from zero towards apply(change) = residual, which is used up."""
    change = np.zeros_like(residual)
    scaled = precondition(residual)
    ahead, energy = scaled.copy(), (residual * scaled).sum(0)
    for _ in range(rounds):
        moved = apply(ahead)
        step = energy / np.maximum((ahead * moved).sum(0), 1e-30)
        change += step * ahead
        residual -= step * moved
        scaled = precondition(residual)
        before, energy = energy, (residual * scaled).sum(0)
        ahead = scaled + (energy / np.maximum(before, 1e-30)) * ahead
    return change


def preconditioner(diagonal: Float[Array, "texels"], stiff: Equations | None) -> Callable[[Array], Array]:
    """x to M^-1 x, float32; M is the diagonal and, where there are `stiff` equations, these with it."""
    inverse = (1 / np.maximum(diagonal, 1e-12)).astype(np.float32)[:, None]
    if stiff is None or not stiff.matrix.nnz:
        return lambda x: inverse * x
    coupled = np.unique(stiff.matrix.indices)
    own = stiff.matrix[:, coupled].astype(np.float64)
    factor = factorised(own.T @ own + diags(np.maximum(diagonal[coupled], 1e-9)))

    def apply(x: Array) -> Array:
        result = inverse * x
        result[coupled] = factor.solve(x[coupled].astype(np.float64))
        return result

    return apply


def support(equations: list[Equations], count: int) -> Float[Array, "texels"]:
    """Sum of squares of each texel's column: how well the equations determine it."""
    total = np.zeros(count)
    for own in equations:
        total += np.bincount(own.matrix.indices, np.square(own.matrix.data), count)
    return total


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
    color: Float[Array, "n 3"], given: Float[Array, "n 3"], points: Float[Array, "n 3"], ranges: Sequence[ShownRange]
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
