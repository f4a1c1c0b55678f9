"""Hair, skirts and sleeves that follow the body: a simulation of an avatar's loose particles (loose_parts.py).

Extended position based dynamics (Macklin et al. 2016): each particle is drawn to where plain skinning has it by a
spring of compliance 1 / (2 pi f)^2, f rising as looseness falls, keeps its distance to its neighbours as they lie in
the skinned pose, and stays out of the body's capsules. Damping is of the motion relative to the skinned pose. Gravity
acts by how far it has turned from where it pulls in pose 0, since a capture was filmed with gravity: who stands upright
looks as filmed.

In fixed substeps of STEP. The pose is interpolated to each substep on the parabola through three frames, a substep
takes everything from its own moment, and what is drawn lies between the last two: so it depends on neither how often
frames are drawn nor how they fall between substeps. Everything is relative to the pelvis of the frame, and the
particles keep the world's velocity as it moves on: ten kilometres away nothing trembles. A body that jumps (faster than
FASTEST, or turned by more than TURNED) carries its particles along. Nothing is random and no clock is read.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from player.draw.drawing import FASTEST, TURNED, GivenPose
from player.effects.contact_capsules import squared_distances
from player.effects.loose_parts import DrivenPose, LooseParts, lengths_of, ways
from player.effects.secondary_motion import SecondaryMotion

STEP = 1 / 120  # seconds
REACH = 0.3  # metres off the pose, of a grown person
DAMPING = 0.3  # share of critical damping
# looseness counts as at least this: springs stay finite
STIFFEST = 0.05
# at most, of the last push out of the capsules, and metres in which they may leave a particle
PUSHES, DEEPEST = 4, 1e-3
# seconds; after a longer frame, or a step back in time, particles begin anew where they are skinned to
LONGEST = 0.5
SPEED_CAP = 8.0  # metres a second relative to the pose, of a grown person
# asleep: slower than this for so many seconds, while what drives it moved less than this; m/s, s, m
SLOW, CALM, STILL = 0.01, 0.5, 5e-4
# the most by which one frame may be longer than another
UNEVEN = 4.0
UNSEEN = 5e-5  # metres: what is moved less is drawn as skinned


class Apart:
    """How far particles keep off capsules."""

    def __init__(self, radii: Float[Array, "particles capsules"], least: float):
        """radii: what a particle keeps off the line in the middle; deeper in than `least` it is moved."""
        self._radii = np.ascontiguousarray(radii.T)
        self._limits = np.where(self._radii > least, (self._radii - least) ** 2, -1.0)

    def pushed(self, y: Float[Array, "particles 3"], ends: Float[Array, "2 capsules 3"]) -> Array | None:
        """The particles, each moved out of the capsule that it is deepest in; None: none is deep in any."""
        if not self._limits.size:
            return None
        within = squared_distances(y, *ends) < self._limits
        if not within.any():
            return None
        which, own = np.nonzero(within)
        start = ends[0][which]
        along = ends[1][which] - start
        point = y[own] - start
        length2 = np.maximum(np.einsum("nc,nc->n", along, along), 1e-18)
        share = np.minimum(np.maximum(np.einsum("nc,nc->n", point, along) / length2, 0), 1)
        off = point - share[:, None] * along
        far = np.sqrt(np.einsum("nc,nc->n", off, off))
        deep = self._radii[which, own] - far
        # the deepest is written last
        order = np.argsort(deep, kind="stable")
        out = y.copy()
        out[own[order]] = (y[own] + (deep / np.maximum(far, 1e-9))[:, None] * off)[order]
        return out


class Sheets:
    """How the particles of an avatar's sheets move in a substep."""

    def __init__(self, parts: LooseParts, springs: SecondaryMotion):
        self.parts = parts
        omega = 2 * np.pi * springs.frequency / np.maximum(parts.looseness, STIFFEST)[:, None]
        # share of the way to its target in a substep: compliance 1 / omega^2
        self._drawn = 1 / (1 + 1 / (omega * STEP) ** 2)
        self._damped = np.exp(-2 * DAMPING * omega * STEP)
        self._gravity = springs.gravity * parts.unit
        self._neighbours = np.ascontiguousarray(parts.neighbours.T)
        self._pull = np.ascontiguousarray(parts.pull.T)
        self._apart = Apart(parts.radii, 0.0)
        self._drawn_apart = Apart(parts.radii, DEEPEST * parts.unit)

    def substep(self, x: Array, v: Array, speed: Array, at: DrivenPose) -> Array:
        """Where springs, gravity, neighbours and capsules have the particles; speed: of the pose itself, m/s."""
        parts, targets = self.parts, at.targets
        y = x + STEP * (speed + (v - speed) * self._damped + STEP * self._gravity * at.pull)
        y += (targets - y) * self._drawn
        away = ways(y, self._neighbours)
        # cloth folds, it does not stretch
        stretched = np.maximum(1 - at.lengths / np.maximum(lengths_of(away), 1e-12), 0)
        stretched *= self._pull
        away *= stretched
        y += away.sum(1).T
        offset = y - targets
        far = np.sqrt(np.einsum("nc,nc->n", offset, offset))[:, None]
        y = targets + offset * np.minimum(1, REACH * parts.unit / np.maximum(far, 1e-12))
        pushed = self._apart.pushed(y, at.capsules)
        return y if pushed is None else pushed

    def settled(self, y: Array, at: DrivenPose) -> Array:
        """Out of the capsules of this very pose."""
        for _ in range(PUSHES):
            pushed = self._drawn_apart.pushed(y, at.capsules)
            if pushed is None:
                break
            y = pushed
        return y


