"""A line of one color round each avatar and where its limbs pass before it: its hull turned inside out, a little larger
(shaders/outline.vert). Drawn among the avatars, so that antialiasing smooths it with them."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Annotated, ClassVar

import numpy as np

from command.settings import RGBA, Above, AtMost, Color, settings
from player.draw.drawing import Drawing, Layer, Warming
from player.draw.plan import MARGIN, NONE_IN_VIEW, Decision, Draft, Pass, PassState, Stage
from player.draw.posed_mesh import DrawnMesh, normals_of
from player.draw.resources import PlanResources
from player.effects.secondary_motion import loose_mesh
from player.gl.shader import set_uniforms


@settings
class Outline:
    """How the line looks."""

    stage: ClassVar[Stage] = Stage.AVATARS

    color: Annotated[RGBA, Color(opaque=True), "of the line, opaque"] = (0.0, 0.0, 0.0, 1.0)
    width: Annotated[float, Above(0), AtMost(64), "of the line, pixels"] = 2.0

    def passes(self, draft: Draft) -> Sequence[Pass]:
        """One pass for all avatars, which share its color and width."""
        draft.margin = max(draft.margin, MARGIN + ceil(self.width))
        hulls = tuple(
            loose_mesh(draft, index, "outline.vert", "plain.frag", normals_of(draft, index))
            for index in range(len(draft.levels))
        )
        uses = (*draft.drawn_on, *(handle for hull in hulls for handle in hull.handles))
        running = Decision(PassState.RUNS, f"{self.width:g} pixels")
        return (OutlinePass("outline", uses, self, hulls, draft.layer, running),)


@dataclass(frozen=True)
class OutlinePass(Pass):
    outline: Outline
    hulls: tuple[DrawnMesh, ...]
    layer: Layer
    running: Decision

    def decide(self, drawing: Drawing) -> Decision:
        return self.running if any(drawing.visible) else NONE_IN_VIEW

    def draw(self, drawing: Drawing) -> None:
        drawing.enter(self.layer)
        self._color(drawing.resources, drawing.inputs.camera.size)
        drawing.gl.cull_face = "front"
        for hull in self.hulls:
            if drawing.visible[hull.mesh.avatar]:
                hull.draw(drawing)
        drawing.gl.cull_face = "back"

    def warm(self, warming: Warming) -> None:
        if warming.enter(self.layer):
            self._color(warming.resources, (1, 1))
            for hull in self.hulls:
                hull.warm(warming.resources)

    def _color(self, resources: PlanResources, size: tuple[int, int]) -> None:
        for program in {resources[hull.array].program for hull in self.hulls}:
            width = tuple(2 * self.outline.width / np.array(size))
            set_uniforms(program, width=width, plain=self.outline.color[:3])
