"""What a lens and a shutter do to a film: the mean of several moments and places of the eye, drawn one after another.

A mean of whole frames is exact: what is in front hides what is behind it, transparent edges stay premultiplied, and
nothing bleeds over outlines. Sums of bytes are whole numbers, so the mean is rounded once. Which frames are drawn is
player/filming/exposure.py; a window draws each moment once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from player.drawing import Drawing, Warming
from player.plan import Absent, Decision, Draft, Pass, State
from player.resources import Handle


@dataclass(frozen=True)
class LensPass:
    """Stands for the further frames whose mean a picture is; it draws nothing of its own."""

    name: str
    # why there is one frame where there could be several
    still: str
    uses: tuple[Handle[Any], ...] = ()

    def decide(self, drawing: Drawing) -> Decision:
        count = drawing.inputs.exposures
        return Decision(State.RUNS, f"the mean of {count} frames") if count > 1 else Decision(State.SKIPPED, self.still)

    def draw(self, drawing: Drawing) -> None:
        """The frames are drawn by the other passes."""

    def warm(self, warming: Warming) -> None:
        """Nothing is compiled."""


def lens_passes(draft: Draft, name: str, still: str) -> Sequence[Pass]:
    """The row of a lens effect in a plan."""
    if not draft.canvas.own_image:
        return (Absent(name, "for films: a window draws each moment once"),)
    return (LensPass(name, still),)