class Way:
    """From one driver to the next, on the parabola through them and the one before, where that is known.

        p(s) = b + s (n - b) + s (s - 1) c        c = (o - b + r (n - b)) / (r (r + 1))

    with r the seconds from o to b in those from b to n.
    """

    def __init__(self, before: DrivenPose, now: DrivenPose, dt: float, older: "Way | None"):
        """older: the way to `before`."""
        self.before, self.now, self.dt = before, now, dt
        self._way = [b - a for a, b in zip(before[2:], now[2:], strict=True)]
        self._curve = None
        ratio = 0.0 if older is None else older.dt / dt
        # the parabola says nothing of frames as uneven as no player's
        if older is not None and 1 / UNEVEN <= ratio <= UNEVEN:
            share = 1 / (ratio * (ratio + 1))
            self._curve = [share * (ratio * b - a) for a, b in zip(older._way, self._way, strict=True)]

    def at(self, share: float) -> DrivenPose:
        found = [a + share * way for a, way in zip(self.before[2:], self._way, strict=True)]
        if self._curve is not None:
            bend = share * (share - 1)
            found = [value + bend * curve for value, curve in zip(found, self._curve, strict=True)]
        return DrivenPose(self.now.root, self.now.turn, *found)


class LooseMotion:
    """The particles of one avatar as they move on from frame to frame."""

    def __init__(self, parts: LooseParts, springs: SecondaryMotion):
        self.parts = parts
        self._sheets = Sheets(parts, springs)
        self._seconds: float | None = None
        # raised whenever the offsets change: what is drawn of them may be kept while it stands
        self.version = 0
        self.steps = 0
        # milliseconds of the last frame
        self.ms = 0.0
        # where the particles are, off where they are skinned to; world, metres
        self.offsets = np.zeros_like(parts.places)
        self.reach = 0.0  # metres of the farthest particle from where it is skinned to
        # whether nothing moves any more, and nothing is computed
        self.asleep = False

    def move(self, pose: GivenPose, seconds: float) -> None:
        """Go on to a pose at a moment; the first sets the particles where it skins them to."""
        if self._seconds is None or not 0 <= seconds - self._seconds <= LONGEST:
            self._begin(pose, seconds)
            return
        dt = seconds - self._seconds
        self._seconds = seconds
        same = np.array_equal(pose[0], self._pose[0]) and np.array_equal(pose[1], self._pose[1])
        if same and (self.asleep or dt == 0):
            return
        now = self._driver if same else self.parts.drive(pose)
        self._pose = pose
        if self.asleep:
            if _moved(now, self._reference) < STILL * self.parts.unit:
                return
            self.asleep, self._calm = False, 0.0
        if same:
            self._older = None
        before = self._follow(now, dt)
        self._driver = now
        self._advance(before, now, dt)
        # a jump has none, nor a pose that is held
        if same or before is now:
            self._older = None
        self._settle(now)

    def _begin(self, pose: GivenPose, seconds: float) -> None:
        self._pose, self._seconds = pose, seconds
        self._driver = self._reference = self.parts.drive(pose)
        self._x = self._driver.targets.copy()
        self._v = np.zeros_like(self._x)
        # where the pose had the particles in the last substep
        self._aim = self._x
        self._last = self._now = np.zeros_like(self._x)
        self._clock = self._calm = 0.0
        self.asleep = False
        # that of the frame before; None: there was a jump, or a pose was held
        self._older: Way | None = None
        self._settle(self._driver)

    def _follow(self, now: DrivenPose, dt: float) -> DrivenPose:
        """The driver before this frame as seen from this frame's pelvis; what jumps carries its particles along."""
        before, limit = self._driver, FASTEST * self.parts.unit * dt
        shift = now.root - before.root
        turn = now.turn @ before.turn.T
        angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
        if np.linalg.norm(shift) > limit or angle > TURNED:
            self._older = None
            offset = (self._x - before.targets) @ turn.T
            self._x, self._v = now.targets + offset, self._v @ turn.T
            self._aim = now.targets
            self._last, self._now = self._last @ turn.T, self._now @ turn.T
            # a body that jumps is not fast
            self._v = np.clip(self._v, -SPEED_CAP * self.parts.unit, SPEED_CAP * self.parts.unit)
            return now
        self._x, self._aim = self._x - shift, self._aim - shift
        before = before._replace(targets=before.targets - shift, capsules=before.capsules - shift)
        way = now.targets - before.targets
        far2 = np.einsum("nc,nc->n", way, way)[:, None]
        if far2.max() > limit**2:
            far = np.sqrt(far2)
            over = way * (1 - np.minimum(1, limit / np.maximum(far, 1e-12)))
            self._x, self._aim = self._x + over, self._aim + over
            before = before._replace(targets=before.targets + over)
            self._older = None
        return before

    def _advance(self, before: DrivenPose, now: DrivenPose, dt: float) -> None:
        """All substeps that have begun by the end of a frame."""
        if dt <= 0:
            return
        first = STEP - self._clock
        count = int(np.floor((self._clock + dt) / STEP + 1e-9))
        self._clock = max(self._clock + dt - count * STEP, 0.0)
        way, cap = Way(before, now, dt, self._older), SPEED_CAP * self.parts.unit
        self._older = way
        if not count:
            return
        for k in range(count):
            at = way.at(min((first + k * STEP) / dt, 1.0))
            # the pose's speed in this very substep: a frame's would be another at every rate of frames
            speed = (at.targets - self._aim) / STEP
            start, self._aim = self._x, at.targets
            self._x = self._sheets.substep(start, self._v, speed, at)
            v = (self._x - start) / STEP - speed
            fast = np.sqrt((v * v).sum(1, keepdims=True))
            v *= np.minimum(1, cap / np.maximum(fast, 1e-12))
            self._v = v + speed
            self._last, self._now = self._now, self._x - self._aim
            slow = float(np.abs(self._now - self._last).max()) < SLOW * self.parts.unit * STEP
            self._calm = self._calm + STEP if slow else 0.0
        self.steps += count
        if self._calm == 0 or _moved(now, self._reference) > STILL * self.parts.unit:
            self._reference, self._calm = now, 0.0
        elif self._calm >= CALM:
            self.asleep, self._last = True, self._now
            self._v = np.zeros_like(self._v)

    def _settle(self, now: DrivenPose) -> None:
        """The offsets that this frame draws: between the last two substeps, and outside of the capsules."""
        targets, share = now.targets, self._clock / STEP
        offsets = self._last + share * (self._now - self._last)
        self.offsets = self._sheets.settled(targets + offsets, now) - targets
        self.reach = float(np.sqrt((self.offsets**2).sum(1).max()))
        self.version += 1

    @property
    def shows(self) -> bool:
        """Whether anything is moved so far that it can be seen."""
        return self._seconds is not None and self.reach > UNSEEN * self.parts.unit


def _moved(a: DrivenPose, b: DrivenPose) -> float:
    """How far particles' targets and capsules are from where they were, at most; metres."""
    shift = a.root - b.root
    return max(float(np.abs(x - y + shift).max(initial=0)) for x, y in zip(a[2:4], b[2:4], strict=True))
