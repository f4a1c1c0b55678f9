"""Gauss-Newton over all frames of a video, everything at once."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from avatar.rotation import matrix_from_axis_angle
from capture.fit.equations import Equations
from capture.fit.footage import Estimate, Footage
from capture.fit.keypoint_term import add_keypoints
from capture.fit.kinematics import Posed, posed
from capture.fit.priors import Priors, add_priors, shared_layout

Array = np.ndarray

# a term adds itself to the equations and returns its cost
Term = Callable[[Equations, Estimate, Footage, list[Posed]], float]
# share of the cost by which a step has to lower it to be worth another
SETTLED = 2e-4
# share added to the diagonal at first
DAMPING = 1e-4
# radians and metres that one step may change
LONGEST = 0.5


def posed_frames(estimate: Estimate) -> list[Posed]:
    """Every frame's skeleton."""
    skeleton = estimate.skeleton()
    return [posed(skeleton, *frame) for frame in zip(estimate.root, estimate.heading, estimate.angles)]


def solve(
    estimate: Estimate, footage: Footage, priors: Priors, *, cut: float, rounds: int, terms: tuple[Term, ...] = ()
) -> Estimate:
    """Lower keypoints (Geman-McClure's c = `cut`), priors and other terms by at most `rounds` steps.

    Levenberg and Marquardt's damping: a step that raises the cost is taken back and made shorter.
    """
    damping = DAMPING
    equations, cost = assemble(estimate, footage, priors, cut, terms)
    for _ in range(rounds):
        tried = moved(estimate, footage, *equations.solve(damping))
        others, other_cost = assemble(tried, footage, priors, cut, terms)
        if other_cost > cost:
            damping *= 20
            continue
        settled = cost - other_cost < SETTLED * cost
        estimate, equations, cost = tried, others, other_cost
        if settled:
            break
        damping = max(damping / 4, 1e-6)
    return estimate


def assemble(
    estimate: Estimate, footage: Footage, priors: Priors, cut: float, terms: tuple[Term, ...]
) -> tuple[Equations, float]:
    """The normal equations at an estimate, and its cost."""
    layout = shared_layout(estimate, footage)
    equations = Equations(len(estimate.root), 6 + 3 * len(footage.moving), layout.count)
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
        heading=estimate.heading @ matrix_from_axis_angle(own[:, 3:6]),
        angles=angles,
    )
