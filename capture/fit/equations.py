"""Normal equations of all frames at once: a band of frames and a border of what they share.

Unknowns of frame f meet those of f + 1 and f + 2 (people move smoothly), and those that all frames share. Frames are
taken in pairs, so that the band is block tridiagonal: each pair is eliminated with dense, small matrices, the shared
unknowns are solved last (Schur complement), and the pairs follow backwards.
"""

import numpy as np
from jaxtyping import Float
from scipy.linalg import cholesky, solve_triangular

Array = np.ndarray


class Equations:
    """H x = b, added to in place; x = [frames, shared]."""

    def __init__(self, frames: int, own: int, shared: int):
        self.frames, self.own = frames, own
        # frame f with f, f + 1, f + 2
        self.near = [np.zeros((frames, own, own)) for _ in range(3)]
        self.border = np.zeros((frames, own, shared))
        self.shared = np.zeros((shared, shared))
        self.b = np.zeros((frames, own))
        self.b_shared = np.zeros(shared)

    def add(
        self, f: int, rows: Float[Array, "n own"], shared: Float[Array, "n shared"], r: Float[Array, "n"],
        weight: Float[Array, "n"],
    ) -> None:  # fmt: skip
        """Add sum of weight (r - rows x_f - shared y)^2."""
        weighted, shared_weighted = rows * weight[:, None], shared * weight[:, None]
        self.near[0][f] += weighted.T @ rows
        self.border[f] += weighted.T @ shared
        self.shared += shared_weighted.T @ shared
        self.b[f] += weighted.T @ r
        self.b_shared += shared_weighted.T @ r

    def solve(self, damping: float) -> tuple[Float[Array, "frames own"], Float[Array, "shared"]]:
        """The step; `damping` is the share added to the diagonal (Marquardt 1963)."""
        n, pairs = self.own, -(-self.frames // 2)
        size = 2 * n
        S = np.zeros((pairs, size, size))
        beyond = np.zeros((pairs, size, size))
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
