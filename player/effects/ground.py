"""What avatars stand on: a floor, and their shadow on it (shadow.py).

All of it is drawn before the avatars, without depth: nothing fights with soles, and below the ground nothing shows.
"""

from collections.abc import Sequence
from typing import Annotated, ClassVar

import numpy as np

from command.settings import RGBA, Above, AtLeast, AtMost, Color, OneOf, settings
from player.draw.plan import Decision, Draft, Pass, PassState, Stage
from player.effects.ground_plane import Sheet, SquarePass, behind_parts
from player.effects.shadow import LOWEST, shadow_passes
from player.gl.shader import Uniforms

FLOOR_COLOR = (88 / 255, 91 / 255, 99 / 255, 1.0)
KINDS = ("plane", "checker", "shadow")
OTHER_CHECKS = 0.72
OPAQUE = 0.35  # share of the metres to the floor's edge


@settings
class Ground:
    """The floor and the lamp whose shadow falls on it.

    Raises:
        ValueError: a lamp lower than LOWEST.
    """

    stage: ClassVar[Stage] = Stage.GROUND

    kind: Annotated[str, OneOf(KINDS),
        "plane: one color; checker: checks of two; shadow: nothing but the shadow, on the background"] = "plane"
    color: Annotated[RGBA, Color(opaque=True), "of the floor, opaque"] = FLOOR_COLOR
    height: Annotated[float, AtLeast(-1e4), AtMost(1e4), "of the ground above the world's origin, metres"] = 0.0
    radius: Annotated[float, Above(0), AtMost(1e3),
        "of the floor about the avatars, metres; it fades into what is behind"] = 6.0
    check: Annotated[float, Above(0), AtMost(100), "of checker: a check's side, metres"] = 0.5
    direction: Annotated[tuple[float, float, float],
        "towards the lamp, world, any length; with `light` by lamps, capture or panorama its "
        "brightest lamp instead"] = (0.4, 0.85, 0.45)
    strength: Annotated[float, AtLeast(0), AtMost(1), "of the shadow; 0: none"] = 0.6
    softness: Annotated[float, AtLeast(0), AtMost(20), "size of the lamp, degrees from its middle to its edge"] = 2.0

    def __post_init__(self):
        length = float(np.linalg.norm(self.direction))
        if not length > 1e-6 or np.degrees(np.arcsin(self.direction[1] / length)) < LOWEST:
            expected = f"a lamp {LOWEST:g} degrees or more above the horizon"
            raise ValueError(f"direction: expected {expected}, found {self.direction}")

    def passes(self, draft: Draft) -> Sequence[Pass]:
        """The floor, unless there is nothing but shadow, and the shadow, unless it takes no light."""
        passes: list[Pass] = []
        if self.kind != "shadow":
            # checks stay where they are in the world
            checked = self.kind == "checker"
            step = 2 * self.check if checked else 0.0
            parts = behind_parts(draft, "plane.vert", "floor.frag", CHECKS=int(checked))
            running = Decision(PassState.RUNS, self.kind)
            passes.append(
                SquarePass("ground: floor", *parts, self.height, self.radius, OPAQUE, step, self._paint, running)
            )
        if self.strength > 0:
            passes += shadow_passes(draft, self.direction, self.strength, self.softness, self.height)
        return passes

    def _paint(self, sheet: Sheet) -> Uniforms:
        checks = {"other": OTHER_CHECKS, "check": self.check} if self.kind == "checker" else {}
        return {"paint": self.color[:3], **checks}
