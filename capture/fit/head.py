"""The head's video: where the head is in every frame, from the face's points and its outline.

The head is rigid; what lies below the neck moves otherwise and is not looked at. Where no point of the face is seen,
the turn goes on evenly and the outline decides. What hair adds to the template is found between.
"""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.skeleton import JOINTS, PARTS
from capture.fit.body import CUTS, Report
from capture.fit.directions import LEAST, opposite, turns_about_y
from capture.fit.face import same_size, with_own_face
from capture.fit.footage import Estimate, Footage, unplaced
from capture.fit.offsets import STIFFNESS, dressed
from capture.fit.outline_term import Outlines
from capture.fit.person import Person
from capture.fit.priors import FROZEN, Priors, bias_of
from capture.fit.solve import placed_rigidly, solve
from capture.fit.standoff import head_outlined, scalp_standoff
from capture.keypoints.record import FACE
from capture.read.template import part_of

HEAD = JOINTS.index("head")
SLACK = 0.02
FIRST = 40.0
WEIGHTS = (0.05, 0.1, 0.1)
ROUNDS = 4
# the jaw's points slide along the outline; the chin stays
NAMES = ("nose", "left_eye", "right_eye", "left_ear", "right_ear", "face_08", *FACE[17:])


def first_guess(person: Person, g: Array, footage: Footage) -> Estimate:
    """The head's heading and place; where no point is seen, in between."""
    seen = footage.sure > 0
    # two ears alone say nothing; nose, eye and ear show a profile
    seen &= (seen.sum(1) >= LEAST)[:, None]
    return placed_rigidly(unplaced(person, g, footage), footage, HEAD, turns_about_y(6, (-32, -16, 0, 16, 32)), seen,
                          mirrored=opposite(footage.names), slack=SLACK)[0]  # fmt: skip


def turning(estimate: Estimate, footage: Footage) -> Priors:
    """Of a head that turns evenly."""
    still = np.full((52, 3), FROZEN)
    return Priors(np.zeros((52, 3)), still, still, estimate.g, FROZEN * estimate.person.sigma, footage.focal_sigma,
                  bias_of(footage.names), smooth_heading=np.radians(5.0), smooth_path=0.13)  # fmt: skip


def head_vertices(person: Person) -> Bool[Array, "vertices"]:
    return part_of(person.body.skin) == PARTS.index("head")


def fit_keypoints(person: Person, g: Array, footage: Footage) -> tuple[Estimate, Priors]:
    """The head's heading and place from keypoints alone; and what was believed before."""
    estimate = first_guess(person, g, footage)
    priors = turning(estimate, footage)
    return solve(estimate, footage, priors, cuts=(FIRST, *CUTS), rounds=10), priors


def fit_head(person: Person, g: Array, footage: Footage, report: Report) -> Estimate:
    """The whole video; the person comes back with the head's own offsets."""
    estimate, priors = fit_keypoints(person, g, footage)
    report("keypoints")
    # the face's profile places the head, but only the scalp is moved by outlines
    outlines, scalp = Outlines(footage), Outlines(footage, scalp_standoff())
    moving = scalp_standoff() > 0
    for number in range(len(WEIGHTS) + ROUNDS):
        weight = WEIGHTS[min(number, len(WEIGHTS) - 1)]
        estimate = same_size(outlines.fit(estimate, footage, priors, head_outlined(), (weight,), cut=CUTS[-1]), footage)
        if number >= len(WEIGHTS) - 1:
            estimate = dressed(estimate, footage, scalp, moving, STIFFNESS[2 * (number > len(WEIGHTS)) :])
        report("outlines")
    return with_own_face(estimate, footage, head_vertices(person))


def camera_from_head(estimate: Estimate) -> Float[Array, "frames 4 4"]:
    """OpenCV cameras round the head, whose frame is pose 0's: metres, and its axes."""
    joints = estimate.person.joints(estimate.g)
    flip = np.diag([1.0, -1.0, -1.0])
    out = np.tile(np.eye(4), (len(estimate.root), 1, 1))
    out[:, :3, :3] = flip @ estimate.heading
    # a stiff body: every point goes with the pelvis
    out[:, :3, 3] = (estimate.root - estimate.heading @ joints[0]) @ flip
    return out
