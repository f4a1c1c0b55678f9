"""Shoes: rings stacked round a flat foot, sole first, and under a raised heel a pin to the ground.

Frame: pose 0, pelvis at the origin, metres.
"""

import numpy as np
from jaxtyping import Bool, Float

from avatar.body import Body
from avatar.skeleton import JOINTS
from synth.people.cloth import Picture
from synth.people.looks import Looks, rgb
from synth.people.mesh import Piece, loft, reach, smoothstep, tube

AROUND, SOLE = 64, 5  # points of a ring; rings of the sole
HEIGHTS = {"pump": 0.032, "shoe": 0.075, "boot": 0.16}  # over the ground


def shoe_pieces(body: Body, looks: Looks) -> list[Piece]:
    """A pair, closed: pumps on heels or flat, sneakers, or boots."""
    height = shoe_height(looks)
    picture = np.zeros((32, 8, 3), np.uint8)
    picture[:8] = 0.25 * rgb(looks.shoe) if looks.heel else (228, 224, 216)
    picture[8:] = rgb(looks.shoe)
    return [_shoe(body, side, height, 0.006 if looks.heel else 0.016, picture) for side in (0, 1)]


def shoe_height(looks: Looks) -> float:
    """How far over the ground the shoes reach, metres."""
    return HEIGHTS["pump" if looks.heel else "boot" if looks.wear in ("coat", "skirt") else "shoe"]


def in_shoes(body: Body, looks: Looks) -> Bool[np.ndarray, "vertices"]:
    """Vertices of the feet that shoes hide."""
    return body.vertices[:, 1] < body.vertices[:, 1].min() + shoe_height(looks) - 0.012


def _shoe(body: Body, side: int, height: float, sole: float, picture: Picture) -> Piece:
    joints = body.joints
    ankle, ball = joints[7 + side], joints[10 + side]
    foot = body.vertices[(np.sign(body.vertices[:, 0]) == (1, -1)[side]) & (body.vertices[:, 1] < ankle[1] + 0.12)]
    ground = foot[:, 1].min()
    levels = np.r_[-sole, -sole, 0.002 - 0.6 * sole, 0.004, 0.005, np.linspace(0.007, height, 22)]
    stand = np.r_[-0.004, 0.005, 0.0075, 0.007, 0.005, np.full(22, 0.0045)]
    turn = 2 * np.pi * np.arange(AROUND) / AROUND
    rings = []
    for level, off in zip(levels, stand):
        above = foot[foot[:, 1] > ground + level - 0.010][:, [0, 2]]
        low, high = above.min(0), above.max(0)
        width, length = (high - low) / 2
        angle = np.arctan2(np.sin(turn) * width, np.cos(turn) * length)
        radius = reach(above - (low + high) / 2, angle) + off
        x, z = (low + high)[:, None] / 2 + radius * np.stack([np.sin(angle), np.cos(angle)])
        rings.append(np.stack([x, np.full(AROUND, ground + level), z], 1))
    out = np.array(rings)[::-1]
    for _ in range(5):
        out = 0.5 * out + 0.25 * (np.roll(out, 1, axis=1) + np.roll(out, -1, axis=1))
        out[1:-SOLE, :, [0, 2]] = (0.5 * out[1:-SOLE] + 0.25 * (out[:-SOLE - 1] + out[2 : 1 - SOLE]))[:, :, [0, 2]]
    v = np.r_[np.linspace(0.9, 0.4, len(out) - SOLE), np.full(SOLE, 0.1)]
    points, faces, uv = loft(out, np.linspace(0, 1, AROUND + 1), v, capped=True)
    # a shoe bends at the ball of the foot and at the ankle, not toe by toe
    weights = np.zeros((len(points), len(JOINTS)))
    weights[:, 10 + side] = smoothstep(-0.03, 0.03, points[:, 2] - ball[2] + 0.01)
    rest = 1 - weights[:, 10 + side]
    weights[:, 4 + side] = rest * smoothstep(ankle[1] - 0.01, ankle[1] + 0.05, points[:, 1])
    weights[:, 7 + side] = rest - weights[:, 4 + side]
    return Piece("shoe", points, faces, uv, weights, picture)


def heel_pieces(shoes: list[Piece]) -> list[Piece]:
    """The pins under the heels of posed shoes, down to where their balls stand."""
    ground, pins = min(shoe.points[:, 1].min() for shoe in shoes), []
    for side, shoe in enumerate(shoes):
        back = shoe.points[shoe.points[:, 2] < shoe.points[:, 2].min() + 0.05]
        foot = back[back[:, 1] < back[:, 1].min() + 0.035].mean(0)
        path = np.linspace(foot + [0, 0.012, 0.004], [foot[0], ground, foot[2] - 0.004], 8)
        radius = np.r_[0.022, 0.021, 0.017, 0.0135, 0.011, 0.0095, 0.0085, 0.008]
        points, faces, uv = loft(tube(path, radius), np.zeros(21), np.full(8, 0.1), capped=True)
        weights = np.zeros((len(points), len(JOINTS)))
        weights[:, 7 + side] = 1
        pins.append(Piece("shoe", points, faces, uv, weights, shoe.picture))
    return pins


def raised(heel: float) -> Float[np.ndarray, "52 3"]:
    """The pose of feet on heels: ankles bent by `heel`, toes flat on the ground; radians."""
    pose = np.zeros((len(JOINTS), 3))
    pose[7:9, 0], pose[10:12, 0] = heel, -heel
    return pose
