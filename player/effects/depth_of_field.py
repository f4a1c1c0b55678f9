"""Depth of field: the mean of what is seen from all over the lens (Haeberli and Akeley 1990)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

from command.settings import Above, AtLeast, AtMost, check
from player.draw.plan import Draft, Pass, Stage
from player.effects.lens import lens_passes

SHARP = "nothing is out of focus by half a pixel"


@dataclass(frozen=True)
class DepthOfField:
    """How large the lens is, and what it is focused on.

    Raises:
        ValueError: a value that is out of its range.
    """

    stage: ClassVar[Stage] = Stage.PICTURE

    lens: Annotated[float, Above(0), AtMost(1), "diameter of the lens, metres: 0.025 is a 50 mm lens at f/2"] = 0.025
    focus: Annotated[
        float, AtLeast(0), AtMost(1e6), "metres before the lens that are sharp; 0: where the first avatar's head is"
    ] = 0.0
    samples: Annotated[int, AtLeast(4), AtMost(256), "places on the lens of which a frame is the mean"] = 24

    def __post_init__(self):
        check(self)

    def passes(self, draft: Draft) -> Sequence[Pass]:
        return lens_passes(draft, "depth of field", SHARP)
