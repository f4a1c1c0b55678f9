"""Skin weights for bend joints, and how far they are pushed so that a joint's flesh keeps its volume when it bends."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar, Level
from avatar.bend import BEND_JOINTS, BENDS, Bend
from avatar.gltf.avatar_write import canonical_bones, helper_joints
from avatar.kinematics import DESCENDS
from avatar.skeleton import JOINTS, PARENTS, joint_transforms, rigid_inverse
from avatar.skinning import SkinWeights, skin_points
from avatar.twist import TWIST_JOINTS
from geometry.mesh import connected

# bytes: a joint is not left with less than this beside its bend joint, for that would take a slot
LEAST = 4
# metres round a joint whose volume is kept: of a limb along its bone, of a shoulder all round
REACH = {"elbow": 0.08, "knee": 0.08, "shoulder": 0.12}
# metres from a hinge to either side of its bone over which bend joints take hold: nothing of the fold, all of the back
SIDE = {"elbow": 0.03, "knee": 0.06}
# the turns at which it is kept, of the left side: hinges bent; an arm let down from the T-pose, and brought forward
TURNS = {"elbow": ((0, -1, 0),), "knee": ((1, 0, 0),), "shoulder": ((0, 0, -1), (0, -1, 0))}
DEGREES = 90.0
# pushes that are tried, metres
PUSHES = np.arange(81) * 1e-3
# share of the volume that may be lost; less push is less of a point where skin weights change over a short way
LOST = 0.03


def bend_skin(
    level: Level, canonical: Float[Array, "52 4 4"], joints_rest: Float[Array, "52 3"]
) -> tuple[UInt8[Array, "n 4"], UInt8[Array, "n 4"]]:
    """A level's joints and weights, a part of those at elbows, knees and shoulders given to bend joints.

    Where w of a vertex follows the joint and 1 - w what lies before it, bend joints take 2 w (1 - w), half of it from
    either side: bones at shares 0, 1/2 and 1 of the turn, blended by Bernstein's polynomials. At a shoulder, and in a
    row with one slot left, all of it is taken from w. At hinges, whose fold linear blending draws in as flesh is, it
    fades towards the fold. Counted for their carriers they are the level's own weights.
    """
    joints, weights = level.joints.copy(), level.weights.copy()
    held = level.weights.astype(np.float64) / 255
    for name, bend in BENDS.items():
        own = len(JOINTS) + len(TWIST_JOINTS) + BEND_JOINTS.index(f"{name}_bend1")
        w = (held * DESCENDS[level.joints, bend.joint]).sum(1)
        half = 255 * w * (1 - w) * _outer(level.positions, name, bend, canonical, joints_rest)
        at, before = (_slots(level, joint) for joint in (bend.joint, int(PARENTS[bend.joint])))
        moved = (at >= 0) & (half > 0)
        shared = moved & (before >= 0) & ((weights == 0).sum(1) >= 2) & bend.both
        rows = np.flatnonzero(shared)
        # bend0 stands before bend1
        _give(joints, weights, rows, before[rows], own - 1, half[rows])
        taken = np.where(shared, half, 2 * half)
        rows = np.flatnonzero(moved)
        _give(joints, weights, rows, at[rows], own, taken[rows])
    return joints, weights


def _outer(
    positions: Float[Array, "vertices 3"], name: str, bend: Bend, canonical: Float[Array, "52 4 4"],
    joints_rest: Float[Array, "52 3"],
) -> Float[Array, "vertices"]:  # fmt: skip
    """How far a vertex lies to the back of a hinge, smoothly from 0 to 1; 1 for a shoulder, which folds all round."""
    part = name.split("_")[1]
    if part not in SIDE:
        return np.ones(len(positions))
    along = joints_rest[bend.child] - joints_rest[bend.joint]
    back = np.cross(along, turns_of(name)[0])
    back /= max(float(np.linalg.norm(back)), 1e-9)
    frame = canonical[bend.joint]
    place = (positions - frame[:3, 3]) @ frame[:3, :3] @ back
    share = np.clip(0.5 + 0.5 * place / SIDE[part], 0, 1)
    return share * share * (3 - 2 * share)


def turns_of(name: str) -> Float[Array, "turns 3"]:
    """Axes of TURNS on the side of a joint."""
    side, part = name.split("_")
    return np.array(TURNS[part], float) * ([1, 1, 1] if side == "left" else [1, -1, -1])


def with_room(level: Level) -> Level:
    """The level with a slot free in rows at the shoulders that need one and have none: for a bend joint.

    The weakest weight of another joint goes to the strongest one. It is small (.05 at most in nine of ten such rows)
    and on the torso's next joint; without, neighbouring rows would follow the bend joint wholly or not at all.
    """
    joints, weights = level.joints.copy(), level.weights.copy()
    held = level.weights.astype(np.float64) / 255
    for bend in BENDS.values():
        w = (held * DESCENDS[level.joints, bend.joint]).sum(1)
        # up to a half the bend joint takes all of w
        rows = np.flatnonzero((w > 0.5) & (w < 1) & (_slots(level, bend.joint) >= 0) & (weights > 0).all(1))
        others = np.where(level.joints[rows] == bend.joint, 0, weights[rows].astype(np.int64))
        weakest = np.where(others > 0, others, 256).argmin(1)
        # not the weakest itself, where all are alike
        others[np.arange(len(rows)), weakest] = 0
        strongest = others.argmax(1)
        weights[rows, strongest] += weights[rows, weakest]
        joints[rows, weakest], weights[rows, weakest] = 0, 0
    return replace(level, joints=joints, weights=weights)


def _slots(level: Level, joint: int) -> Int[Array, "vertices"]:
    """In which slot of a row a joint has weight, -1 where in none."""
    here = (level.joints == joint) & (level.weights > 0)
    return np.where(here.any(1), here.argmax(1), -1)


def _give(
    joints: UInt8[Array, "n 4"], weights: UInt8[Array, "n 4"], rows: Int[Array, "rows"], slots: Int[Array, "rows"],
    bone: int, amount: Float[Array, "rows"],
) -> None:  # fmt: skip
    """Give so much of a slot's weight to a bone, in the next free slot; all or nothing where none is free behind it."""
    whole = weights[rows, slots].astype(np.int64)
    given = np.minimum(np.rint(amount).astype(np.int64), whole)
    given = np.where(whole - given < LEAST, whole, given)
    free = (weights[rows] == 0) & (np.arange(4) > slots[:, None])
    given = np.where(free.any(1), given, np.where(2 * given > whole, whole, 0))
    all_ = given == whole
    joints[rows[all_], slots[all_]] = bone
    part = ~all_ & (given > 0)
    at = free.argmax(1)[part]
    weights[rows[part], slots[part]] = (whole - given)[part]
    joints[rows[part], at], weights[rows[part], at] = bone, given[part]


