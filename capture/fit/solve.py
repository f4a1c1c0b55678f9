"""Gauss-Newton over all frames of a video, everything at once."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.kinematics import Posed, posed, skinned, turned
from capture.fit.directions import SLACK, Directions, find_directions, place_of
from capture.fit.footage import Estimate, Footage
from capture.fit.keypoint_term import add_keypoints
from capture.fit.priors import Priors, add_priors, shared_layout
from geometry.least_squares import NormalEquations, minimise

# a term adds itself to the equations and returns its cost
Term = Callable[[NormalEquations, Estimate, Footage, Posed], float]
# radians and metres that one step may change
LONGEST = 0.5


def posed_frames(estimate: Estimate) -> Posed:
    return posed(estimate.skeleton(), estimate.root, estimate.heading, estimate.angles)


def placed_rigidly(
    estimate: Estimate, footage: Footage, joint: int, candidates: Float[Array, "n 3 3"],
    seen: Bool[Array, "frames points"], *, mirrored: Int[Array, "points"] | None = None, slack: float = SLACK,
) -> tuple[Estimate, Directions]:  # fmt: skip
    """The first pose of an estimate, stiff, turned about a joint and placed as the points of every frame say."""
    frame = posed(estimate.skeleton(), np.zeros(3), np.eye(3), estimate.angles[0])
    x = skinned(frame, estimate.markers(footage)) - frame.place[joint]
    found = find_directions(x, footage.pixels, seen, candidates, mirrored, slack)
    root = place_of(found, footage.focal, footage.centre) - found.rotation @ frame.place[joint]
    angles = np.tile(estimate.angles[:1], (len(root), 1, 1))
    return replace(estimate, root=root, heading=found.rotation, angles=angles), found


def solve(
    estimate: Estimate, footage: Footage, priors: Priors, *, cuts: tuple[float, ...], rounds: int,
    terms: tuple[Term, ...] = (),
) -> Estimate:  # fmt: skip
    """Lower keypoints, priors and other terms by at most `rounds` steps for each Geman-McClure's c of `cuts`."""
    for cut in cuts:
        estimate = minimise(estimate, lambda at, cut=cut: assemble(at, footage, priors, cut, terms),
                            lambda at, own, shared: moved(at, footage, own, shared), rounds)  # fmt: skip
    return estimate


def assemble(
    estimate: Estimate, footage: Footage, priors: Priors, cut: float, terms: tuple[Term, ...]
) -> tuple[NormalEquations, float]:
    """The normal equations of priors, keypoints and terms at an estimate, and their cost.

    `cut` is the residual, in standard deviations, from which a keypoint counts little.
    """
    layout = shared_layout(estimate, footage)
    equations = NormalEquations(len(estimate.root), 6 + 3 * len(footage.moving), layout.count)
    frames = posed_frames(estimate)
    cost = add_priors(equations, estimate, footage, priors)
    cost += add_keypoints(equations, estimate, footage, frames, cut)
    return equations, cost + sum(term(equations, estimate, footage, frames) for term in terms)


def moved(
    estimate: Estimate, footage: Footage, own: Float[Array, "frames own"], shared: Float[Array, "shared"]
) -> Estimate:
    """The estimate after a step."""
    layout, moving = shared_layout(estimate, footage), footage.moving
    shorter = min(1.0, LONGEST / max(float(np.abs(own[:, 3:]).max()), 1e-12))
    own, shared = own * shorter, shared * shorter
    angles, mean = estimate.angles.copy(), estimate.mean.copy()
    angles[:, moving] += own[:, 6:].reshape(len(own), -1, 3)
    mean[moving] += shared[layout.mean].reshape(-1, 3)
    return replace(
        estimate,
        g=estimate.g + shared[layout.g],
        bias=estimate.bias + shared[layout.bias].reshape(-1, 3),
        log_focal=estimate.log_focal + float(shared[layout.focal]),
        mean=mean,
        root=estimate.root + own[:, :3],
        heading=turned(estimate.heading, own[:, 3:6]),
        angles=angles,
    )
