"""A line of one color round each avatar and where its limbs pass before it: its hull turned inside out, a little larger
(shaders/outline.vert). Drawn among the avatars, so that antialiasing smooths it with them."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Annotated, Any, ClassVar, NamedTuple

import moderngl
import numpy as np

from command.settings import Above, AtMost, Color, check
from player.draw.drawing import Drawing, Layer, Warming
from player.draw.plan import Decision, Draft, Pass, PassState, Stage
from player.draw.posed_mesh import PosedMesh, normals_of, posed_mesh
from player.draw.resources import Handle, PlanResources
from player.effects.secondary_motion import LooseOffsets, offsets_of
from player.gl.shader import uniform

OUT_OF_VIEW = Decision(PassState.SKIPPED, "no avatar in view")


@dataclass(frozen=True)
class Outline:
    """How the line looks.

    Raises:
        ValueError: a width that is no width, or a color that is not opaque.
    """

    stage: ClassVar[Stage] = Stage.AVATARS

    color: Annotated[tuple[float, float, float, float], Color(), "of the line, opaque"] = (0.0, 0.0, 0.0, 1.0)
    width: Annotated[float, Above(0), AtMost(64), "of the line, pixels"] = 2.0

    def __post_init__(self):
        check(self)
        if self.color[3] < 1:
            raise ValueError("color: an outline is opaque: expected #rrggbb")

    def passes(self, draft: Draft) -> Sequence[Pass]:
        draft.widen(ceil(self.width))
        hulls, uses = [], [*draft.drawn_on]
        for index in range(len(draft.levels)):
            mesh, normals = posed_mesh(draft, index), normals_of(draft, index)
            loose = offsets_of(draft, index)
            moves = int(loose is not None)
            program = draft.program("outline.vert", "plain.frag", SKINNING=int(draft.dual), LOOSE=moves)
            array = mesh.array(draft, program, (normals, "3f4", "normal"), *(() if loose is None else (loose.buffer,)))
            hulls.append(OutlineHull(mesh, array, program, loose))
            uses += [*mesh.handles, normals, array, program, *(() if loose is None else loose.handles)]
        running = Decision(PassState.RUNS, f"{self.width:g} pixels")
        return (OutlinePass(tuple(uses), self, tuple(hulls), draft.layer, running),)


class OutlineHull(NamedTuple):
    """One avatar's."""

    mesh: PosedMesh
    array: Handle[moderngl.VertexArray]
    program: Handle[moderngl.Program]
    loose: LooseOffsets | None


@dataclass(frozen=True)
class OutlinePass(Pass):
    uses: tuple[Handle[Any], ...]
    outline: Outline
    hulls: tuple[OutlineHull, ...]
    layer: Layer
    running: Decision
    name: str = "outline"

    def decide(self, drawing: Drawing) -> Decision:
        return self.running if any(drawing.visible) else OUT_OF_VIEW

    def draw(self, drawing: Drawing) -> None:
        drawing.enter(self.layer)
        self._color(drawing.resources, drawing.inputs.camera.size)
        drawing.gl.cull_face = "front"
        for hull in self.hulls:
            if drawing.visible[hull.mesh.avatar]:
                hull.mesh.pose(drawing)
                if hull.loose is not None:
                    hull.loose.bind(drawing)
                drawing.resources[hull.array].render()
        drawing.gl.cull_face = "back"

    def warm(self, warming: Warming) -> None:
        if warming.enter(self.layer):
            self._color(warming.resources, (1, 1))
            for hull in self.hulls:
                hull.mesh.warm(warming.resources)
                if hull.loose is not None:
                    hull.loose.warm(warming.resources)
                warming.resources[hull.array].render(vertices=3)

    def _color(self, resources: PlanResources, size: tuple[int, int]) -> None:
        for handle in {hull.program for hull in self.hulls}:
            program = resources[handle]
            uniform(program, "width").value = tuple(2 * self.outline.width / np.array(size))
            uniform(program, "plain").value = self.outline.color[:3]
