"""What moves loose parts in one pose, and between two."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Array = np.ndarray

# seconds
STEP = 1 / 120


class Driver(NamedTuple):
    """What moves the particles in one pose, relative to the pelvis; metres."""

    root: Float[Array, "3"]
    # turn of the pelvis
    turn: Float[Array, "3 3"]
    # where the pose has the particles; behind them, of chains, what their heads hang on
    targets: Float[Array, "points 3"]
    # both ends of each capsule
    capsules: Float[Array, "2 capsules 3"]
    # of sheets: to each neighbour, and gravity beyond that of pose 0, parts of it
    lengths: Float[Array, "particles neighbours"] = np.zeros((0, 0))
    pull: Float[Array, "particles 3"] = np.zeros((0, 3))
    # of chains: the joints whose motion is no motion for some
    centers: Float[Array, "centers 3 4"] = np.zeros((0, 3, 4))

    def moved(self, shift: Float[Array, "3"]) -> "Driver":
        """The same seen from a pelvis that has moved."""
        centers = self.centers
        if len(centers):
            centers = centers.copy()
            centers[:, :, 3] -= shift
        return self._replace(targets=self.targets - shift, capsules=self.capsules - shift, centers=centers)


class Way:
    """From one driver to the next."""

    def __init__(self, before: Driver, now: Driver, dt: float):
        self.before, self.now, self.dt = before, now, dt
        self.targets = now.targets - before.targets
        self.speed = self.targets / dt
        self._others = [b - a for a, b in zip(before[3:], now[3:], strict=True)]

    def at(self, share: float) -> Driver:
        """The driver at a share of the way."""
        others = [a + share * way for a, way in zip(self.before[3:], self._others, strict=True)]
        return Driver(self.now.root, self.now.turn, self.before.targets + share * self.targets, *others)
