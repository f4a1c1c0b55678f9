"""What is believed before a picture is seen: joint angles near those of the video's posture, and smooth in time.

Angles are flexion, abduction and twist (avatar/limits.py). Twists are seen worst and may vary least; that also shares a
straight arm's turn out over shoulder, elbow and wrist in fixed proportions, which its outline and its joints cannot.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.kinematics import second_turns
from avatar.limits import limits
from avatar.skeleton import JOINTS
from capture.fit.footage import Estimate, Footage
from geometry.least_squares import NormalEquations, robust_cost, robust_weight

SPINE = [JOINTS.index(name) for name in ("spine1", "spine2", "spine3")]
NECK = [JOINTS.index(name) for name in ("neck", "head")]
# standard deviations in degrees; who is filmed looks ahead, and a head that nods would be taken for a longer neck
MEAN, MEAN_SPINE, MEAN_HEAD = 8.0, 2.0, 4.0
OWN, OWN_SPINE = 4.5, 1.5
OWN_LEGS = 6.0
LEGS = [JOINTS.index(f"{side}_{name}") for side in ("left", "right") for name in ("hip", "knee")]
SMOOTH = 1.5
# metres; ears, heels and toes are places of a few centimetres, a face's points are not. Looser ones let all points move
# away from a body that shrinks
BIAS = (("ear", 0.01), ("heel", 0.015), ("toe", 0.015), ("face", 0.007), ("nose", 0.007), ("eye", 0.007),
        *((finger, 0.004) for finger in ("thumb", "index", "middle", "ring", "pinky", "hand")))  # fmt: skip
BIAS_JOINT = 0.01
# standard deviation of a degree beyond a joint's range
BEYOND = 1.0
FROZEN = 1e-3
# coefficients of a second difference
STEPS = (1.0, -2.0, 1.0)
# standard deviations of the path's second difference from which on it says little (Geman-McClure's c)
STEP_ASIDE = 4.0
# and of the heading's, radians: turns are quick at times
JUMP = np.radians(30.0)


@dataclass(frozen=True)
class Priors:
    """Standard deviations, radians and metres."""

    centre: Float[Array, "52 3"]  # expected mean pose
    mean: Float[Array, "52 3"]  # deviation of the mean pose from it
    own: Float[Array, "52 3"]  # deviation of each frame's pose from the mean
    g: Float[Array, "g"]  # the shape that is expected
    g_sigma: Float[Array, "g"]
    focal: float  # relative
    bias: Float[Array, "points"]
    stature: float = 0.001
    # second differences from frame to frame
    smooth: float = np.radians(SMOOTH)
    smooth_heading: float = np.radians(8.0)
    # the root's bearings and the logarithm of its distance: a person who sways by a centimetre, half a second from
    # frame to frame; a step to the side counts less
    smooth_path: float = 0.005
    # metres, the root's own instead, where the person need not be before the camera
    smooth_root: float | None = None


def standing(estimate: Estimate, footage: Footage) -> Priors:
    """Priors of a person who stands in the T-pose, arms a little low, and turns."""
    centre = np.zeros((52, 3))
    mean, own = np.full((52, 3), np.radians(MEAN)), np.full((52, 3), np.radians(OWN))
    mean[NECK, 0] = np.radians(MEAN_HEAD)
    mean[SPINE], own[SPINE] = np.radians(MEAN_SPINE), np.radians(OWN_SPINE)
    # knees lift and hips follow when a person steps round
    own[LEGS] = np.radians(OWN_LEGS)
    mean[:, 2] *= 0.5
    own[:, 2] *= 0.5
    expected = np.zeros_like(estimate.g)
    return Priors(centre, mean, own, expected, estimate.person.sigma, footage.focal_sigma, bias_of(footage.names))


def bias_of(names: tuple[str, ...]) -> Float[Array, "points"]:
    """How far from its place on our body a detector may see a point, metres."""
    return np.array([next((sigma for part, sigma in BIAS if part in name), BIAS_JOINT) for name in names])


class Shared(NamedTuple):
    g: slice
    bias: slice
    focal: int
    mean: slice
    count: int


def shared_layout(estimate: Estimate, footage: Footage) -> Shared:
    g, points, angles = len(estimate.g), 3 * len(footage.names), 3 * len(footage.moving)
    mean = g + points + 1
    return Shared(slice(0, g), slice(g, g + points), g + points, slice(mean, mean + angles), mean + angles)


def add_priors(equations: NormalEquations, estimate: Estimate, footage: Footage, priors: Priors) -> float:
    """Add all terms of this file; returns their cost."""
    shared, moving = shared_layout(estimate, footage), footage.moving
    cost = _add_shared(equations, estimate, footage, priors, shared)
    # a frame's unknowns: root 3, pelvis 3, angles
    count = 3 * len(moving)
    own = priors.own[moving].ravel()
    away = estimate.angles[:, moving].reshape(len(estimate.root), count) - estimate.mean[moving].ravel()
    at, rows = np.arange(count), 6 + np.arange(count)
    cost += equations.hold(rows, away, 1 / own**2)
    equations.border[:, rows, shared.mean.start + at] -= 1 / own**2
    equations.shared[shared.mean.start + at, shared.mean.start + at] += len(away) / own**2
    equations.b_shared[shared.mean] += (away / own**2).sum(0)
    # angles beyond a joint's range are pulled back
    table, angles = limits(), estimate.angles[:, moving]
    beyond = (angles - np.clip(angles, table.low[moving], table.high[moving])).reshape(len(angles), -1)
    cost += equations.hold(rows, beyond, np.where(beyond != 0, 1 / np.radians(BEYOND) ** 2, 0.0))
    return cost + _add_smoothness(equations, estimate, footage, priors)


def _add_shared(
    equations: NormalEquations, estimate: Estimate, footage: Footage, priors: Priors, shared: Shared
) -> float:
    H, b = equations.shared, equations.b_shared
    cost = 0.0

    def hold(where: Array, away: Array, sigma: Array | float) -> float:
        H[where, where] += 1 / np.square(sigma)
        b[where] -= away / np.square(sigma)
        return float(np.square(away / sigma).sum())

    index = np.arange(shared.count)
    cost += hold(index[shared.g], estimate.g - priors.g, priors.g_sigma)
    cost += hold(index[shared.bias], estimate.bias.ravel(), np.repeat(priors.bias, 3))
    cost += hold(index[shared.focal : shared.focal + 1], np.array([estimate.log_focal]), priors.focal)
    mean = (estimate.mean - priors.centre)[footage.moving].ravel()
    cost += hold(index[shared.mean], mean, priors.mean[footage.moving].ravel())
    height, row = estimate.person.height()
    away = height + row @ estimate.g - estimate.person.stature
    H[shared.g, shared.g] += np.outer(row, row) / priors.stature**2
    b[shared.g] -= row * away / priors.stature**2
    return cost + float((away / priors.stature) ** 2)


def _add_smoothness(equations: NormalEquations, estimate: Estimate, footage: Footage, priors: Priors) -> float:
    """Second differences of root, heading and angles are small."""
    frames, moving = len(estimate.root), footage.moving
    if frames < 3:
        return 0.0
    angles = estimate.angles[:, moving].reshape(frames, -1, 1)
    second, one = angles[:-2] - 2 * angles[1:-1] + angles[2:], np.ones((1, 1, 1, 1))
    weight = np.full((1, 1), 1 / priors.smooth**2)
    equations.add_second_difference(
        6 + np.arange(angles.shape[1])[:, None], second, [step * one for step in STEPS], weight
    )
    cost = float((second**2).sum()) / priors.smooth**2 + _add_smooth_path(equations, estimate.root, priors)
    a, rows = second_turns(estimate.heading[:, None])
    # turns are quick at times: a jump counts less
    e, sigma = (a**2).sum(2), priors.smooth_heading
    equations.add_second_difference(np.array([[3, 4, 5]]), a, rows, robust_weight(e, JUMP) / sigma**2)
    return cost + float(robust_cost(e, JUMP).sum()) / sigma**2


def _add_smooth_path(equations: NormalEquations, root: Float[Array, "frames 3"], priors: Priors) -> float:
    """Second differences of where the root is are small: of its bearings x / z, y / z and its distance's logarithm.

    In metres, a person who comes nearer, and is smaller, would move less: this would draw everybody nearer.
    """
    if priors.smooth_root is None:
        x, y, z = root.T
        one, nothing = np.ones_like(z), np.zeros_like(z)
        path, sigma = np.stack([x / z, y / z, np.log(-z)], 1), priors.smooth_path
        rows = np.stack([one, nothing, -x / z, nothing, one, -y / z, nothing, nothing, one], 1).reshape(-1, 3, 3)
        rows /= z[:, None, None]
    else:
        path, sigma, rows = root, priors.smooth_root, np.broadcast_to(np.eye(3), (len(root), 3, 3))
    inner = len(root) - 2
    second = (path[:-2] - 2 * path[1:-1] + path[2:]) / sigma
    e = (second**2).sum(1)
    each = [STEPS[i] / sigma * rows[i : inner + i, None] for i in range(3)]
    equations.add_second_difference(np.array([[0, 1, 2]]), second[:, None], each, robust_weight(e, STEP_ASIDE)[:, None])
    return float(robust_cost(e, STEP_ASIDE).sum())