def fitted_push(avatar: Avatar) -> Float[Array, "bends"]:
    """How far each bend joint of an avatar with weights for them is pushed, metres (avatar/bend.py).

    Of PUSHES the least with which no turn loses more than LOST of the volume of the joint's flesh, else the one with
    which the worst loses least; 0 for a joint without flesh.
    """
    found, faces = np.zeros(len(BENDS)), avatar.levels[0].faces.astype(np.int64)
    rest = posed_points(avatar, np.zeros((52, 3)))
    for k, (name, bend) in enumerate(BENDS.items()):
        part = name.split("_")[1]
        piece = Piece(avatar.levels[0].positions, faces[flesh(avatar, bend, rest, REACH[part])[faces].all(1)])
        before = piece.volume(rest)
        if before <= 0:
            continue
        kept = np.full(len(PUSHES), np.inf)
        for axis in turns_of(name):
            pose = np.zeros((52, 3))
            pose[bend.joint] = np.radians(DEGREES) * axis
            # linear in the push
            still, pushed = (posed_points(replace(avatar, bend=c * np.eye(len(BENDS))[k]), pose) for c in (0, 1))
            # so the volume is a polynomial of the third degree in it
            some = np.linspace(0, PUSHES[-1], 4)
            volumes = [piece.volume(still + c * (pushed - still)) / before for c in some]
            kept = np.minimum(kept, np.polyval(np.polyfit(some, volumes, 3), PUSHES))
        found[k] = PUSHES[np.argmax(np.minimum(kept, 1 - LOST))]
    return found


def posed_points(avatar: Avatar, axis_angle: Float[Array, "52 3"]) -> Float[Array, "vertices 3"]:
    """Vertices of the finest level of an avatar with helper joints, the pelvis at the origin, metres."""
    helpers, level = helper_joints(avatar), avatar.levels[0]
    assert helpers is not None and level.twist is not None
    joints = avatar.joint_positions.astype(np.float64)
    bones = helpers.with_helpers(axis_angle, joint_transforms(axis_angle, joints))
    skin = SkinWeights(level.twist.joints.astype(np.int64), level.twist.weights / np.float32(255))
    return skin_points(level.positions, skin, bones @ rigid_inverse(canonical_bones(avatar)))


def flesh(
    avatar: Avatar, bend: Bend, points: Float[Array, "vertices 3"], reach: float
) -> Bool[Array, "vertices"]:  # fmt: skip
    """Vertices that are a joint's flesh, in pose 0."""
    joints = avatar.joint_positions.astype(np.float64)
    away = points - joints[bend.joint]
    if not bend.both:
        return np.linalg.norm(away, axis=1) < reach
    along = joints[bend.child] - joints[bend.joint]
    level = avatar.levels[0]
    of_limb = (level.weights * DESCENDS[level.joints, PARENTS[bend.joint]]).sum(1, dtype=np.int64) > 127
    return of_limb & (np.abs(away @ along) < reach * np.linalg.norm(along))


class Piece:
    """Faces of a closed surface, and where they are cut off a fan over each rim. Vertices in one place are one."""

    def __init__(self, positions: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"]):
        self._faces = faces
        _, one = np.unique(positions, axis=0, return_inverse=True)
        edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        a, b = one.reshape(-1)[edges].T
        self._rims = []
        # an edge whose other side is no face of the piece
        cut = ~np.isin(a * len(positions) + b, b * len(positions) + a)
        if cut.any():
            rim = connected(np.stack([a[cut], b[cut]], 1), len(positions))[a[cut]]
            self._rims = [edges[cut][rim == number] for number in np.unique(rim)]

    def volume(self, points: Float[Array, "vertices 3"]) -> float:
        """Cubic metres of the piece when its vertices are at `points`."""
        corners = [points[self._faces]]
        for rim in self._rims:
            middle = points[rim].mean((0, 1))
            corners.append(np.stack([points[rim[:, 1]], points[rim[:, 0]], np.broadcast_to(middle, (len(rim), 3))], 1))
        a, b, c = (np.concatenate(corners) - points.mean(0)).transpose(1, 0, 2)
        return float(np.einsum("fc,fc->", a, np.cross(b, c))) / 6
