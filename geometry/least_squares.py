"""Robust non-linear least squares: weights, normal equations of many frames at once, damped steps.

Unknowns of frame f meet those of f + 1 and f + 2 (people move smoothly), and those that all frames share: a band and a
border. Frames are taken in pairs, so that the band is block tridiagonal: each pair is eliminated with dense, small
matrices, the shared unknowns are solved last (Schur complement), and the pairs follow backwards. A plain system is one
frame that shares nothing. Sparse symmetric systems are factorised.
"""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csc_matrix, spmatrix
from scipy.sparse.linalg import SuperLU, splu

Estimate = TypeVar("Estimate")

# share of the cost by which a step has to lower it to be worth another
SETTLED = 2e-4
# share added to the diagonal at first
DAMPING = 1e-4


def robust_cost(squares: Float[Array, "*n"], cut: float | int = 1.0) -> Float[Array, "*n"]:
    """rho(e) = c^2 e / (c^2 + e) of squared residuals e, c = `cut` (Geman and McClure 1985)."""
    return cut**2 * squares / (cut**2 + squares)


def robust_weight(squares: Float[Array, "*n"], cut: float | int = 1.0) -> Float[Array, "*n"]:
    """Slope of `robust_cost`, the weight of iterated least squares: 1 of small residuals, a quarter at the cut."""
    return 1 / (1 + squares / cut**2) ** 2


