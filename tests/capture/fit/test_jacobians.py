"""Every derivative of the fit against finite differences."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.kinematics import pose_rows, posed, shape_rows, skinned
from capture.fit.contours import Silhouette
from capture.fit.outline_term import Outlines
from capture.fit.priors import shared_layout, standing
from capture.fit.solve import assemble, moved
from tests.turning_twin import turning_twin


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
    pairs = [Silhouette(chosen, rng.uniform(90, 160, (40, 2)), normals)] * 5
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
    nothing = Silhouette(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
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
        return frame, points, (c * skinned(frame, points)).sum(1)

    frame, points, _ = at(truth)
    rows = pose_rows(frame, points, c, footage.turning), shape_rows(frame, points, c)
    layout = shared_layout(truth, footage)
    own, shared = np.zeros((3, rows[0].shape[1])), np.zeros(layout.count)
    own[1], shared[layout.g] = rng.standard_normal(rows[0].shape[1]), rng.standard_normal(rows[1].shape[1])
    ahead, behind = (at(moved(truth, footage, s * 1e-6 * own, s * 1e-6 * shared))[2] for s in (1, -1))
    expected = rows[0] @ own[1] + rows[1] @ shared[layout.g]
    np.testing.assert_allclose((ahead - behind) / 2e-6, expected, rtol=1e-5, atol=1e-6)
