"""How the person sits under the head in every frame of the head's video: neck and head turn against a trunk that stays
upright.

The head is held where it was found. Two shoulders, often at the picture's edge, say how the trunk turns and leans to
the side, but hardly how it leans forward. Who is filmed on a chair that turns leans little, while the head nods: so
the trunk's axis is the same in all frames. Arms hang.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.kinematics import Posed
from avatar.limits import axis_angle_from_joint_angles
from avatar.skeleton import JOINTS
from capture.fit.body import CUTS, FIRST
from capture.fit.footage import Estimate, Footage, footage_of
from capture.fit.keypoint_term import projected
from capture.fit.priors import FROZEN, NECK, Priors
from capture.fit.refusals import misfits
from capture.fit.solve import posed_frames, solve
from capture.keypoints.record import SIDES, Keypoints
from capture.raw.outline import HANGING
from geometry.least_squares import NormalEquations

SHOULDERS = tuple(f"{side}_shoulder" for side in SIDES)
# degrees: the mean pose of neck and head; nods, and what is across them, of single frames
MEAN, NOD, ACROSS = 4.0, 20.0, 4.0
# standard deviation of the trunk's axis, degrees
LEAN = 1.0
# pixels of a picture 1080 high: of the head's own points, which are where they were found
HELD = 1.0
# metres: a detector's shoulder beside ours, which hangs on a template of a body seen from afar; standard deviations of
# pixels from which on no trunk explains the shoulders
SHOULDER_OFF, UNEXPLAINED = 0.03, 10.0
# what an increment of the pelvis' turn adds to its axis, in its own frame: d x y
TILT = np.array([[0.0, 0, -1], [0, 0, 0], [1, 0, 0]])


def trunk_angles(head: Estimate, footage: Footage, keypoints: Keypoints) -> Float[Array, "frames 52 3"] | None:
    """Joint angles (axis-angle) of a person whose head `footage` was fitted to; None where no shoulder was seen, or
    they are where no trunk under that head has them."""
    focal = footage.focal * float(np.exp(head.log_focal))
    shoulders = footage_of(keypoints, footage.masks, SHOULDERS, np.array(NECK), focal=focal, focal_sigma=FROZEN)
    if not shoulders.sure.any():
        return None
    stiff = replace(head, bias=np.zeros_like(head.bias))
    at = projected(stiff, footage, posed_frames(stiff))
    held = np.full(at.shape[:2], 1080 / min(footage.size) / HELD)
    seen = replace(
        shoulders, names=(*footage.names, *shoulders.names), pixels=np.concatenate([at, shoulders.pixels], 1),
        sure=np.concatenate([held, shoulders.sure], 1),
    )  # fmt: skip
    hanging = np.zeros((52, 3))
    for side in SIDES:
        hanging[JOINTS.index(f"{side}_shoulder"), 0] = -HANGING
    start = replace(
        head, bias=np.zeros((len(seen.names), 3)), log_focal=0.0, mean=hanging,
        angles=np.tile(hanging, (len(at), 1, 1)),
    )  # fmt: skip
    off = np.repeat((FROZEN, SHOULDER_OFF), (len(footage.names), len(shoulders.names)))
    fitted = solve(start, seen, seated(start, off), cuts=(FIRST, *CUTS), rounds=12, terms=(upright,))
    away = (misfits(fitted, seen) * seen.sure)[:, len(footage.names) :]
    return axis_angle_from_joint_angles(fitted.angles) if np.nanmedian(away) <= UNEXPLAINED else None


def seated(start: Estimate, bias: Float[Array, "points"]) -> Priors:
    """Of a person on a chair that turns, who nods."""
    mean, own = np.full((2, 52, 3), FROZEN)
    mean[NECK], own[NECK] = np.radians(MEAN), np.radians((NOD, ACROSS, ACROSS))
    # the pelvis swings about the head: its path is not smooth
    return Priors(start.mean.copy(), mean, own, start.g, FROZEN * start.person.sigma, FROZEN, bias,
                  smooth=np.radians(3.0), smooth_heading=np.radians(5.0), smooth_root=1.0)  # fmt: skip


def upright(equations: NormalEquations, estimate: Estimate, footage: Footage, frames: Posed) -> float:
    """Add the term that the trunk's axis is the same in all frames; returns its cost."""
    axes = estimate.heading[..., 1]
    mean = axes.mean(0) / np.linalg.norm(axes.mean(0))
    weight = np.full(3, 1 / np.radians(LEAN) ** 2)
    rows = np.zeros((3, 6 + 3 * len(footage.moving)))
    for f, heading in enumerate(estimate.heading):
        rows[:, 3:6] = heading @ TILT
        equations.add(f, rows, mean - axes[f], weight)
    return float(np.square(axes - mean).sum()) / np.radians(LEAN) ** 2
