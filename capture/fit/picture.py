"""The pose of a known person in one picture: what a held-out picture is compared in, where its pose is not given.

1. Trunk and head say which way the person faces. One picture leaves open whether a foreshortened arm or thigh points
   forwards or back; keypoints alone are fitted from several beginnings, and the one that ends at the lowest cost is
   kept.
2. The outline follows. What it is of may be thicker or thinner than the template (clothes, hair): by how much is an
   unknown in each of five regions. A person of known size fills a larger outline only by coming nearer with bent limbs.

In one picture a point's bias and its noise look alike: both are its uncertainty.
"""

from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from avatar.camera import Camera
from avatar.limits import limits
from avatar.skeleton import JOINTS
from avatar.skinning import dense_weights
from capture.fit.body import MOVING, body_names, hand_vertices
from capture.fit.directions import turns_about_y
from capture.fit.footage import Estimate, Footage, footage_of, unplaced
from capture.fit.outline_term import Outlines
from capture.fit.person import Person, known_person
from capture.fit.priors import Priors, bias_of
from capture.fit.scan import posed_video
from capture.fit.solve import assemble, placed_rigidly, solve
from capture.keypoints.record import SIDES, Keypoints
from capture.read.template import TemplateMesh
from geometry.mesh import vertex_normals

TRUNK = ("hip", "shoulder", "nose", "eye", "ear")
SLACK = 0.06
CUTS = (30.0, 10.0, 5.0)
WEIGHTS = (0.01, 0.02, 0.02, 0.02)
# degrees: shoulders forwards and raised, hips bent, that a fit begins from
ARMS = ((0, 0), (60, 0), (0, -60), (40, -60))
LEGS = (0, 70)
# standard deviation as a share of a joint's range: people rarely go to the ends, and a wide one lets limbs bend unseen
SHARE = 0.15
OWN = np.radians(0.05)
# share of a video's own detector bias: in one picture such a bias looks like a turn
ONE_PICTURE = 0.2
# joints whose surface is thicker or thinner together, and the standard deviation, metres
REGIONS = (("neck", "head"), ("pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar"),
           *(tuple(f"{side}_{name}" for side in SIDES for name in names)
             for names in (("shoulder", "elbow"), ("hip", "knee"), ("ankle", "foot"))))  # fmt: skip
THICKNESS = 0.01
# metres: a thickness changes the height as well, which is unknown here
ANY_HEIGHT = 10.0


def fit_pose(
    template: TemplateMesh, keypoints: Keypoints, mask: UInt8[Array, "height width"], *, focal: float
) -> tuple[Camera, Float[Array, "52 3"], Float[Array, "3"]]:
    """Camera, axis-angle pose and root of a known person in one picture; `keypoints` holds one frame.

    The world is the camera's, +y up, the person at its origin.
    """
    footage = footage_of(keypoints, mask[None], body_names(), MOVING, focal=focal, focal_sigma=1e-4)
    trunk = np.array([any(part in name for part in TRUNK) for name in footage.names])
    turns = turns_about_y(10, (-30, -15, 0, 15, 30))
    guess, _ = placed_rigidly(unplaced(known_person(template), np.zeros(0), footage), footage, 0, turns,
                              (footage.sure > 0) & trunk, slack=SLACK)  # fmt: skip
    # the points' bias, seen from that far off, is among their uncertainty
    bias = footage.focal / -guess.root[0, 2] * bias_of(footage.names)
    sigma = 1 / np.maximum(footage.sure, 1e-12)
    footage = replace(footage, sure=np.where(footage.sure > 0, 1 / np.hypot(sigma, bias), 0.0))
    priors = anyhow(footage, SHARE)
    tried = [_from(guess, footage, priors, *start) for start in product(ARMS, LEGS)]
    best = min(tried, key=lambda estimate: assemble(estimate, footage, priors, CUTS[-1], ())[1])
    person = with_thickness(best.person)
    nothing = np.zeros(len(person.sigma))
    priors = replace(priors, g=nothing, g_sigma=person.sigma, stature=ANY_HEIGHT)
    estimate = Outlines(footage).fit(replace(best, person=person, g=nothing), footage, priors, ~hand_vertices(person),
                                     WEIGHTS, cut=CUTS[-1], rounds=4)  # fmt: skip
    video = posed_video(estimate, footage, np.ones(1, bool), level=False)
    assert video.axis_angle is not None and video.root is not None
    return video.cameras[0], video.axis_angle[0], video.root[0]


def anyhow(footage: Footage, share: float) -> Priors:
    """Any pose within the joints' ranges, whose standard deviation is a `share` of them."""
    table = limits()
    centre = np.clip(np.zeros((52, 3)), table.low, table.high)
    spread = share * (table.high - table.low)
    return Priors(centre, spread, np.full((52, 3), OWN), np.zeros(0), np.zeros(0), footage.focal_sigma,
                  ONE_PICTURE * bias_of(footage.names))  # fmt: skip


def _from(guess: Estimate, footage: Footage, priors: Priors, arms: tuple[int, int], hip: int) -> Estimate:
    """The fit that begins with these arms and thighs."""
    angles = np.zeros((52, 3))
    for side in SIDES:
        angles[JOINTS.index(f"{side}_shoulder"), :2] = np.radians(arms[::-1])
        angles[JOINTS.index(f"{side}_hip"), 0] = angles[JOINTS.index(f"{side}_knee"), 0] = np.radians(hip)
    estimate = replace(guess, mean=angles, angles=angles[None])
    return solve(estimate, footage, priors, cuts=CUTS, rounds=12)


def with_thickness(person: Person) -> Person:
    """A known person whose surface stands off along its normals by one unknown in each of REGIONS; joints stay."""
    body = person.body
    normals, weights = vertex_normals(body.vertices, body.faces), dense_weights(body.skin)
    shares = np.stack([weights[:, [JOINTS.index(name) for name in names]].sum(1) for names in REGIONS], -1)
    return replace(person, vertex_directions=normals[:, :, None] * shares[:, None],
                   joint_directions=np.zeros((52, 3, len(REGIONS))), sigma=np.full(len(REGIONS), THICKNESS),
                   fingers=np.zeros(len(REGIONS), bool))  # fmt: skip
