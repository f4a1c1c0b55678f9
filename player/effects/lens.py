"""Motion blur and depth of field: the mean of what is seen while the shutter is open and from all over the lens
(Haeberli and Akeley 1990).

A mean of whole frames is exact: what is in front hides what is behind it, transparent edges stay premultiplied, and
nothing bleeds over outlines. Sums of bytes are whole numbers, so the mean is rounded once. Which frames are drawn is
player/film/exposure.py; a window draws each moment once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from command.settings import Above, AtLeast, AtMost, settings
from player.draw.drawing import Drawing, FrameInputs
from player.draw.plan import Absent, Decision, Draft, Pass, PassState, Stage

STILL = "nothing moves by half a pixel while the shutter is open"
SHARP = "nothing is out of focus by half a pixel"


@settings
class MotionBlur:
    """How long the shutter is open."""

    stage: ClassVar[Stage] = Stage.PICTURE

    shutter: Annotated[float, Above(0), AtMost(1),
        "share of the time between two frames in which the shutter is open"] = 0.5
    samples: Annotated[int, AtLeast(2), AtMost(64), "moments of which a frame is the mean"] = 8

    def passes(self, draft: Draft) -> Sequence[Pass]:
        return lens_passes(draft, "motion blur", STILL)


@settings
class DepthOfField:
    """How large the lens is, and what it is focused on."""

    stage: ClassVar[Stage] = Stage.PICTURE

    lens: Annotated[float, Above(0), AtMost(1), "diameter of the lens, metres: 0.025 is a 50 mm lens at f/2"] = 0.025
    focus: Annotated[float, AtLeast(0), AtMost(1e6),
        "metres before the lens that are sharp; 0: where the first avatar's head is"] = 0.0
    samples: Annotated[int, AtLeast(4), AtMost(256), "places on the lens of which a frame is the mean"] = 24

    def passes(self, draft: Draft) -> Sequence[Pass]:
        return lens_passes(draft, "depth of field", SHARP)


@dataclass(frozen=True)
class LensPass(Pass):
    """Stands for the further frames whose mean a picture is; it draws nothing of its own."""

    # why there is one frame where there could be several
    still: str

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
    if not draft.canvas.own_image:
        return (Absent(name, "for films: a window draws each moment once"),)
    return (LensPass(name, (), still),)
