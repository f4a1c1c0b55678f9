"""The body's video: shape, bones, poses and focal length from keypoints; outlines, and what clothes add, follow."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from avatar.rotation import axis_angle_from_matrix
from avatar.skeleton import JOINTS, PARTS, joint_transforms
from capture.fit.directions import find_directions, opposite, place_of, turns_about_y
from capture.fit.footage import Estimate, Footage
from capture.fit.joint_turns import rotations
from capture.fit.offsets import STIFFNESS, dressed
from capture.fit.outline_term import Outlines
from capture.fit.person import Person
from capture.fit.priors import FROZEN, Priors, standing
from capture.fit.sides import exchanged_back, sides_restored
from capture.fit.solve import solve
from capture.imports.template import part_of
from capture.keypoints.record import SIDES

Array = np.ndarray
# told after each piece of work what it was
Report = Callable[[str], None]

# joints that a body's video shows; its hands keep the rest pose
MOVING = np.arange(1, 22)
LIMBS = "hip knee ankle shoulder elbow wrist eye ear heel big_toe small_toe".split()
# degrees by which arms that are held out hang
SAG = 8.0
# Geman and McClure's c, standard deviations: at first, then with all unknowns free
FIRST, CUTS = 20.0, (10.0, 4.0)
# of the outlines, one after the other
WEIGHTS = (0.02, 0.02, 0.02)


def body_names(*, hands: bool = True) -> tuple[str, ...]:
    """Named points that the body's video is fitted to: limbs, feet, head and the hands' knuckles."""
    knuckles = [f"{finger}{n}" for finger in ("thumb", "index", "middle", "ring", "pinky") for n in (1, 2, 3)]
    paired = (*LIMBS, *(knuckles if hands else ()))
    return ("nose", *(f"{side}_{name}" for side in SIDES for name in paired))


def first_guess(person: Person, footage: Footage) -> tuple[Estimate, Footage]:
    """Heading and place in every frame, in a T-pose with arms a little low; and the footage with sides put right."""
    g = np.zeros(len(person.sigma))
    points = footage.points
    angles = np.zeros((52, 3))
    for side in ("left", "right"):
        angles[JOINTS.index(f"{side}_shoulder"), 0] = -np.radians(SAG)
    vertices, joints = person.vertices(g), person.joints(g)
    rest = np.stack([p.place(vertices, joints) for p in points])
    bones = np.array([p.joint for p in points])
    G = joint_transforms(axis_angle_from_matrix(rotations(angles)), joints, np.zeros(3))
    x = np.einsum("nij,nj->ni", G[bones, :3, :3], rest - joints[bones]) + G[bones, :3, 3]
    found = find_directions(x, footage.pixels, footage.sure > 0, turns_about_y(), opposite(footage.names))
    root = place_of(found, footage.focal, footage.centre)
    estimate = Estimate(person, g, np.zeros((len(points), 3)), 0.0, angles, root, found.rotation,
                        np.tile(angles, (len(root), 1, 1)))  # fmt: skip
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
    estimate = solve(estimate, footage, rigid(priors), cut=FIRST, rounds=10)
    footage = sides_restored(estimate, footage)
    for cut in CUTS:
        estimate = solve(estimate, footage, priors, cut=cut, rounds=15)
        footage = sides_restored(estimate, footage)
        report("keypoints")
    return estimate, footage


def fit_outlines(estimate: Estimate, footage: Footage, report: Report) -> Estimate:
    """What stands off the shape, then shape and poses from outlines and keypoints; in turn.

    Clothes, hair and shoes come first: a bare body grows to fill the outline of a clothed one, and where its stature is
    told, it comes nearer instead.
    """
    priors, outlines = standing(estimate, footage), Outlines(footage)
    # a body's video shows hands as a few pixels: theirs have their own
    hands = hand_vertices(estimate.person)
    estimate = dressed(estimate, footage, outlines, ~hands, STIFFNESS)
    report("offsets")
    for weight in WEIGHTS:
        term = outlines.term(outlines.pairs(estimate, footage, ~hands), weight)
        estimate = solve(estimate, footage, priors, cut=CUTS[-1], rounds=3, terms=(term,))
        report("outlines")
        estimate = dressed(estimate, footage, outlines, ~hands, STIFFNESS[-1:])
        report("offsets")
    return estimate


def hand_vertices(person: Person, sides: tuple[str, ...] = ("left", "right")) -> Bool[Array, "vertices"]:
    """Vertices of the hands, wrists included."""
    part = part_of(person.body.skin)
    return np.isin(part, [PARTS.index(f"hand_{side}") for side in sides])
