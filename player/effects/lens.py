"""What a lens and a shutter do to a film: the mean of several moments and places of the eye, drawn one after another.

A mean of whole frames is exact: what is in front hides what is behind it, transparent edges stay premultiplied, and
nothing bleeds over outlines. Sums of bytes are whole numbers, so the mean is rounded once. Which frames are drawn is
player/film/exposure.py; a window draws each moment once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from player.draw.drawing import Drawing, FrameInputs
from player.draw.plan import Absent, Decision, Draft, Pass, PassState
from player.draw.resources import Handle


@dataclass(frozen=True)
class LensPass(Pass):
    """Stands for the further frames whose mean a picture is; it draws nothing of its own."""

    name: str
    # why there is one frame where there could be several
    still: str
    uses: tuple[Handle[Any], ...] = ()

    def decide(self, drawing: Drawing) -> Decision:
        count = drawing.inputs.exposures
        if count > 1:
            return Decision(PassState.RUNS, f"the mean of {count} frames")
        return Decision(PassState.SKIPPED, self.still)

    def draw(self, drawing: Drawing) -> None:
        """The frames are drawn by the other passes."""

    def cost(self, drawn: float, inputs: FrameInputs, frame: Callable[[], float]) -> float:
        return (inputs.exposures - 1) * frame()


def lens_passes(draft: Draft, name: str, still: str) -> Sequence[Pass]:
    """The row of a lens effect in a plan."""
    if not draft.canvas.own_image:
        return (Absent(name, "for films: a window draws each moment once"),)
    return (LensPass(name, still),)
