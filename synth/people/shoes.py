"""Shoes: rings stacked round a flat foot, sole last, and under a raised heel a pin to the ground.

Frame: pose 0, pelvis at the origin, metres.
"""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from avatar.body import Body
from synth.people.cloth import Picture
from synth.people.looks import Looks
from synth.people.mesh import PersonPiece, ended, loft, reach, smoothstep, tube

AROUND = 64
# how far they stand off the foot, sole first
OFF = np.r_[-0.004, 0.005, 0.0075, 0.007, 0.005, np.full(22, 0.0045)]


def shoe_height(looks: Looks) -> float:
    """How far over the ground the shoes reach, metres: pumps, boots, or sneakers."""
    return 0.032 if looks.heel else 0.16 if looks.wear in ("coat", "skirt") else 0.075


def in_shoes(body: Body, looks: Looks) -> Bool[Array, "vertices"]:
    return body.vertices[:, 1] < body.vertices[:, 1].min() + shoe_height(looks) - 0.012


def shoe_pieces(body: Body, looks: Looks) -> list[PersonPiece]:
    """A pair, closed, round flat feet."""
    picture = np.tile(np.array(looks.shoe, np.uint8), (32, 8, 1))
    picture[:8] = picture[:8] // 4 if looks.heel else (228, 224, 216)
    return [_shoe(body, side, shoe_height(looks), 0.006 if looks.heel else 0.016, picture) for side in (0, 1)]


def _shoe(body: Body, side: int, height: float, sole: float, picture: Picture) -> PersonPiece:
    ankle, ball = body.joints[7 + side], body.joints[10 + side]
    foot = body.vertices[(np.sign(body.vertices[:, 0]) == (1, -1)[side]) & (body.vertices[:, 1] < ankle[1] + 0.12)]
    ground = foot[:, 1].min()
    levels = np.r_[-sole, -sole, 0.002 - 0.6 * sole, 0.004, 0.005, np.linspace(0.007, height, 22)]
    turn = 2 * np.pi * np.arange(AROUND) / AROUND
    rings = []
    # the outline of what of the foot lies above, so that the instep rises as the ring's front recedes
    for level, off in zip(levels, OFF, strict=True):
        above = foot[foot[:, 1] > ground + level - 0.010][:, [0, 2]]
        width, length = np.ptp(above, axis=0)
        angle = np.arctan2(np.sin(turn) * width, np.cos(turn) * length)
        middle = (above.min(0) + above.max(0)) / 2
        radius = reach(above - middle, angle) + off
        across, along = middle[:, None] + radius * [np.sin(angle), np.cos(angle)]
        rings.append(np.stack([across, np.full(AROUND, ground + level), along], 1))
    out = np.array(rings)[::-1]
    for _ in range(5):
        out = 0.5 * out + 0.25 * (np.roll(out, 1, axis=1) + np.roll(out, -1, axis=1))
    v = np.r_[0.9, np.linspace(0.9, 0.4, 22), np.full(6, 0.1)]
    points, faces, uv = loft(ended(out), np.linspace(0, 1, AROUND + 1), v)
    # a shoe bends at the ball of the foot and at the ankle, not toe by toe
    weights = np.zeros((len(points), 52))
    weights[:, 10 + side] = toes = smoothstep(-0.03, 0.03, points[:, 2] - ball[2] + 0.01)
    weights[:, 4 + side] = shin = (1 - toes) * smoothstep(ankle[1] - 0.01, ankle[1] + 0.05, points[:, 1])
    weights[:, 7 + side] = 1 - toes - shin
    return PersonPiece("shoe", points, faces, uv, weights, picture)


def heel_pieces(shoes: list[PersonPiece]) -> list[PersonPiece]:
    """The pins under the heels of posed shoes, down to where their balls stand."""
    ground, pins = min(shoe.points[:, 1].min() for shoe in shoes), []
    for side, shoe in enumerate(shoes):
        back = shoe.points[shoe.points[:, 2] < shoe.points[:, 2].min() + 0.05]
        foot = back[back[:, 1] < back[:, 1].min() + 0.035].mean(0)
        path = np.linspace(foot + [0, 0.012, 0.004], [foot[0], ground, foot[2] - 0.004], 8)
        radius = np.tile([[0.022], [0.021], [0.017], [0.0135], [0.011], [0.0095], [0.0085], [0.008]], 20)
        points, faces, uv = loft(ended(tube(path, radius)), np.zeros(21), np.full(10, 0.1))
        pins.append(
            PersonPiece("shoe", points, faces, uv, np.tile(np.eye(52)[7 + side], (len(points), 1)), shoe.picture)
        )
    return pins


def raised(heel: float) -> Float[Array, "52 3"]:
    """The pose of feet on heels: ankles bent by `heel`, toes flat on the ground; radians."""
    pose = np.zeros((52, 3))
    pose[7:9, 0], pose[10:12, 0] = heel, -heel
    return pose
