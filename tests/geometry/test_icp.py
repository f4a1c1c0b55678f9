"""Eq. 6 and Eq. 5: the right transform, or a refusal; normal equations of many frames against dense ones."""

import numpy as np
import pytest
import trimesh
import trimesh.registration
from capsules import egg
from scipy.sparse import diags, identity, kron
from scipy.sparse.linalg import splu

from avatar.body import builtin_body
from avatar.rotation import matrix_from_axis_angle
from geometry.closest import triangle_index
from geometry.icp import Anchors, refine_by_surfaces, rigid_icp
from geometry.least_squares import NormalEquations, factorised, minimise, robust_cost, robust_weight


def _moved(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    R, t = matrix_from_axis_angle(np.array([0.02, -0.03, 0.01])), np.array([0.004, -0.003, 0.002])
    return (points - t) @ R, np.block([[R, t[:, None]], [np.zeros((1, 3)), 1]])


def test_a_sheet_that_faces_the_other_way_has_no_say():
    """Two sheets 6 mm apart, as lips are: without normals the wrong one attracts."""
    target, normals = egg(20000)
    inner = 0.93 * egg(20000, 5)[0]
    source, transform = _moved(target[:4000])
    turned, n = np.concatenate([target, inner]), np.concatenate([normals, -normals])
    own = normals[:4000] @ transform[:3, :3]
    found = refine_by_surfaces(source, turned, n, source_normals=own)
    np.testing.assert_allclose(found.transform, transform, atol=1e-6)


def test_landmarks_hold_what_the_surfaces_do_not_and_the_scale_is_found():
    """On a sphere the surfaces say nothing of the rotation; Eq. 6's scale is 1 % off and both sides say so."""
    rng = np.random.default_rng(5)
    d = rng.standard_normal((3000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    places = 0.1 * d[:14]
    spread = 0.002
    anchors = Anchors(1.01 * places, places, spread)
    found = refine_by_surfaces(1.01 * 0.1 * d[::2], 0.1 * d, d, source_normals=d[::2], anchors=anchors).transform
    np.testing.assert_allclose(found, np.diag([1 / 1.01] * 3 + [1.0]), atol=1e-4)


def test_noisy_landmarks_give_way_to_surfaces_that_determine_the_place():
    rng = np.random.default_rng(6)
    target, normals = egg(8000)
    places = target[rng.choice(len(target), 14)]
    wrong = places + [0.004, 0, 0]  # all landmarks 4 mm to one side, believed to 2 mm
    free = refine_by_surfaces(target[::2], target, normals, anchors=Anchors(places, places, 0.002)).transform
    np.testing.assert_allclose(free, np.eye(4), atol=1e-6)
    pulled = refine_by_surfaces(target[::2], target, normals, anchors=Anchors(places, wrong, 0.002)).transform
    assert np.linalg.norm(pulled[:3, 3]) < 0.0015


def test_rigid_icp_takes_the_steps_of_trimesh():
    body = builtin_body("male")
    # millimetres: trimesh's tolerances are absolute
    vertices = 1000 * body.vertices.astype(np.float64)
    turn = trimesh.transformations.rotation_matrix(0.03, [1, -1, 2])
    moved = trimesh.transform_points(vertices[::40], turn) + [5, -4, 6]
    found = rigid_icp(moved, triangle_index(vertices, body.faces), rounds=5)
    mesh = trimesh.Trimesh(vertices, body.faces, process=False)
    expected, _, _ = trimesh.registration.icp(moved, mesh, max_iterations=5, threshold=0, reflection=False, scale=False)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


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


def test_a_step_that_raises_the_cost_is_taken_back_and_factors_are_small():
    """The root of an arctangent: a full Gauss-Newton step from 3 leaps ever farther."""

    def assemble(x):
        equations = NormalEquations(1, 1)
        equations.add(0, np.array([[1 / (1 + x**2)]]), np.array([-np.arctan(x)]), np.ones(1))
        return equations, float(np.arctan(x) ** 2)

    moved = lambda x, own, shared: x + float(own[0, 0])
    assert abs(minimise(3.0, assemble, moved, 60)) < 1e-3
    # beyond 3 the cost is no number
    beyond = lambda x: (assemble(x)[0], np.nan if abs(x) > 3 else assemble(x)[1])
    assert abs(minimise(2.9, beyond, moved, 60)) < 1e-3
    matrix = grid_laplacian(12)
    truth = np.random.default_rng(0).normal(size=(12**3, 3))
    factors = factorised(matrix)
    assert factors.solve(matrix @ truth) == pytest.approx(truth, abs=1e-9)
    assert factors.nnz < 0.6 * splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0).nnz


def grid_laplacian(side):
    """Of a cube of side^3 points, held at every point by a little."""
    line, one = diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(side, side)), identity(side)
    along = [kron(kron(line, one), one), kron(kron(one, line), one), kron(kron(one, one), line)]
    return (sum(along) + 0.01 * identity(side**3)).tocsc()
