"""How late a pose is: sent, received, applied, drawn; percentiles for the screen.

Sent is on the sender's clock. Where that is Unix time of this machine (our JSON), sent to received is what it
says; elsewhere the two clocks share no start, and it is counted from the quickest datagram so far. Applied is when the
pose was taken for drawing, drawn when the buffers were swapped.
"""

import time
from collections import deque
from typing import NamedTuple

import numpy as np

from player.live.frame import LiveFrame

DRAWN = "received to drawn"
SPANS = ("sent to received", "received to applied", DRAWN)
KEPT = 2048  # frames, for the percentiles
UNIX = 1e9  # seconds; a larger time is Unix time
# seconds; Unix clocks of two machines that differ by more are not compared
BELIEVED = 10.0


class Percentiles(NamedTuple):
    """Milliseconds."""

    p50: float
    p95: float
    p99: float


class Latency:
    """Stamps of the frames that were drawn."""

    def __init__(self):
        self.spans: deque[tuple[float, float, float]] = deque(maxlen=KEPT)
        self.quickest = np.inf
        self.last = -1
        self.pending: tuple[LiveFrame, float] | None = None

    def applied(self, frame: LiveFrame, now: float | int) -> None:
        """The frame goes into the picture that is drawn next; only its first time counts."""
        if frame.number != self.last:
            self.pending, self.last = (frame, float(now)), frame.number

    def drawn(self, now: float | int) -> None:
        """The picture with the applied frame is on the screen."""
        if self.pending is None:
            return
        (frame, applied), self.pending = self.pending, None
        self.spans.append((self._travel(frame), applied - frame.received, now - frame.received))

    def _travel(self, frame: LiveFrame) -> float:
        """Seconds from sent to received; NaN where the sender has no clock."""
        if frame.sent is None:
            return np.nan
        if frame.sent > UNIX:
            travelled = frame.received + (time.time() - time.monotonic()) - frame.sent
            # a millisecond: the two clocks are not read at once
            if -1e-3 < travelled < BELIEVED:
                return max(travelled, 0.0)
        offset = frame.received - frame.sent
        # another clock: a restarted sender
        if abs(offset - self.quickest) > BELIEVED:
            self.quickest = offset
        self.quickest = min(self.quickest, offset)
        return offset - self.quickest

    def percentiles(self) -> dict[str, Percentiles]:
        """Of the spans of the last frames that were measured, by name."""
        found = {}
        for name, values in zip(SPANS, 1000 * np.array(self.spans).reshape(-1, 3).T, strict=True):
            if np.isfinite(values).any():
                found[name] = Percentiles(*np.nanpercentile(values, [50, 95, 99]).tolist())
        return found

    def summary(self) -> list[str]:
        """One line a span, for printing at the end."""
        return [
            f"latency, {name}: p50 {span.p50:.2f} ms, p95 {span.p95:.2f}, p99 {span.p99:.2f}"
            for name, span in self.percentiles().items()
        ]
