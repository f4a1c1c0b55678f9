"""Which rung a window shows: down when frames are slow, up when there is room, and no to and fro.

Down after SLOW slow frames among the last WATCHED; up after WATCHED frames since the last change, of which hardly any
was slow, where the better rung leaves HEADROOM. How busy the machine is follows from the current rung: what its frames
take now, beside what they took when it was measured. A change goes straight to the rung that fits this, so that a load
that comes costs one change, not one for each rung. A step up that had to be taken back is not tried again soon: the
wait doubles, up to PATIENCE times.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from player.budget.ladder import HEADROOM, PricedRung, frontier, within

SLOW, WATCHED = 12, 48
SETTLING = 3  # frames after a change, in which what the rung needs is made
# slow frames that a rung which holds its p95 may have
ALLOWED = 3
PATIENCE = 16


class BudgetController:
    """Takes the milliseconds of each frame's own work, and says when to change."""

    def __init__(self, priced: Sequence[PricedRung], budget: float, current: PricedRung):
        self.front, self.budget, self.current = frontier(priced), budget, current
        self._times: deque[float] = deque(maxlen=WATCHED)
        self._settling, self._since, self._wait = SETTLING, 0, 1
        self._went_up = False

    def frame(self, ms: float) -> PricedRung | None:
        """A frame took so long; the rung to change to, or None."""
        if self._settling:
            self._settling -= 1
            return None
        self._times.append(ms)
        self._since += 1
        slow = sum(time > self.budget for time in self._times)
        if slow >= SLOW:
            return self._changed(self._cheaper())
        if self._since >= WATCHED * self._wait and slow <= ALLOWED:
            better = self._better()
            if better is None and self._since >= 4 * WATCHED * self._wait:
                # it has held long enough to be trusted again
                self._wait, self._went_up = 1, False
            return self._changed(better)
        return None

    @property
    def load(self) -> float:
        """How much longer frames take than when they were measured."""
        return float(np.median(self._times)) / max(self.current.ms_median, 1e-6) if self._times else 1.0

    @property
    def costlier(self) -> PricedRung | None:
        above = [one for one in self.front if one.ms_p95 > self.current.ms_p95 and one.error < self.current.error]
        return above[0] if above else None

    def _cheaper(self) -> PricedRung | None:
        """Where a slow rung goes: the best that holds under this load among the cheaper ones, else the cheapest."""
        below = [one for one in self.front if one.ms_p95 < self.current.ms_p95]
        if not below:
            return None
        if self._went_up:
            self._wait = min(2 * self._wait, PATIENCE)
        self._went_up = False
        # only its quick frames say nothing about the slow ones that are the reason to go
        slow = [time for time in self._times if time > self.budget]
        load = max(self.load, float(np.median(slow)) / max(self.current.ms_median, 1e-6))
        return within(below, self.budget, load) or below[0]

    def _better(self) -> PricedRung | None:
        # a load that has just gone is not gone for good: nearly all frames watched have to be quick
        load = max(self.load, float(np.percentile(self._times, 90)) / max(self.current.ms_p95, 1e-6))
        best = within(self.front, self.budget * (1 - HEADROOM), load)
        if best is None or best.ms_p95 <= self.current.ms_p95 or best.error >= self.current.error:
            return None
        self._went_up = True
        return best

    def _changed(self, rung: PricedRung | None) -> PricedRung | None:
        if rung is None:
            return None
        self.current = rung
        self._times.clear()
        self._settling, self._since = SETTLING, 0
        return rung
