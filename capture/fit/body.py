"""The body's video: shape, bones, poses and focal length from keypoints; outlines, and what clothes add, follow."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from avatar.skeleton import JOINTS, PARTS
from capture.fit.directions import opposite, turns_about_y
from capture.fit.footage import Estimate, Footage, unplaced
from capture.fit.offsets import fit_dressed
from capture.fit.person import Person
from capture.fit.priors import FROZEN, Priors, standing
from capture.fit.sides import exchanged_back, sides_restored
from capture.fit.solve import placed_rigidly, solve
from capture.fit.standoff import body_standoff
from capture.keypoints.record import SIDES
from capture.read.template import part_of

# called after each piece of work with its name
Report = Callable[[str], None]

# joints that a body's video shows; its hands keep the rest pose
MOVING = np.arange(1, 22)
# points of the face: chin, brows, bridge, mouth; nose, eyes and ears alone leave a nod to how faces differ
FEATURES = tuple(f"face_{number:02d}" for number in (8, 17, 26, 27, 48, 54, 57))
LIMBS = "hip knee ankle shoulder elbow wrist eye ear heel big_toe small_toe".split()
# degrees by which arms that are held out hang
SAG = 8.0
# Geman and McClure's c, standard deviations: at first, then with all unknowns free
FIRST, CUTS = 20.0, (10.0, 4.0)
# the outlines' weights, one after the other
WEIGHTS = (0.02, 0.02, 0.02)


def body_names(*, hands: bool = True) -> tuple[str, ...]:
    """Named points that the body's video is fitted to: limbs, feet, head and the hands' knuckles."""
    knuckles = [f"{finger}{n}" for finger in ("thumb", "index", "middle", "ring", "pinky") for n in (1, 2, 3)]
    paired = (*LIMBS, *(knuckles if hands else ()))
    return ("nose", *FEATURES, *(f"{side}_{name}" for side in SIDES for name in paired))


def first_guess(person: Person, footage: Footage) -> tuple[Estimate, Footage]:
    """Heading and place in every frame, in a T-pose with arms a little low; and the footage with sides put right."""
    angles = np.zeros((52, 3))
    for side in ("left", "right"):
        angles[JOINTS.index(f"{side}_shoulder"), 0] = -np.radians(SAG)
    start = unplaced(person, np.zeros(len(person.sigma)), footage, angles)
    estimate, found = placed_rigidly(start, footage, 0, turns_about_y(), footage.sure > 0,
                                     mirrored=opposite(footage.names))  # fmt: skip
    return estimate, exchanged_back(footage, found.exchanged)


def rigid(priors: Priors) -> Priors:
    """Shape, bias and each frame's own pose held: place, heading and one pose for all frames are left."""
    return replace(priors, own=np.full((52, 3), np.radians(0.05)), g_sigma=FROZEN * priors.g_sigma,
                   bias=FROZEN * priors.bias, focal=FROZEN * priors.focal)  # fmt: skip


def fit_body(person: Person, footage: Footage, report: Report) -> Estimate:
    """The whole video: keypoints, outlines with shape, then offsets and poses in turn."""
    estimate, footage = fit_keypoints(person, footage, report)
    return fit_outlines(estimate, footage, report)


def fit_keypoints(person: Person, footage: Footage, report: Report) -> tuple[Estimate, Footage]:
    """Poses, bones, shape, focal length and the detector's bias from keypoints alone.

    Returns the footage as well, sides exchanged back where a detector had exchanged them.
    """
    estimate, footage = first_guess(person, footage)
    report("first guess")
    priors = standing(estimate, footage)
    estimate = solve(estimate, footage, rigid(priors), cuts=(FIRST,), rounds=10)
    footage = sides_restored(estimate, footage)
    for cut in CUTS:
        estimate = solve(estimate, footage, priors, cuts=(cut,), rounds=15)
        footage = sides_restored(estimate, footage)
        report("keypoints")
    return estimate, footage


def fit_outlines(estimate: Estimate, footage: Footage, report: Report) -> Estimate:
    """`fit_dressed`; a body's video shows head and hands as a few pixels: their own videos have their own fits."""
    priors, standoff = standing(estimate, footage), body_standoff()
    return fit_dressed(estimate, footage, priors, standoff > 0, WEIGHTS, CUTS[-1], report, standoff)


def hand_vertices(person: Person, sides: tuple[str, ...] = ("left", "right")) -> Bool[Array, "vertices"]:
    """Vertices of the hands, wrists included."""
    part = part_of(person.body.skin)
    return np.isin(part, [PARTS.index(f"hand_{side}") for side in sides])
