"""Motion blur: the mean of what is seen while the shutter is open (Haeberli and Akeley 1990)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from command.settings import Above, AtLeast, AtMost, check
from player.draw.plan import Draft, Pass, Stage
from player.effects.lens import lens_passes

STILL = "nothing moves by half a pixel while the shutter is open"


@dataclass(frozen=True)
class MotionBlur:
    """How long the shutter is open.

    Raises:
        ValueError: a value that is out of its range.
    """

    stage: ClassVar[Stage] = Stage.PICTURE

    shutter: Annotated[
        float, Above(0), AtMost(1), "share of the time between two frames in which the shutter is open"
    ] = 0.5
    samples: Annotated[int, AtLeast(2), AtMost(64), "moments of which a frame is the mean"] = 8

    def __post_init__(self):
        check(self)

    def passes(self, draft: Draft) -> Sequence[Pass]:
        return lens_passes(draft, "motion blur", STILL)
