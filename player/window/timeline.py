"""Time in the window: plays, pauses, steps, scrubs; faster or slower; between A and B, round or to and fro.

Time never leaves the clip, so its precision does not fade in a run of months, and it depends on no clock but on
the steps that it is given.
"""

import math

LOOPS = ("loop", "to and fro", "once")
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
# seconds; after a stall the clip goes on where it was
LONGEST_STEP = 0.25


class Timeline:
    """Seconds into a clip of so many frames, and how they pass. A and B are frames; both belong to the range."""

    def __init__(self, frames: int, rate: float | int):
        if not (frames >= 1 and math.isfinite(rate) and rate > 0):
            raise ValueError(f"a timeline needs frames and a rate, has {frames} and {rate}")
        self.frames, self.rate = frames, float(rate)
        self.seconds, self.playing, self.speed, self.loop = 0.0, True, 1.0, LOOPS[0]
        # on the way back of "to and fro"
        self.backwards = False
        self.a: int | None = None
        self.b: int | None = None

    @property
    def duration(self) -> float:
        return self.frames / self.rate

    @property
    def frame(self) -> int:
        return min(int(self.seconds * self.rate + 1e-6), self.frames - 1)

    @property
    def span(self) -> tuple[float, float]:
        """Start and end of what is played, seconds."""
        last = self.frames - 1 if self.b is None else self.b
        return (self.a or 0) / self.rate, (last + 1) / self.rate

    def advance(self, dt: float | int) -> None:
        """Let `dt` seconds pass. A stall counts as LONGEST_STEP; a clock that goes backwards stands still."""
        if not self.playing or not dt > 0:
            return
        start, end = self.span
        length, step = end - start, self.speed * min(dt, LONGEST_STEP)
        into = min(max(self.seconds - start, 0.0), length)
        if self.loop == "loop":
            self.seconds = start + (into + step) % length
        elif self.loop == "once":
            if into + step >= length:
                self.seconds, self.playing = end - 0.5 / self.rate, False
            else:
                self.seconds = start + into + step
        else:  # position on the way there and back, unfolded
            way = ((2 * length - into if self.backwards else into) + step) % (2 * length)
            self.backwards = way >= length
            self.seconds = start + (2 * length - way if self.backwards else way)
            self.seconds = min(self.seconds, end - 0.5 / self.rate)

    def seek(self, frame: int) -> None:
        """Show a frame: its middle, so that rounding cannot show its neighbour."""
        self.seconds = (min(max(frame, 0), self.frames - 1) + 0.5) / self.rate

    def scrub(self, seconds: float | int) -> None:
        """Show a moment of the clip; playing or not stays."""
        self.seek(int(min(max(seconds, 0.0), self.duration) * self.rate + 1e-6))

    def step(self, frames: int) -> None:
        """Pause, and go so many frames on or back."""
        self.playing = False
        self.seek(self.frame + frames)

    def toggle(self) -> None:
        """Play or pause; a clip that was played once to its end begins anew."""
        if not self.playing and self.loop == "once" and self.seconds >= self.span[1] - 0.6 / self.rate:
            self.seconds = self.span[0]
        self.playing = not self.playing

    def faster(self, notches: int) -> None:
        """The next of SPEEDS, up or down."""
        nearest = min(range(len(SPEEDS)), key=lambda i: abs(SPEEDS[i] - self.speed))
        self.speed = SPEEDS[min(max(nearest + notches, 0), len(SPEEDS) - 1)]

    def next_loop(self) -> None:
        self.loop, self.backwards = LOOPS[(LOOPS.index(self.loop) + 1) % len(LOOPS)], False

    def set_a(self, frame: int | None) -> None:
        """The range begins here; None: at the start."""
        self.a = None if frame is None else min(max(frame, 0), self.frames - 1)
        if self.a is not None and self.b is not None and self.b < self.a:
            self.b = None

    def set_b(self, frame: int | None) -> None:
        """The range ends with this frame; None: at the end."""
        self.b = None if frame is None else min(max(frame, 0), self.frames - 1)
        if self.a is not None and self.b is not None and self.b < self.a:
            self.a = None

    def range_off(self) -> None:
        """The whole clip again."""
        self.a = self.b = None

    def status(self) -> str:
        """Frame, time and what is not as usual, in one line."""
        parts = [f"frame {self.frame}/{self.frames}", f"{self.frame / self.rate:.1f} s"]
        if self.a is not None or self.b is not None:
            parts.append(f"A-B {self.a or 0}-{self.frames - 1 if self.b is None else self.b}")
        if self.speed != 1:
            parts.append(f"x{self.speed:g}")
        if self.loop != LOOPS[0]:
            parts.append(self.loop)
        if not self.playing:
            parts.append("paused")
        return "  ".join(parts)
