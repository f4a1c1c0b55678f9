"""Hair, skirts and sleeves as sheets of particles (player/loose_parts.py): how they move in a substep.

Extended position based dynamics (Macklin et al. 2016): each particle is drawn to where plain skinning has it by a
spring of compliance 1 / (2 pi f)^2, f rising as looseness falls, keeps its distance to its neighbours as they lie in
the skinned pose, and stays out of the body's capsules. Damping is of the motion relative to the skinned pose. Gravity
acts by how far it has turned from where it pulls in pose 0, since a capture was filmed with gravity: who stands upright
looks as filmed.
"""

import numpy as np
from jaxtyping import Float, Int

from player.loose_driver import STEP, Driver, Way
from player.loose_parts import LooseParts, capsule_distances
from player.passes.secondary_motion import SecondaryMotion

Array = np.ndarray

# metres off the pose, of a grown person
REACH = 0.3
# of critical damping
DAMPING = 0.3
# looseness counts as at least this: springs stay finite
STIFFEST = 0.05
# at most, of the last push out of the capsules, and metres in which they may leave a particle
PUSHES, DEEPEST = 4, 1e-3


class Sheets:
    """How the particles of an avatar's sheets move in a substep."""

    def __init__(self, parts: LooseParts, springs: SecondaryMotion):
        self.parts = parts
        omega = 2 * np.pi * springs.frequency / np.maximum(parts.looseness, STIFFEST)[:, None]
        # of the way to its target in a substep: compliance 1 / omega^2
        self._drawn = 1 / (1 + 1 / (omega * STEP) ** 2)
        self._damped = np.exp(-2 * DAMPING * omega * STEP)
        self._gravity = springs.gravity * parts.unit
        self._speed = np.zeros_like(parts.places)
        self._pairs: tuple[Array, Array] | None = None
        self._close: Array | None = None

    def frame(self, way: Way) -> Float[Array, "particles 3"]:
        """Begin a frame; the velocities that those of the particles stay near."""
        self._pairs = self._near()
        self._speed = way.speed
        return way.speed

    def substep(self, x: Array, v: Array, at: Driver) -> tuple[Array, Array]:
        """Where the particles come from, and where springs, gravity, neighbours and capsules have them."""
        parts, targets = self.parts, at.targets
        y = x + STEP * (self._speed + (v - self._speed) * self._damped + STEP * self._gravity * at.pull)
        y += (targets - y) * self._drawn
        away = y.take(parts.neighbours, 0) - y[:, None]
        long = np.sqrt(np.einsum("nkc,nkc->nk", away, away))
        # cloth folds, it does not stretch
        y += np.einsum("nk,nkc->nc", parts.pull * np.maximum(1 - at.lengths / np.maximum(long, 1e-12), 0), away)
        offset = y - targets
        far = np.sqrt(np.einsum("nc,nc->n", offset, offset))[:, None]
        y = targets + offset * np.minimum(1, REACH * parts.unit / np.maximum(far, 1e-12))
        if self._pairs is not None:
            self._push(y, at.capsules, self._pairs)
        return x, y

    def _near(self) -> tuple[Int[Array, "pairs"], Int[Array, "pairs"]] | None:
        """The capsule that each particle is nearest to, of those that are near one at all."""
        if self._close is None:
            return None
        nearest = self._close.argmin(1)
        own = np.flatnonzero(self._close[np.arange(len(nearest)), nearest] < 0.1 * self.parts.unit)
        return (own, nearest[own]) if len(own) else None

    def _push(self, y: Array, ends: Float[Array, "2 capsules 3"], pairs: tuple[Array, Array]) -> None:
        own, which = pairs
        start, along = ends[0][which], (ends[1] - ends[0])[which]
        point = y[own] - start
        share = np.einsum("nc,nc->n", point, along) / np.maximum(np.einsum("nc,nc->n", along, along), 1e-18)
        off = point - np.clip(share, 0, 1)[:, None] * along
        far = np.sqrt(np.einsum("nc,nc->n", off, off))
        deep = self.parts.radii[own, which] - far
        if deep.max() > 0:
            push = np.maximum(deep, 0) / np.maximum(far, 1e-9)
            y[own] += push[:, None] * off

    def settled(self, y: Array, at: Driver) -> Array:
        """Out of the capsules of this very pose."""
        y, radii = y.copy(), self.parts.radii
        for sweep in range(PUSHES):
            self._close = capsule_distances(y, *at.capsules) - radii
            nearest = self._close.argmin(1)
            rows = np.arange(len(nearest))
            own = np.flatnonzero(self._close[rows, nearest] < -DEEPEST * self.parts.unit)
            if not len(own) or sweep == PUSHES - 1:
                break
            start, along = at.capsules[0][nearest[own]], (at.capsules[1] - at.capsules[0])[nearest[own]]
            point = y[own] - start
            length = np.maximum((along * along).sum(1), 1e-18)
            off = point - np.clip((point * along).sum(1) / length, 0, 1)[:, None] * along
            far = np.sqrt((off * off).sum(1, keepdims=True))
            y[own] += -self._close[own, nearest[own], None] * off / np.maximum(far, 1e-9)
        return y
