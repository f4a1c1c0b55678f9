"""What avatars stand on: a floor, and their shadow on it (shadow.py).

All of it is drawn before the avatars, without depth: nothing fights with soles, and below the ground nothing shows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import moderngl
import numpy as np

from command.settings import Above, AtLeast, AtMost, Color, OneOf, check
from player.draw.drawing import Drawing, Layer
from player.draw.plan import Decision, Draft, Pass, PassState, Stage
from player.draw.resources import Handle, PlanResources
from player.effects.ground_plane import PassBehind, Sheet, draw_behind
from player.effects.shadow import LOWEST, ShadowSettings, shadow_passes
from player.gl.shader import uniform

FLOOR_COLOR = (88 / 255, 91 / 255, 99 / 255, 1.0)
KINDS = ("plane", "checker", "shadow")
OTHER_CHECKS = 0.72
# share of the metres to the floor's edge
OPAQUE = 0.35

BELOW = Decision(PassState.SKIPPED, "the ground is out of view, or seen from below")


@dataclass(frozen=True)
class Ground:
    """The floor and the lamp whose shadow falls on it.

    Raises:
        ValueError: a value that is out of its range, a color that is not opaque, or a lamp lower than LOWEST.
    """

    stage: ClassVar[Stage] = Stage.GROUND

    kind: Annotated[
        str, OneOf(KINDS), "plane: one color; checker: checks of two; shadow: nothing but the shadow, on the background"
    ] = "plane"
    color: Annotated[tuple[float, float, float, float], Color(), "of the floor, opaque"] = FLOOR_COLOR
    height: Annotated[float, AtLeast(-1e4), AtMost(1e4), "of the ground above the world's origin, metres"] = 0.0
    radius: Annotated[
        float, Above(0), AtMost(1e3), "of the floor about the avatars, metres; it fades into what is behind"
    ] = 6.0
    check: Annotated[float, Above(0), AtMost(100), "of checker: a check's side, metres"] = 0.5
    direction: Annotated[
        tuple[float, float, float],
        "towards the lamp, world, any length; with `light` by lamps, capture or panorama its brightest lamp instead",
    ] = (0.4, 0.85, 0.45)  # fmt: skip
    strength: Annotated[float, AtLeast(0), AtMost(1), "of the shadow; 0: none"] = 0.6
    softness: Annotated[float, AtLeast(0), AtMost(20), "size of the lamp, degrees from its middle to its edge"] = 2.0

    def __post_init__(self):
        check(self)
        if self.color[3] < 1:
            raise ValueError("color: a floor is opaque: expected #rrggbb")
        length = float(np.linalg.norm(self.direction))
        if not length > 1e-6 or np.degrees(np.arcsin(self.direction[1] / length)) < LOWEST:
            raise ValueError(
                f"direction: expected a lamp {LOWEST:g} degrees or more above the horizon, found {self.direction}"
            )

    def passes(self, draft: Draft) -> Sequence[Pass]:
        drawn_on = draft.behind_avatars
        passes: list[Pass] = []
        if self.kind != "shadow":
            program = draft.program("plane.vert", "floor.frag")
            array = draft.array(program)
            passes.append(FloorPass((*drawn_on, array), self, draft.layer, program, array))
        if self.strength > 0:
            shadow = ShadowSettings(self.direction, self.strength, self.softness, self.height)
            passes += shadow_passes(draft, drawn_on, shadow)
        return passes


@dataclass(frozen=True)
class FloorPass(PassBehind):
    uses: tuple[Handle[Any], ...]
    ground: Ground
    layer: Layer
    program: Handle[moderngl.Program]
    array: Handle[moderngl.VertexArray]
    name: str = "ground: floor"

    def decide(self, drawing: Drawing) -> Decision:
        seen = self._sheet(drawing).box(drawing.inputs.camera) is not None
        return Decision(PassState.RUNS, self.ground.kind) if seen else BELOW

    def draw(self, drawing: Drawing) -> None:
        sheet, program = self._sheet(drawing), drawing.resources[self.program]

        uniform(program, "reach").value = sheet.reach

        def draw(flipped: bool) -> None:
            sheet.apply(program, drawing.inputs.camera, flipped=flipped)
            self._render(drawing.resources)

        draw_behind(drawing, self.layer, draw)

    def _render(self, resources: PlanResources) -> None:
        ground, program = self.ground, resources[self.program]
        uniform(program, "paint").value = ground.color[:3]
        uniform(program, "other").value = OTHER_CHECKS
        uniform(program, "check").value = ground.check if ground.kind == "checker" else 0.0
        uniform(program, "fade").value = (OPAQUE * ground.radius, ground.radius)
        resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _sheet(self, drawing: Drawing) -> Sheet:
        """About the middle of the avatars; checks stay where they are in the world."""
        radius, checks = self.ground.radius, 2 * self.ground.check
        middle = np.mean([root for _, root in drawing.inputs.poses], axis=0)
        if self.ground.kind == "checker":
            middle = np.floor(middle / checks) * checks
        return Sheet(np.array([middle[0], self.ground.height, middle[2]]), (-radius, -radius, radius, radius))