class NormalEquations:
    """H x = b, added to in place; x = [frames, shared]."""

    def __init__(self, frames: int, own: int, shared: int = 0):
        self.frames, self.own = frames, own
        # frame f with f, f + 1, f + 2
        self.near = [np.zeros((frames, own, own)) for _ in range(3)]
        self.border = np.zeros((frames, own, shared))
        self.shared = np.zeros((shared, shared))
        self.b = np.zeros((frames, own))
        self.b_shared = np.zeros(shared)

    def add(
        self, f: int, rows: Float[Array, "n own"], r: Float[Array, "n"], weight: Float[Array, "n"],
        shared: Float[Array, "n shared"] | None = None,
    ) -> None:  # fmt: skip
        """Add sum of weight (r - rows x_f - shared y)^2."""
        weighted = rows * weight[:, None]
        self.near[0][f] += weighted.T @ rows
        self.b[f] += weighted.T @ r
        if shared is not None:
            shared_weighted = shared * weight[:, None]
            self.border[f] += weighted.T @ shared
            self.shared += shared_weighted.T @ shared
            self.b_shared += shared_weighted.T @ r

    def hold(
        self, at: Int[Array, "k"], away: Float[Array, "frames k"], weight: Float[Array, "*rows k"] | float
    ) -> float:
        """Add sum of weight (away + x)^2 over unknowns `at` of every frame; returns it at x = 0."""
        self.near[0][:, at, at] += weight
        self.b[:, at] -= weight * away
        return float((weight * away**2).sum())

    def add_second_difference(
        self, at: Int[Array, "m k"], second: Float[Array, "inner m c"], rows: Sequence[Float[Array, "#inner #m c k"]],
        weight: Float[Array, "#inner #m"],
    ) -> None:  # fmt: skip
        """Add sum of weight |second + rows_0 x_f + rows_1 x_(f+1) + rows_2 x_(f+2)|^2 over frames f and m blocks.

        Block m has the k unknowns at[m] of each frame; blocks do not meet.
        """
        inner = len(second)
        down, across = at[:, :, None], at[:, None, :]
        for i in range(3):
            weighted = rows[i] * weight[..., None, None]
            self.b[i : inner + i, at] -= (weighted * second[..., None]).sum(2)
            for j in range(i, 3):
                block = self.near[j - i][i : inner + i]
                block[:, down, across] += np.swapaxes(weighted, 2, 3) @ rows[j]

    def solve(self, damping: float = 0.0) -> tuple[Float[Array, "frames own"], Float[Array, "shared"]]:
        """The step; `damping` is the share added to the diagonal (Marquardt 1963)."""
        n, pairs = self.own, -(-self.frames // 2)
        size = 2 * n
        S, beyond, B = self._paired(pairs, size)
        diagonal = np.arange(size)
        S[:, diagonal, diagonal] *= 1 + damping
        L, W = [], []
        for i in range(pairs):
            if i:
                S[i] -= W[-1].T @ W[-1]
                B[i] -= W[-1].T @ B[i - 1]
            L.append(cholesky(S[i], lower=True, check_finite=False))
            B[i] = solve_triangular(L[i], B[i], lower=True, check_finite=False)
            W.append(solve_triangular(L[i], beyond[i], lower=True, check_finite=False))
        y, Y = B[:, :, 0].reshape(-1), B[:, :, 1:].reshape(pairs * size, -1)
        H = self.shared - Y.T @ Y
        H[np.diag_indices_from(H)] += damping * np.diag(self.shared)
        shared = np.linalg.solve(H, self.b_shared - Y.T @ y)
        x = np.zeros((pairs, size))
        for i in reversed(range(pairs)):
            right = B[i, :, 0] - B[i, :, 1:] @ shared
            if i + 1 < pairs:
                right -= W[i] @ x[i + 1]
            x[i] = solve_triangular(L[i], right, lower=True, trans=1, check_finite=False)
        return x.reshape(2 * pairs, n)[: self.frames], shared

    def _paired(
        self, pairs: int, size: int
    ) -> tuple[Float[Array, "pairs s s"], Float[Array, "pairs s s"], Float[Array, "pairs s r"]]:
        """Each pair of frames with itself, with the next pair, and its right-hand sides (b, then the border)."""
        n = self.own
        S, beyond = np.zeros((2, pairs, size, size))
        B = np.zeros((pairs, size, 1 + self.border.shape[2]))
        if self.frames % 2:
            S[-1, n:, n:] = np.eye(n)
        for f in range(self.frames):
            i, at = f // 2, slice(n * (f % 2), n * (f % 2) + n)
            S[i, at, at] = self.near[0][f]
            B[i, at, 0], B[i, at, 1:] = self.b[f], self.border[f]
            for apart in (1, 2):
                g = f + apart
                if g < self.frames:
                    there = slice(n * (g % 2), n * (g % 2) + n)
                    if g // 2 == i:
                        S[i, at, there] = self.near[apart][f]
                        S[i, there, at] = self.near[apart][f].T
                    else:
                        beyond[i, at, there] = self.near[apart][f]
        return S, beyond, B


def minimise(
    estimate: Estimate, assemble: Callable[[Estimate], tuple[NormalEquations, float]],
    moved: Callable[[Estimate, Float[Array, "frames own"], Float[Array, "shared"]], Estimate], rounds: int,
) -> Estimate:  # fmt: skip
    """Lower the cost that `assemble` returns beside its equations, by at most `rounds` Gauss-Newton steps.

    Levenberg's and Marquardt's damping: a step to a cost that is higher, or no number, is taken back and made shorter.
    """
    damping = DAMPING
    equations, cost = assemble(estimate)
    for _ in range(rounds):
        tried = moved(estimate, *equations.solve(damping))
        others, other_cost = assemble(tried)
        if not other_cost <= cost:
            damping *= 20
            continue
        settled = cost - other_cost < SETTLED * cost
        estimate, equations, cost = tried, others, other_cost
        if settled:
            break
        damping = max(damping / 4, 1e-6)
    return estimate


def factorised(matrix: spmatrix) -> SuperLU:
    """Factors of a symmetric positive definite matrix, to `solve` with.

    Its ordering is one for symmetric matrices, there is no pivoting, and SuperLU is set so: otherwise it reckons with
    the fill of A^T A, twice as much on a plain grid, and on a tangled surface of 200,000 vertices it does not end.
    """
    return splu(
        csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )  # fmt: skip
