"""Time in the window: plays round and round, pauses, steps, scrubs; faster or slower.

Time never leaves the clip, so its precision does not fade in a run of months, and it depends on no clock but on
the steps that it is given.
"""

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
# seconds; after a stall the clip goes on where it was
LONGEST_STEP = 0.25


class Timeline:
    """Seconds into a clip of so many frames, and how they pass."""

    def __init__(self, frames: int, rate: float | int):
        self.frames, self.rate = frames, float(rate)
        self.seconds, self.playing, self.speed = 0.0, True, 1.0

    @property
    def duration(self) -> float:
        return self.frames / self.rate

    @property
    def frame(self) -> int:
        return min(int(self.seconds * self.rate + 1e-6), self.frames - 1)

    def advance(self, dt: float | int) -> None:
        """Let `dt` seconds pass. A stall counts as LONGEST_STEP; a clock that goes backwards stands still."""
        if not self.playing or not dt > 0:
            return
        self.seconds = (self.seconds + self.speed * min(dt, LONGEST_STEP)) % self.duration

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
        self.playing = not self.playing

    def faster(self, notches: int) -> None:
        """The next of SPEEDS, up or down."""
        nearest = min(range(len(SPEEDS)), key=lambda i: abs(SPEEDS[i] - self.speed))
        self.speed = SPEEDS[min(max(nearest + notches, 0), len(SPEEDS) - 1)]

    def status(self) -> str:
        """Frame, time and what is not as usual, in one line."""
        parts = [f"frame {self.frame}/{self.frames}", f"{self.frame / self.rate:.1f} s"]
        if self.speed != 1:
            parts.append(f"x{self.speed:g}")
        if not self.playing:
            parts.append("paused")
        return "  ".join(parts)
