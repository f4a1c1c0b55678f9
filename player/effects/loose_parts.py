"""What of an avatar hangs loose, as a few hundred particles: found once, from the looseness in its file.

Particles are vertices chosen farthest from one another (Gonzalez 1985); each stands for the vertices nearest to it, has
the mean of their skin weights and looseness, and is a neighbour of those whose vertices share a triangle with its own.
A vertex follows the four particles nearest to it, with weights that fall to 0 at the fifth, so that nothing tears
where one takes another's place; skin follows none.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar, Level
from avatar.skeleton import joint_transforms
from avatar.skinning import dense_weights
from player.draw.drawing import GivenPose
from player.draw.posing import Poser
from player.effects.contact_capsules import BONES, capsule_distances, capsules_of
from player.effects.held_feet import leg_unit

# joint that moves each capsule
BONE = np.array([joint for joint, _ in BONES])
PARTICLES = 300  # at most; player/gl/blocks.py, shaders/loose.glsl
SPACING = 0.03  # metres from one to the next at least, of a grown person
# neighbours of each particle
NEIGHBOURS = 6
# part of the way that each end of a stretched edge goes in a sweep: half would be all of it, were it alone
PULL = 0.2
# looseness below which a vertex follows only a share of its particles
FADED = 0.25
DOWN = np.array([0.0, -1.0, 0.0])
# vertices looked at at once
CHUNK = 4096


class DrivenPose(NamedTuple):
    """What moves the particles in one pose, relative to the pelvis; metres."""

    root: Float[Array, "3"]
    # turn of the pelvis
    turn: Float[Array, "3 3"]
    # where the pose has the particles
    targets: Float[Array, "particles 3"]
    # both ends of each capsule
    capsules: Float[Array, "2 capsules 3"]
    # to each neighbour, and gravity beyond that of pose 0, parts of it
    lengths: Float[Array, "neighbours particles"]
    pull: Float[Array, "particles 3"]


@dataclass(frozen=True)
class LooseParts:
    """The particles of one avatar at a level of detail, and what moves them."""

    poser: Poser
    unit: float  # metres of this body in one of a grown person's
    places: Float[Array, "particles 3"]  # canonical, metres
    # joints that move any of them
    joints: Int[Array, "movers"]
    # rows on the columns of those joints' transforms: where particles are, then where gravity pulls in pose 0
    skinning: Float[Array, "rows columns"]
    looseness: Float[Array, "particles"]
    # particle itself where there are fewer
    neighbours: Int[Array, "particles NEIGHBOURS"]
    # part of the way that a neighbour's length asks for; 0 where there is none
    pull: Float[Array, "particles NEIGHBOURS"]
    # both ends of the body's capsules (player/effects/contact_capsules.py), canonical, metres
    capsules: Float[Array, "2 capsules 3"]
    # what each particle keeps off each of them: their radius, or less where it lies nearer already
    radii: Float[Array, "particles capsules"]
    # each vertex has four particles, and how far it follows each
    near: Int[Array, "vertices 4"]
    follows: Float[Array, "vertices 4"]

    def drive(self, pose: GivenPose) -> DrivenPose:
        """Where a pose has the particles, the pelvis at the origin."""
        axis_angle, root = np.asarray(pose[0], np.float64), np.asarray(pose[1], np.float64)
        poser = self.poser
        world = poser.chain.transforms(axis_angle, np.zeros(3), np.eye(4))
        # without twist joints: they move nothing that is loose
        moved = world @ poser.joint_from_canonical[:52]
        skinned = self.skinning @ moved[self.joints, :3].transpose(0, 2, 1).reshape(-1, 3)
        targets, pull = skinned[: len(self.places)], DOWN - skinned[len(self.places) :]
        lengths = lengths_of(ways(targets, np.ascontiguousarray(self.neighbours.T)))
        bones = moved[BONE, :3]
        capsules = np.einsum("kij,ekj->eki", bones[:, :, :3], self.capsules) + bones[:, :, 3]
        return DrivenPose(root, world[0, :3, :3], targets, capsules, lengths, pull)


def loose_parts(avatar: Avatar, level: Level) -> LooseParts | None:
    """The loose parts of a level; None: its file has none."""
    if level.loose is None or not (level.loose > 0).any():
        return None
    joints = avatar.joint_positions.astype(np.float64)
    unit = leg_unit(joints)
    own = np.flatnonzero(level.loose > 0)
    points, loose = level.positions[own].astype(np.float64), level.loose[own].astype(np.float64)
    chosen = spread(points, loose, SPACING * unit)
    places = points[chosen]
    nearest, distance = _nearest(points, places, min(5, len(places)))
    cell = nearest[:, 0]
    count = np.bincount(cell, minlength=len(places))[:, None]
    weights = np.zeros((len(places), 52))
    np.add.at(weights, cell, dense_weights(level.skin, 52)[own])
    looseness = np.bincount(cell, loose, minlength=len(places)) / count[:, 0]
    neighbours, pull = _neighbours(level, own, cell, places)
    near, follows = _followers(level, own, nearest, distance, unit)
    poser = Poser(avatar, level)
    skin = weights / weights.sum(1, keepdims=True)
    standing = joint_transforms(np.zeros((52, 3)), joints) @ poser.joint_from_canonical[:52]
    upright = np.einsum("nj,jab->nab", skin, standing[:, :3, :3])
    down = np.linalg.solve(upright, DOWN[None, :, None])[..., 0]
    movers = np.flatnonzero(skin.any(0))
    columns = np.concatenate([np.c_[places, np.ones(len(places))], np.c_[down, np.zeros(len(down))]])
    skinning = np.tile(skin[:, movers], (2, 1))[:, :, None] * columns[:, None]
    capsules = capsules_of(avatar, level)
    ends = np.stack([capsules.starts, capsules.ends])
    return LooseParts(
        poser, unit, places, movers, skinning.reshape(len(skinning), -1), looseness, neighbours, pull, ends,
        np.minimum(capsules.radii, 0.95 * capsule_distances(places, *ends)), near, follows,
    )  # fmt: skip


def ways(
    points: Float[Array, "particles 3"], neighbours: Int[Array, "neighbours particles"]
) -> Float[Array, "3 neighbours particles"]:
    """From each particle to its neighbours; arrays of this order are twice as fast as those of points."""
    across = np.ascontiguousarray(points.T)
    return across.take(neighbours, 1) - across[:, None]


def lengths_of(away: Float[Array, "3 neighbours particles"]) -> Float[Array, "neighbours particles"]:
    x, y, z = away
    return np.sqrt(x * x + y * y + z * z)


def spread(points: Float[Array, "n 3"], loose: Float[Array, "n"], spacing: float) -> Int[Array, "chosen"]:
    """Points far from one another, the loosest first: PARTICLES, or fewer where that would be nearer than `spacing`."""
    chosen = [int(loose.argmax())]
    away = ((points - points[chosen[0]]) ** 2).sum(1)
    while len(chosen) < PARTICLES and away.max() > spacing**2:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, ((points - points[chosen[-1]]) ** 2).sum(1))
    return np.array(chosen)


def _nearest(points: Array, places: Array, count: int) -> tuple[Int[Array, "n count"], Float[Array, "n count"]]:
    found, away = [], []
    for start in range(0, len(points), CHUNK):
        distance = np.linalg.norm(points[start : start + CHUNK, None] - places, axis=2)
        order = np.argsort(distance, axis=1, kind="stable")[:, :count]
        found.append(order)
        away.append(np.take_along_axis(distance, order, 1))
    return np.concatenate(found), np.concatenate(away)


def _neighbours(
    level: Level, own: Int[Array, "n"], cell: Int[Array, "n"], places: Float[Array, "particles 3"]
) -> tuple[Int[Array, "particles NEIGHBOURS"], Float[Array, "particles NEIGHBOURS"]]:
    """Particles whose vertices share a triangle, the nearest of them; both ways or not at all."""
    count = len(places)
    # vertices at one place are one, whatever cuts of the atlas divide them
    _, place = np.unique(level.positions, axis=0, return_inverse=True)
    place = place.reshape(-1)
    welded = np.full(int(place.max()) + 1, -1)
    welded[place[own]] = cell
    faces = welded[place[level.faces.astype(np.int64)]]
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    pairs = np.unique(np.sort(pairs[(pairs >= 0).all(1) & (pairs[:, 0] != pairs[:, 1])], axis=1), axis=0)
    length = np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1)
    neighbours = np.tile(np.arange(count)[:, None], (1, NEIGHBOURS))
    there: Bool[Array, "particles NEIGHBOURS"] = np.zeros((count, NEIGHBOURS), bool)
    used = np.zeros(count, int)
    for a, b in pairs[np.argsort(length, kind="stable")].tolist():
        if max(used[a], used[b]) < NEIGHBOURS:
            for one, other in ((a, b), (b, a)):
                neighbours[one, used[one]], there[one, used[one]] = other, True
                used[one] += 1
    return neighbours, there * PULL


def _followers(
    level: Level, own: Int[Array, "n"], nearest: Int[Array, "n k"], distance: Float[Array, "n k"], unit: float
) -> tuple[Int[Array, "vertices 4"], Float[Array, "vertices 4"]]:
    near, follows = np.zeros((len(level.positions), 4), np.int64), np.zeros((len(level.positions), 4))
    inverse = 1 / (distance + 1e-3 * unit)
    # where there is no fifth all are followed
    share = inverse - inverse[:, -1:] if inverse.shape[1] == 5 else inverse
    share = share[:, :4] / share[:, :4].sum(1, keepdims=True).clip(1e-12)
    assert level.loose is not None
    share *= np.minimum(level.loose[own] / FADED, 1)[:, None]
    columns = share.shape[1]
    near[own, :columns], follows[own, :columns] = nearest[:, :columns], share
    return near, follows
