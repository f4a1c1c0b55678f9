"""The pose of a known person in one picture: what a held-out picture is compared in, where nobody tells the pose.

Trunk and head say which way the person faces. One picture leaves open whether a foreshortened arm or thigh points
forwards or back; several beginnings are tried, and the one that ends at the lowest cost is kept: joint limits and the
outline decide.
"""

from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float, UInt8

from avatar.body import Body
from avatar.camera import Camera
from avatar.limits import limits
from avatar.skeleton import JOINTS
from capture.fit.body import MOVING, body_names, hand_vertices
from capture.fit.directions import find_directions, place_of, turns_about_y
from capture.fit.footage import Estimate, Footage, footage_of
from capture.fit.outline_term import Outlines
from capture.fit.person import known_person
from capture.fit.priors import Priors, bias_of
from capture.fit.scan import posed_video
from capture.fit.solve import assemble, solve
from capture.imports.template import Template
from capture.keypoints.record import SIDES, Keypoints

Array = np.ndarray

TRUNK = ("hip", "shoulder", "nose", "eye", "ear")
SLACK = 0.06
CUTS = (30.0, 10.0, 5.0)
WEIGHTS = (0.01, 0.02, 0.02, 0.02)
# degrees: shoulders forwards and raised, hips bent, that a fit begins from
ARMS = ((0, 0), (60, 0), (0, -60), (40, -60))
LEGS = (0, 70)
# of a joint's range, its standard deviation
SHARE = 0.3
OWN = np.radians(0.05)


def fit_pose(
    template: Template, keypoints: Keypoints, mask: UInt8[Array, "height width"], *, focal: float
) -> tuple[Camera, Float[Array, "52 3"], Float[Array, "3"]]:
    """Camera, axis-angle pose and root of a known person in one picture; `keypoints` holds one frame.

    The world is the camera's, +y up, the person at its origin.
    """
    footage = footage_of(keypoints, mask[None], body_names(), MOVING, focal=focal, focal_doubt=1e-4)
    nothing = np.zeros((len(template.vertices), 3, 0))
    body = Body("known", template.vertices, template.faces, template.skin, template.joints, nothing,
                np.zeros((52, 3, 0)), None, None, template.licence, np.zeros(3))  # fmt: skip
    unplaced = Estimate(known_person(body), np.zeros(0), np.zeros((len(footage.names), 3)), 0.0, np.zeros((52, 3)),
                        np.zeros((1, 3)), np.eye(3)[None], np.zeros((1, 52, 3)))  # fmt: skip
    guess = _facing(unplaced, footage)
    priors = _anyhow(footage)
    tried = [_from(guess, footage, priors, *start) for start in product(ARMS, LEGS)]
    estimate = min(tried, key=lambda estimate: assemble(estimate, footage, priors, CUTS[-1], ())[1])
    outlines, hands = Outlines(footage), hand_vertices(estimate.person)
    for weight in WEIGHTS:
        term = outlines.term(outlines.pairs(estimate, footage, ~hands), weight)
        estimate = solve(estimate, footage, priors, cut=CUTS[-1], rounds=4, terms=(term,))
    video = posed_video(estimate, footage, np.ones(1, bool), level=False)
    assert video.axis_angle is not None and video.root is not None
    return video.cameras[0], video.axis_angle[0], video.root[0]


def _facing(estimate: Estimate, footage: Footage) -> Estimate:
    """Heading and place, from trunk and head."""
    rest = estimate.markers(footage).rest
    trunk = np.array([any(part in name for part in TRUNK) for name in footage.names])
    found = find_directions(rest, footage.pixels, (footage.sure > 0) & trunk, turns_about_y(10, (-30, -15, 0, 15, 30)),
                            slack=SLACK)  # fmt: skip
    return replace(estimate, root=place_of(found, footage.focal, footage.centre), heading=found.rotation)


def _anyhow(footage: Footage) -> Priors:
    """Any pose within the joints' ranges."""
    table = limits()
    centre = np.clip(np.zeros((52, 3)), table.low, table.high)
    spread = SHARE * (table.high - table.low)
    return Priors(centre, spread, np.full((52, 3), OWN), np.zeros(0), np.zeros(0), footage.focal_doubt,
                  bias_of(footage.names))  # fmt: skip


def _from(guess: Estimate, footage: Footage, priors: Priors, arms: tuple[int, int], hip: int) -> Estimate:
    """The fit that begins with these arms and thighs."""
    angles = np.zeros((52, 3))
    for side in SIDES:
        angles[JOINTS.index(f"{side}_shoulder"), :2] = np.radians(arms[::-1])
        angles[JOINTS.index(f"{side}_hip"), 0] = angles[JOINTS.index(f"{side}_knee"), 0] = np.radians(hip)
    estimate = replace(guess, mean=angles, angles=angles[None])
    for cut in CUTS:
        estimate = solve(estimate, footage, priors, cut=cut, rounds=12)
    return estimate
