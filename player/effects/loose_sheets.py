"""Hair, skirts and sleeves as sheets of particles (player/effects/loose_parts.py): how they move in a substep.

Extended position based dynamics (Macklin et al. 2016): each particle is drawn to where plain skinning has it by a
spring of compliance 1 / (2 pi f)^2, f rising as looseness falls, keeps its distance to its neighbours as they lie in
the skinned pose, and stays out of the body's capsules. Damping is of the motion relative to the skinned pose. Gravity
acts by how far it has turned from where it pulls in pose 0, since a capture was filmed with gravity: who stands upright
looks as filmed.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

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
