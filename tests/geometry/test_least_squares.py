"""Normal equations of many frames against dense ones, the robust weight, damped steps."""

import numpy as np
import pytest
from scipy.sparse import diags, identity, kron
from scipy.sparse.linalg import splu

from geometry.least_squares import NormalEquations, factorised, minimise, robust_cost, robust_weight


@pytest.mark.parametrize("cut", [0.3, 1.0, 10.0])
def test_the_weight_is_the_slope_of_the_cost(cut):
    e = np.array([0.0, 1e-6, 0.5, 3.0, 1e4])
    slope = (robust_cost(e + 1e-6, cut) - robust_cost(np.maximum(e - 1e-6, 0), cut)) / (2e-6 - (e < 1e-6) * 1e-6)
    np.testing.assert_allclose(robust_weight(e, cut), slope, rtol=1e-4, atol=1e-6)
    assert robust_weight(np.array([np.inf])) == 0


@pytest.mark.parametrize("frames", [1, 2, 3, 6, 7])
def test_eliminating_pairs_of_frames_solves_the_whole_system(frames):
    rng = np.random.default_rng(frames)
    own, shared = 4, 3
    J = rng.standard_normal((200, frames * own + shared))
    # only neighbours up to two frames apart meet
    H = J.T @ J
    for a in range(frames):
        for b in range(frames):
            if abs(a - b) > 2:
                H[a * own : (a + 1) * own, b * own : (b + 1) * own] = 0
    b = rng.standard_normal(len(H))
    equations = NormalEquations(frames, own, shared)
    for a in range(frames):
        for apart in range(min(3, frames - a)):
            other = a + apart
            equations.near[apart][a] = H[a * own : (a + 1) * own, other * own : (other + 1) * own]
        equations.border[a] = H[a * own : (a + 1) * own, frames * own :]
    equations.shared[:] = H[frames * own :, frames * own :]
    equations.b[:], equations.b_shared[:] = b[: frames * own].reshape(frames, own), b[frames * own :]
    x, y = equations.solve(0.0)
    np.testing.assert_allclose(np.r_[x.ravel(), y], np.linalg.solve(H, b), atol=1e-10)


def dense(equations):
    """The whole matrix and its right-hand side."""
    frames, own = equations.frames, equations.own
    H = np.zeros((frames * own, frames * own))
    for apart in range(3):
        for f in range(frames - apart):
            at, there = slice(f * own, f * own + own), slice((f + apart) * own, (f + apart) * own + own)
            H[at, there] = equations.near[apart][f]
            H[there, at] = equations.near[apart][f].T
    return H, equations.b.ravel()


def test_rows_holds_and_second_differences_are_the_squares_that_they_name():
    """Two blocks of two unknowns of three, five frames."""
    rng = np.random.default_rng(0)
    rows, r, weight = rng.standard_normal((4, 3)), rng.standard_normal(4), rng.uniform(1, 2, 4)
    away, hold = rng.standard_normal((5, 2)), np.array([2.0, 3.0])
    at, second = np.array([[0, 2]]), rng.standard_normal((3, 1, 2))
    steps, each = [rng.standard_normal((3, 1, 2, 2)) for _ in range(3)], rng.uniform(1, 2, (3, 1))
    equations = NormalEquations(5, 3)
    equations.add(2, rows, r, weight)
    assert equations.hold(np.array([0, 1]), away, hold) == pytest.approx((hold * away**2).sum())
    equations.add_second_difference(at, second, steps, each)

    def cost(x):
        total = (weight * (r - rows @ x[2]) ** 2).sum() + (hold * (away + x[:, :2]) ** 2).sum()
        for f in range(3):
            total += each[f, 0] * ((second[f, 0] + sum(steps[i][f, 0] @ x[f + i, at[0]] for i in range(3))) ** 2).sum()
        return total

    H, b = dense(equations)
    x = rng.standard_normal((5, 3))
    expected = cost(np.zeros((5, 3))) - 2 * b @ x.ravel() + x.ravel() @ H @ x.ravel()
    assert cost(x) == pytest.approx(expected)


def test_a_step_that_raises_the_cost_is_taken_back():
    """The root of an arctangent: a full Gauss-Newton step from 3 leaps ever farther."""

    def assemble(x):
        equations = NormalEquations(1, 1)
        equations.add(0, np.array([[1 / (1 + x**2)]]), np.array([-np.arctan(x)]), np.ones(1))
        return equations, float(np.arctan(x) ** 2)

    assert abs(minimise(3.0, assemble, lambda x, own, shared: x + float(own[0, 0]), 60)) < 1e-3


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
