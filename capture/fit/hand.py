"""A hand's video: where the hand is in every frame, and its fingers, from 21 points; its outline, and its own shape.

The person keeps the body's size, so a hand has one size; lengths of fingers and what stands off the template are the
hand's own. The arm is stretched out from the shoulder and carries the person along: nothing beyond the forearm is known
in a close-up, and nothing is trained there.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.skeleton import JOINTS
from capture.fit.body import CUTS, Report, hand_vertices, rigid
from capture.fit.directions import all_turns
from capture.fit.footage import Estimate, Footage, unplaced
from capture.fit.offsets import fit_dressed
from capture.fit.person import Person
from capture.fit.priors import FROZEN, Priors, bias_of
from capture.fit.solve import placed_rigidly, solve
from capture.keypoints.record import hand_points

# metres by which a flat, stiff hand may be off its points
SLACK = 0.025
# Geman and McClure's c of a first guess that is far off
FIRST = 60.0
# metres: standard deviation of a finger's bone, after the body's video
BONE = 0.004
# once its points have said it: outlines would make thicker fingers longer, and the hand nearer
KNOWN = 0.001
# degrees: a finger's curl, sideways, twist; of the mean pose, of single frames
CURL, MEAN_FINGER, OWN_FINGER = 10.0, (20.0, 7.0, 4.0), (5.0, 2.0, 1.0)
MEAN_WRIST, OWN_WRIST = (15.0, 10.0, 5.0), (12.0, 8.0, 4.0)
WEIGHTS = (0.05, 0.05)
# metres: a bare hand stands off the body's no farther; outlines that disagree would blow up fingers
BARE = 0.004


def hand_names(side: str) -> tuple[str, ...]:
    """Named points that a hand's video is fitted to."""
    return (*hand_points(side), f"{side}_wrist", f"{side}_elbow")


def hand_joints(side: str) -> np.ndarray:
    return np.array([JOINTS.index(f"{side}_wrist")] + [k for k in range(22, 52) if JOINTS[k].startswith(side)])


def first_guess(
    person: Person, g: Array, footage: Footage, side: str, angles: Float[Array, "52 3"] | None = None
) -> Estimate:
    """A stiff hand, flat without angles, turned every way in every frame; the best path."""
    # the elbow is far, and the wrist between them bends
    of_hand = np.array([p.joint != JOINTS.index(f"{side}_elbow") for p in footage.points])
    return placed_rigidly(unplaced(person, g, footage, angles), footage, JOINTS.index(f"{side}_wrist"), all_turns(),
                          (footage.sure > 0) & of_hand, slack=SLACK)[0]  # fmt: skip


def holding(estimate: Estimate, footage: Footage, side: str) -> Priors:
    """Of a hand that is held up, slightly bent, and turned."""
    centre, mean, own = np.zeros((3, 52, 3))
    wrist, *fingers = hand_joints(side)
    mean[wrist], own[wrist] = np.radians(MEAN_WRIST), np.radians(OWN_WRIST)
    centre[fingers, 0] = np.radians(CURL)
    mean[fingers], own[fingers] = np.radians(MEAN_FINGER), np.radians(OWN_FINGER)
    person = estimate.person
    g_sigma = np.where(person.fingers, BONE, FROZEN * person.sigma)
    # the pelvis swings about the hand: its path is not smooth
    return Priors(centre, mean, own, estimate.g, g_sigma, footage.focal_sigma, bias_of(footage.names),
                  smooth=np.radians(3.0), smooth_heading=np.radians(15.0), smooth_root=1.0)  # fmt: skip


def fit_keypoints(person: Person, g: Array, footage: Footage, side: str) -> tuple[Estimate, Priors]:
    """Place, wrist and fingers from keypoints alone; and what was believed before."""
    estimate = first_guess(person, g, footage, side)
    priors = holding(estimate, footage, side)
    estimate = solve(estimate, footage, rigid(priors), cuts=(FIRST,), rounds=10)
    return solve(estimate, footage, priors, cuts=(FIRST, *CUTS), rounds=12), priors


def fit_hand(person: Person, g: Array, footage: Footage, side: str, report: Report) -> Estimate:
    """The whole video; the person comes back with the hand's own fingers and offsets."""
    estimate, priors = fit_keypoints(person, g, footage, side)
    report("keypoints")
    priors = replace(priors, g=estimate.g, g_sigma=np.where(person.fingers, KNOWN, priors.g_sigma))
    own = hand_vertices(person, (side,))
    return fit_dressed(estimate, footage, priors, own, WEIGHTS, CUTS[-1], report, np.where(own, BARE, 0.0))
