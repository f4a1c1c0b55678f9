"""Symmetric systems are solved without the fill of A^T A."""

import numpy as np
import pytest
from scipy.sparse import diags, identity, kron
from scipy.sparse.linalg import splu

from geometry.symmetric import factorised


def grid_laplacian(side):
    """Of a cube of side^3 points, held at every point by a little."""
    line, one = diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(side, side)), identity(side)
    along = [kron(kron(line, one), one), kron(kron(one, line), one), kron(kron(one, one), line)]
    return (sum(along) + 0.01 * identity(side**3)).tocsc()


def test_the_solution_is_right_and_its_factors_are_small():
    matrix = grid_laplacian(12)
    truth = np.random.default_rng(0).normal(size=(12**3, 3))
    factors = factorised(matrix)
    assert factors.solve(matrix @ truth) == pytest.approx(truth, abs=1e-9)
    assert factors.nnz < 0.6 * splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0).nnz
