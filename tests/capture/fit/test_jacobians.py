"""Every derivative of the fit against finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from capture.fit.equations import Equations
from capture.fit.joint_turns import right_jacobian, rotations, turns
from capture.fit.kinematics import carried, pixel_rows, pose_rows, posed, seen_at, shape_rows, skinned
from capture.fit.outline_term import Outlines, Pairs
from capture.fit.priors import shared_layout, standing
from capture.fit.solve import assemble, moved
from tests.turning_twin import turning_twin


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.0099, 0.0101, 1.0, 3.0])
def test_right_jacobian_turns_as_the_exponential_does(angle):
    v = angle * np.array([0.6, -0.64, 0.48])
    for axis in np.eye(3):
        moved = matrix_from_axis_angle(-v) @ matrix_from_axis_angle(v + 1e-6 * axis)
        np.testing.assert_allclose(axis_angle_from_matrix(moved) / 1e-6, right_jacobian(v) @ axis, atol=5e-6)


def test_joint_angles_turn_their_joints_as_told():
    rng = np.random.default_rng(0)
    angles = rng.normal(0, 0.5, (52, 3))
    told = turns(angles)
    for k in range(3):
        changed = angles.copy()
        changed[:, k] += 1e-6
        seen = axis_angle_from_matrix(np.swapaxes(rotations(angles), 1, 2) @ rotations(changed)) / 1e-6
        np.testing.assert_allclose(seen, told[:, :, k], atol=5e-6)


def gradient_of(estimate, footage, priors, terms, own, shared):
    """Slope of half the cost along a step: from differences, and as the equations tell."""
    equations = assemble(estimate, footage, priors, 1e6, terms)[0]
    told = -((equations.b * own).sum() + (equations.b_shared * shared).sum())
    h = 1e-6
    ahead, behind = (
        assemble(moved(estimate, footage, s * h * own, s * h * shared), footage, priors, 1e6, terms)[1] for s in (1, -1)
    )
    return 0.5 * (ahead - behind) / (2 * h), told


@pytest.mark.parametrize("what", ["root", "pelvis", "angles", "g", "bias", "focal", "mean"])
def test_cost_changes_as_the_equations_say(what):
    rng = np.random.default_rng(3)
    truth, footage = turning_twin(5)
    # smooth turns are weighed robustly, which the equations take as fixed
    priors = replace(standing(truth, footage), smooth_heading=1e3)
    estimate = replace(truth, angles=truth.angles + rng.normal(0, 0.1, truth.angles.shape),
                       bias=rng.normal(0, 0.01, truth.bias.shape), log_focal=0.03)  # fmt: skip
    chosen = rng.integers(0, len(truth.person.body.vertices), 40)
    normals = rng.standard_normal((40, 2))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    pairs = [Pairs(chosen, rng.uniform(90, 160, (40, 2)), normals)] * 5
    outlines = Outlines(footage)
    layout = shared_layout(estimate, footage)
    own, shared = np.zeros((5, 6 + 3 * len(footage.moving))), np.zeros(layout.count)
    where = {"root": slice(0, 3), "pelvis": slice(3, 6), "angles": slice(6, None)}
    if what in where:
        own[:, where[what]] = rng.standard_normal(own[:, where[what]].shape)
    else:
        at = {"g": layout.g, "bias": layout.bias, "focal": layout.focal, "mean": layout.mean}[what]
        shared[at] = rng.standard_normal(np.shape(shared[at]))
    # outlines are robust as well: their pairs stay within the flat part of the weight only for a tiny weight
    for terms, tolerance in (((), 1e-4), ((outlines.term(pairs, 1e-9),), 1e-4)):
        seen, told = gradient_of(estimate, footage, priors, terms, own, shared)
        assert told == pytest.approx(seen, rel=tolerance)


def test_an_outline_none_of_whose_points_is_near_says_nothing():
    estimate, footage = turning_twin(3)
    priors = standing(estimate, footage)
    nothing = Pairs(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
    cost = assemble(estimate, footage, priors, 1e6, ())[1]
    equations, with_outline = assemble(estimate, footage, priors, 1e6, (Outlines(footage).term([nothing] * 3, 1.0),))
    assert with_outline == cost
    assert np.isfinite(equations.solve(1.0)[0]).all()


def test_points_of_the_skin_move_with_pose_and_shape_as_told():
    rng = np.random.default_rng(1)
    truth, footage = turning_twin(3)
    vertices = rng.integers(0, len(truth.person.body.vertices), 30)
    c = rng.standard_normal((30, 3))

    def at(estimate):
        points = estimate.skin(vertices)
        frame = posed(estimate.skeleton(), estimate.root[1], estimate.heading[1], estimate.angles[1])
        by_bone = carried(frame, points)
        return frame, points, by_bone, (c * skinned(points, by_bone)).sum(1)

    frame, points, by_bone, _ = at(truth)
    rows = pose_rows(frame, points, by_bone, c, footage.moving), shape_rows(frame, points, c)
    layout = shared_layout(truth, footage)
    own, shared = np.zeros((3, rows[0].shape[1])), np.zeros(layout.count)
    own[1], shared[layout.g] = rng.standard_normal(rows[0].shape[1]), rng.standard_normal(rows[1].shape[1])
    ahead, behind = (at(moved(truth, footage, s * 1e-6 * own, s * 1e-6 * shared))[3] for s in (1, -1))
    expected = rows[0] @ own[1] + rows[1] @ shared[layout.g]
    np.testing.assert_allclose((ahead - behind) / 2e-6, expected, rtol=1e-5, atol=1e-6)


def test_pixels_move_with_points_as_told():
    truth, footage = turning_twin(3)
    lens = truth.lens(footage)
    x = np.random.default_rng(2).uniform(-1, 1, (20, 3)) - [0, 0, 3]
    for k, axis in enumerate(np.eye(3)):
        seen = (seen_at(lens, x + 1e-6 * axis) - seen_at(lens, x - 1e-6 * axis)) / 2e-6
        np.testing.assert_allclose(seen, pixel_rows(lens, x)[:, :, k], rtol=1e-6, atol=1e-5)


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
    equations = Equations(frames, own, shared)
    for a in range(frames):
        for apart in range(min(3, frames - a)):
            other = a + apart
            equations.near[apart][a] = H[a * own : (a + 1) * own, other * own : (other + 1) * own]
        equations.border[a] = H[a * own : (a + 1) * own, frames * own :]
    equations.shared[:] = H[frames * own :, frames * own :]
    equations.b[:], equations.b_shared[:] = b[: frames * own].reshape(frames, own), b[frames * own :]
    x, y = equations.solve(0.0)
    np.testing.assert_allclose(np.r_[x.ravel(), y], np.linalg.solve(H, b), atol=1e-10)
