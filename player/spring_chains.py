"""Spring bones of a .vrm in the simulation of loose parts (player/loose_motion.py): each tail is a particle.

VRMC_springBone 1.0 steps by frames: with f the stiffness towards the rest direction r and gravity, metres a second,

    tail += (1 - drag) (tail - tail before) + dt (f_r r + f_g)

and turns with the rate of frames. What is taken is the differential equation whose step of 1/60 s under a constant
force is that: velocity falls as e^(-c t), forces are accelerations,

    c = -60 ln(1 - drag)        a = f c / drag          (drag -> 0: a = 60 f)

The tail's distance L to its head is kept, so that a constant pull along r is the spring of extended position based
dynamics to the point L r off the head with compliance L / a_r: what they differ by points along the bone. r is turned
as the parent bone has turned away from the pose, without twist. Velocities are the world's or, with a centre, relative
to it. Tails keep out of the file's own colliders by their radius, by no others. A drag below SLACK counts as that, so
that all comes to rest.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from avatar.baked_avatar import Avatar, Level
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.springs import Springs
from player.drawing import Pose
from player.held_feet import GROWN, LEGS, leg_bones
from player.loose_capsules import Apart
from player.loose_driver import STEP, Driver, Way
from player.posing import Poser

Array = np.ndarray

# frames a second that the specification's numbers are for
RATE = 60.0
SLACK, HARSHEST = 0.15, 0.99
# out of the colliders, at most, of what is drawn
PUSHES = 3
# metres in a collider that are none
TOUCHING = 1e-4
# cosine of half a turn: its axis is not told
OPPOSITE = 1e-6


@dataclass(frozen=True)
class SpringParts:
    """The spring bones of one avatar at a level of detail, and what moves them."""

    poser: Poser
    # metres of this body in one of a grown person's
    unit: float
    springs: Springs
    # canonical, metres: the tails
    places: Float[Array, "bones 3"]
    lengths: Float[Array, "bones 1"]
    # bones of each generation that hang on another bone, and those bones
    generations: tuple[tuple[Int[Array, "some"], Int[Array, "some"]], ...]
    # joints that are a centre, and which of them each bone has; -1: none
    centers: Int[Array, "centers"]
    center: Int[Array, "bones"]
    # of each vertex: four particles and how far it follows each
    near: Int[Array, "vertices 4"]
    follows: Float[Array, "vertices 4"]

    def drive(self, pose: Pose) -> Driver:
        """Where a pose has heads and tails, the pelvis at the origin."""
        axis_angle, root = np.asarray(pose[0], np.float64), np.asarray(pose[1], np.float64)
        world = self.poser.chain.transforms(axis_angle, np.zeros(3), np.eye(4))
        moved = (world @ self.poser.joint_from_canonical[:52])[:, :3]
        springs = self.springs
        bones, colliders = moved[springs.joints], moved[springs.collider_joints]
        ends = np.stack([springs.tails, springs.heads])
        targets = (np.einsum("nij,enj->eni", bones[:, :, :3], ends) + bones[:, :, 3]).reshape(-1, 3)
        capsules = np.einsum("kij,ekj->eki", colliders[:, :, :3], springs.collider_ends) + colliders[:, :, 3]
        return Driver(root, world[0, :3, :3], targets, capsules, centers=moved[self.centers])


def spring_parts(avatar: Avatar, level: Level) -> SpringParts | None:
    """The spring bones of a level; None: it has none."""
    springs = level.springs
    if springs is None:
        return None
    joints = avatar.joint_positions.astype(np.float64)
    unit = float(np.mean([sum(leg_bones(joints, leg)) for leg in LEGS])) / GROWN
    depth = np.zeros(len(springs), int)
    for bone, parent in enumerate(springs.parents.tolist()):
        depth[bone] = depth[parent] + 1 if parent >= 0 else 0
    # the first hang on the body
    rows = [np.flatnonzero(depth == d) for d in range(1, int(depth.max()) + 1)]
    centers, center = np.unique(springs.centers, return_inverse=True)
    center = center.reshape(-1) - int(centers[0] < 0)
    return SpringParts(
        Poser(avatar, level), unit, springs, springs.tails,
        np.linalg.norm(springs.tails - springs.heads, axis=1, keepdims=True),
        tuple((own, springs.parents[own]) for own in rows), centers[centers >= 0], center,
        springs.near, springs.follows,
    )  # fmt: skip


class Chains:
    """How spring bones move in a substep."""

    def __init__(self, parts: SpringParts):
        springs, self.parts = parts.springs, parts
        drag = np.clip(springs.drag, SLACK, HARSHEST)[:, None]
        rate = -RATE * np.log1p(-drag)
        # of its velocity, what a substep leaves; and metres that an acceleration of 1 moves it in one
        self._kept = np.exp(-rate * STEP)
        moves = (1 - self._kept) / rate * STEP
        self._fallen = moves * springs.gravity * rate / drag
        stiffness = springs.stiffness[:, None] * rate / drag
        # of the way to its target
        self._drawn = 1 / (1 + parts.lengths / np.maximum(moves * stiffness, 1e-30))
        self._held = np.flatnonzero(springs.parents >= 0)
        self._parents = springs.parents[self._held]
        self._roots = np.flatnonzero(springs.parents < 0)
        # a tail and a collider that it does not heed never touch
        radii = np.where(springs.heeds, springs.radii[:, None] + springs.collider_radii, -1.0)
        self._apart = Apart(radii, TOUCHING * parts.unit)
        self._carry: list[tuple[Array, Array, Array]] = []

    def frame(self, way: Way) -> None:
        """Begin a frame."""
        parts = self.parts
        self._carry = []
        for k in range(len(parts.centers)):
            before, now = way.before.centers[k], way.now.centers[k]
            # of the centre in a substep
            turn = matrix_from_axis_angle(axis_angle_from_matrix(now[:, :3] @ before[:, :3].T) * (STEP / way.dt))
            own = np.flatnonzero(parts.center == k)
            shift = (now[:, 3] - before[:, 3]) * (STEP / way.dt)
            self._carry.append((own, turn, shift))

    def substep(self, x: Array, v: Array, speed: Array, at: Driver) -> tuple[Array, Array, Array]:
        """Where the particles would be at rest in their space, where they are, and the velocities that theirs stay
        near."""
        if self._carry:
            x, v, speed = x.copy(), v.copy(), speed.copy()
            for k, (own, turn, shift) in enumerate(self._carry):
                middle = at.centers[k, :, 3]
                x[own] = (x[own] - (middle - shift)) @ turn.T + middle
                v[own] = v[own] @ turn.T
                speed[own] -= shift / STEP
        y = x + STEP * self._kept * v + self._fallen
        heads, rest = self._rest(y, at)
        y += (heads + rest - y) * self._drawn
        return x, self._settled(y, at, 1), speed

    def settled(self, y: Array, at: Driver) -> Array:
        """Out of the colliders and at their distance from their heads."""
        return self._settled(y, at, PUSHES)

    def _settled(self, y: Array, at: Driver, pushes: int) -> Array:
        y = self._strung(y, at)
        for _ in range(pushes):
            pushed = self._apart.pushed(y, at.capsules)
            if pushed is None:
                break
            y = self._strung(pushed, at)
        return y

    def _rest(self, y: Array, at: Driver) -> tuple[Array, Array]:
        """Where each bone's head is, and its rest as its parent has turned."""
        count = len(y)
        tails, heads = at.targets[:count], at.targets[count:]
        rest = tails - heads
        if not len(self._held):
            return heads, rest
        held, above = self._held, self._parents
        at_heads = heads.copy()
        at_heads[held] += (y - tails)[above]
        length = self.parts.lengths
        bones = y - at_heads
        a = (rest / length)[above]
        b = (bones / np.sqrt(np.einsum("nc,nc->n", bones, bones)).clip(1e-9)[:, None])[above]
        own = rest[held]
        axis = np.cross(a, b)
        cosine = np.einsum("nc,nc->n", a, b)[:, None]
        along = np.einsum("nc,nc->n", axis, own)[:, None]
        turned = own * cosine + np.cross(axis, own) + axis * (along / np.maximum(1 + cosine, OPPOSITE))
        rest[held] = turned
        return at_heads, rest

    def _strung(self, y: Array, at: Driver) -> Array:
        count, length = len(y), self.parts.lengths
        tails, heads = at.targets[:count], at.targets[count:]
        away = y - heads
        far = np.sqrt(np.einsum("nc,nc->n", away, away))[:, None]
        out = heads + away * (length / far.clip(1e-9))
        for own, above in self.parts.generations:
            head = heads[own] + (out[above] - tails[above])
            away = y[own] - head
            far = np.sqrt(np.einsum("nc,nc->n", away, away))[:, None]
            out[own] = head + away * (length[own] / far.clip(1e-9))
        return out
