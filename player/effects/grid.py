"""A grid on the ground, to see where things are and how large. Drawn behind the avatars."""

from collections.abc import Sequence
from typing import Annotated, ClassVar

import numpy as np

from command.settings import RGBA, Above, AtLeast, AtMost, Color, settings
from player.draw.plan import Decision, Draft, Pass, PassState, Stage
from player.effects.ground_plane import Sheet, SquarePass, behind_parts
from player.gl.shader import Uniforms

RUNS = Decision(PassState.RUNS, "asked for")
LINE = 1.2  # pixels
FULL = 0.3  # share of the metres to the grid's edge


@settings
class Grid:
    """How the grid looks."""

    stage: ClassVar[Stage] = Stage.GROUND

    spacing: Annotated[float, AtLeast(1e-3), AtMost(1e3), "of its lines, metres; thinner ones divide it by five"] = 1.0
    height: Annotated[float, AtLeast(-1e4), AtMost(1e4), "above the world's origin, metres"] = 0.0
    radius: Annotated[float, Above(0), AtMost(1e4), "about the avatars, metres; it fades towards its edge"] = 8.0
    color: Annotated[RGBA, Color(opaque=True), "of the lines, opaque"] = (0.55, 0.57, 0.62, 1.0)

    def passes(self, draft: Draft) -> Sequence[Pass]:
        parts = behind_parts(draft, "plane.vert", "grid.frag")
        return (SquarePass("grid", *parts, self.height, self.radius, FULL, 0.0, self._paint, RUNS),)

    def _paint(self, sheet: Sheet) -> Uniforms:
        # a whole number of lines from the world's origin, so that only small numbers are rounded
        origin = -np.fmod(sheet.anchor[[0, 2]], self.spacing)
        return {"paint": self.color[:3], "spacing": self.spacing, "width": LINE, "origin": tuple(origin.tolist())}
