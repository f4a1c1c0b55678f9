"""What moves loose parts in one pose, and between two."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Array = np.ndarray

STEP = 1 / 120  # seconds
# the most by which one frame may be longer than another
UNEVEN = 4.0


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

    def moved(self, shift: Float[Array, "3"]) -> "DrivenPose":
        """The same seen from a pelvis that has moved."""
        return self._replace(targets=self.targets - shift, capsules=self.capsules - shift)


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
        """The driver at a share of the way."""
        found = [a + share * way for a, way in zip(self.before[2:], self._way, strict=True)]
        if self._curve is not None:
            bend = share * (share - 1)
            found = [value + bend * curve for value, curve in zip(found, self._curve, strict=True)]
        return DrivenPose(self.now.root, self.now.turn, *found)
