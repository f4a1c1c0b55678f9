"""Hair, skirts and sleeves that follow the body: a simulation of an avatar's loose particles (player/loose_parts.py).

Extended position based dynamics (Macklin et al. 2016) in fixed substeps of STEP: each particle is drawn to where plain
skinning has it by a spring of compliance 1 / (2 pi f)^2, f rising as looseness falls, keeps its distance to its
neighbours as they lie in the skinned pose, and stays out of the body's capsules. Damping is of the motion relative to
the skinned pose. Gravity acts by how far it has turned from where it pulls in pose 0, since a capture was filmed with
gravity: who stands upright looks as filmed.

The pose is interpolated to each substep, and what is drawn lies between the last two: so it depends on neither how
often frames are drawn nor how they fall between substeps. Everything is relative to the pelvis of the frame, and the
particles keep the world's velocity as it moves on: ten kilometres away nothing trembles. A body that jumps (faster than
FASTEST, or turned by more than TURNED) carries its particles along. Nothing is random and no clock is read.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from player.drawing import Pose
from player.loose_parts import BONE, DOWN, LooseParts, capsule_distances
from player.passes.secondary_motion import SecondaryMotion
from player.track import FASTEST, TURNED

Array = np.ndarray

STEP = 1 / 120
# seconds; after a longer frame, or a step back in time, particles begin anew where they are skinned to
LONGEST = 0.5
# metres a second relative to the pose, and metres off it, of a grown person
SPEED_CAP, REACH = 8.0, 0.3
# of critical damping
DAMPING = 0.3
# asleep: slower than this for so many seconds, while what drives it moved less than this; m/s, s, m
SLOW, CALM, STILL = 0.01, 0.5, 5e-4
# metres: what is moved less is drawn as skinned
UNSEEN = 5e-5
# looseness counts as at least this: springs stay finite
STIFFEST = 0.05
# at most, of the last push out of the capsules, and metres in which they may leave a particle
PUSHES, DEEPEST = 4, 1e-3


class Driver(NamedTuple):
    """What moves the particles in one pose, relative to the pelvis; metres."""

    root: Float[Array, "3"]
    # turn of the pelvis
    turn: Float[Array, "3 3"]
    targets: Float[Array, "particles 3"]
    # to each neighbour
    lengths: Float[Array, "particles neighbours"]
    # gravity beyond that of pose 0, parts of it
    pull: Float[Array, "particles 3"]
    # both ends of each capsule
    capsules: Float[Array, "2 capsules 3"]


class LooseMotion:
    """The particles of one avatar as they move on from frame to frame."""

    def __init__(self, parts: LooseParts, springs: SecondaryMotion):
        self.parts = parts
        omega = 2 * np.pi * springs.frequency / np.maximum(parts.looseness, STIFFEST)[:, None]
        # of the way to its target in a substep: compliance 1 / omega^2
        self._drawn = 1 / (1 + 1 / (omega * STEP) ** 2)
        self._damped = np.exp(-2 * DAMPING * omega * STEP)
        self._gravity = springs.gravity * parts.unit
        self._seconds: float | None = None
        # raised whenever the offsets change: what is drawn of them may be kept while it stands
        self.version = 0
        self.steps = 0
        # where the particles are, off where they are skinned to; world, metres
        self.offsets = np.zeros_like(parts.places)
        self._reach, self._asleep = 0.0, False

    @property
    def asleep(self) -> bool:
        """Whether nothing moves any more, and nothing is computed."""
        return self._asleep

    @property
    def reach(self) -> float:
        """Of the farthest particle from where it is skinned to, metres."""
        return self._reach

    def move(self, pose: Pose, seconds: float) -> None:
        """Go on to a pose at a moment; the first sets the particles where it skins them to."""
        if self._seconds is None or not 0 <= seconds - self._seconds <= LONGEST:
            self._begin(pose, seconds)
            return
        dt = seconds - self._seconds
        self._seconds = seconds
        same = np.array_equal(pose[0], self._pose[0]) and np.array_equal(pose[1], self._pose[1])
        if same and (self._asleep or dt == 0):
            return
        now = self._driver if same else driver(self.parts, pose)
        self._pose = pose
        if self._asleep:
            if _moved(now, self._reference) < STILL * self.parts.unit:
                return
            self._asleep, self._calm = False, 0.0
        before = self._follow(now, dt)
        self._driver = now
        self._advance(before, now, dt)
        self._settle(now)

    def _begin(self, pose: Pose, seconds: float) -> None:
        self._pose, self._seconds = pose, seconds
        self._driver = self._reference = driver(self.parts, pose)
        self._x = self._driver.targets.copy()
        self._v = np.zeros_like(self._x)
        self._last = self._now = np.zeros_like(self._x)
        self._clock = self._calm = 0.0
        self._asleep = False
        self._close = None
        self._settle(self._driver)

    def _follow(self, now: Driver, dt: float) -> Driver:
        """The driver before this frame as seen from this frame's pelvis; what jumps carries its particles along."""
        before, limit = self._driver, FASTEST * self.parts.unit * dt
        shift = now.root - before.root
        turn = now.turn @ before.turn.T
        angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
        if np.linalg.norm(shift) > limit or angle > TURNED:
            offset = (self._x - before.targets) @ turn.T
            self._x, self._v = now.targets + offset, self._v @ turn.T
            self._last, self._now = self._last @ turn.T, self._now @ turn.T
            # a body that jumps is not fast
            self._v = np.clip(self._v, -SPEED_CAP * self.parts.unit, SPEED_CAP * self.parts.unit)
            return now
        self._x = self._x - shift
        targets = before.targets - shift
        way = now.targets - targets
        far = np.sqrt((way * way).sum(1, keepdims=True))
        if far.max() > limit:
            over = way * (1 - np.minimum(1, limit / np.maximum(far, 1e-12)))
            self._x, targets = self._x + over, targets + over
        return before._replace(targets=targets, capsules=before.capsules - shift)

    def _advance(self, before: Driver, now: Driver, dt: float) -> None:
        """All substeps that have begun by the end of a frame."""
        if dt <= 0:
            return
        first = STEP - self._clock
        count = int(np.floor((self._clock + dt) / STEP + 1e-9))
        self._clock = max(self._clock + dt - count * STEP, 0.0)
        if not count:
            return
        way, speed = now.targets - before.targets, (now.targets - before.targets) / dt
        longer, turned, along = now.lengths - before.lengths, now.pull - before.pull, now.capsules - before.capsules
        pairs = self._near(now)
        for k in range(count):
            share = min((first + k * STEP) / dt, 1.0)
            targets = before.targets + share * way
            pull = self._gravity * (before.pull + share * turned)
            self._substep(targets, speed, before.lengths + share * longer, pull)
            if pairs is not None:
                ends = before.capsules + share * along
                self._pushed(ends, pairs)
            v = (self._x - self._from) / STEP - speed
            fast = np.sqrt((v * v).sum(1, keepdims=True))
            v *= np.minimum(1, SPEED_CAP * self.parts.unit / np.maximum(fast, 1e-12))
            self._v = v + speed
            self._last, self._now = self._now, self._x - targets
            slow = float(np.abs(self._now - self._last).max()) < SLOW * self.parts.unit * STEP
            self._calm = self._calm + STEP if slow else 0.0
        self.steps += count
        if self._calm == 0 or _moved(now, self._reference) > STILL * self.parts.unit:
            self._reference, self._calm = now, 0.0
        elif self._calm >= CALM:
            self._asleep, self._last = True, self._now
            self._v = np.zeros_like(self._v)

    def _substep(self, targets: Array, speed: Array, lengths: Array, pull: Array) -> None:
        """Springs, gravity and neighbours; leaves where it came from in `_from`."""
        parts = self.parts
        x = self._from = self._x
        y = x + STEP * (speed + (self._v - speed) * self._damped + STEP * pull)
        y += (targets - y) * self._drawn
        away = y.take(parts.neighbours, 0) - y[:, None]
        long = np.sqrt(np.einsum("nkc,nkc->nk", away, away))
        # cloth folds, it does not stretch
        y += np.einsum("nk,nkc->nc", parts.pull * np.maximum(1 - lengths / np.maximum(long, 1e-12), 0), away)
        offset = y - targets
        far = np.sqrt(np.einsum("nc,nc->n", offset, offset))[:, None]
        self._x = targets + offset * np.minimum(1, REACH * parts.unit / np.maximum(far, 1e-12))

    def _near(self, now: Driver) -> tuple[Int[Array, "pairs"], Int[Array, "pairs"]] | None:
        """The capsule that each particle is nearest to, of those that are near one at all."""
        if self._close is None:
            return None
        nearest = self._close.argmin(1)
        own = np.flatnonzero(self._close[np.arange(len(nearest)), nearest] < 0.1 * self.parts.unit)
        return (own, nearest[own]) if len(own) else None

    def _pushed(self, ends: Float[Array, "2 capsules 3"], pairs: tuple[Array, Array]) -> None:
        own, which = pairs
        start, along = ends[0][which], (ends[1] - ends[0])[which]
        point = self._x[own] - start
        share = np.einsum("nc,nc->n", point, along) / np.maximum(np.einsum("nc,nc->n", along, along), 1e-18)
        off = point - np.clip(share, 0, 1)[:, None] * along
        far = np.sqrt(np.einsum("nc,nc->n", off, off))
        deep = self.parts.radii[own, which] - far
        if deep.max() > 0:
            push = np.maximum(deep, 0) / np.maximum(far, 1e-9)
            self._x[own] += push[:, None] * off

    def _settle(self, now: Driver) -> None:
        """The offsets that this frame draws: between the last two substeps, and outside of the capsules."""
        targets, share = now.targets, self._clock / STEP
        offsets = self._last + share * (self._now - self._last)
        y, radii = targets + offsets, self.parts.radii
        for sweep in range(PUSHES):
            self._close = capsule_distances(y, *now.capsules) - radii
            nearest = self._close.argmin(1)
            rows = np.arange(len(nearest))
            own = np.flatnonzero(self._close[rows, nearest] < -DEEPEST * self.parts.unit)
            if not len(own) or sweep == PUSHES - 1:
                break
            start, along = now.capsules[0][nearest[own]], (now.capsules[1] - now.capsules[0])[nearest[own]]
            point = y[own] - start
            length = np.maximum((along * along).sum(1), 1e-18)
            off = point - np.clip((point * along).sum(1) / length, 0, 1)[:, None] * along
            far = np.sqrt((off * off).sum(1, keepdims=True))
            y[own] += -self._close[own, nearest[own], None] * off / np.maximum(far, 1e-9)
        self.offsets = y - targets
        self._reach = float(np.sqrt((self.offsets**2).sum(1).max()))
        self.version += 1

    @property
    def shows(self) -> bool:
        """Whether anything is moved so far that it can be seen."""
        return self._seconds is not None and self._reach > UNSEEN * self.parts.unit


def driver(parts: LooseParts, pose: Pose) -> Driver:
    """Where a pose has the particles, the pelvis at the origin."""
    axis_angle, root = np.asarray(pose[0], np.float64), np.asarray(pose[1], np.float64)
    poser = parts.poser
    world = poser.chain.transforms(axis_angle, np.zeros(3), np.eye(4))
    # without twist joints: they move nothing that is loose
    moved = world @ poser.joint_from_canonical[:52]
    skinned = parts.skinning @ moved[parts.joints, :3].transpose(0, 2, 1).reshape(-1, 3)
    targets, pull = skinned[: len(parts.places)], DOWN - skinned[len(parts.places) :]
    away = targets.take(parts.neighbours, 0) - targets[:, None]
    lengths = np.sqrt(np.einsum("nkc,nkc->nk", away, away))
    bones = moved[BONE, :3]
    capsules = np.einsum("kij,ekj->eki", bones[:, :, :3], parts.capsules) + bones[:, :, 3]
    return Driver(root, world[0, :3, :3], targets, lengths, pull, capsules)


def _moved(a: Driver, b: Driver) -> float:
    """How far particles' targets and capsules are from where they were, at most; metres."""
    shift = a.root - b.root
    return float(max(np.abs(a.targets - b.targets + shift).max(), np.abs(a.capsules - b.capsules + shift).max()))
