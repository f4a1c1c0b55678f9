"""A grid on the ground and the world's axes, to see where things are and how large. Drawn behind the avatars."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import moderngl
import numpy as np

from avatar.camera import clip_from_view, view_from_world
from command.settings import Above, AtLeast, AtMost, Color, check
from player.draw.drawing import Drawing, Layer
from player.draw.plan import Decision, Draft, Pass, PassState, Stage
from player.draw.resources import Handle, PlanResources
from player.effects.ground_plane import FAR, NEAR, PassBehind, Sheet, draw_behind
from player.gl.shader import uniform

AWAY = Decision(PassState.SKIPPED, "the ground is out of view, or seen from below")
AXES_AWAY = Decision(PassState.SKIPPED, "the origin is out of view")
RUNS = Decision(PassState.RUNS, "asked for")
# pixels
LINE = 1.2
AXIS = 3.0
# share of the metres to the grid's edge
FULL = 0.3


@dataclass(frozen=True)
class Grid:
    """How the grid looks.

    Raises:
        ValueError: a value that is out of its range, or a color that is not opaque.
    """

    stage: ClassVar[Stage] = Stage.GROUND

    spacing: Annotated[float, AtLeast(1e-3), AtMost(1e3), "of its lines, metres; thinner ones divide it by five"] = 1.0
    height: Annotated[float, AtLeast(-1e4), AtMost(1e4), "above the world's origin, metres"] = 0.0
    radius: Annotated[float, Above(0), AtMost(1e4), "about the avatars, metres; it fades towards its edge"] = 8.0
    color: Annotated[tuple[float, float, float, float], Color(), "of the lines, opaque"] = (0.55, 0.57, 0.62, 1.0)
    axes: Annotated[
        float, AtLeast(0), AtMost(1e3), "length of the world's axes, metres: x red, y green, z blue; 0: none"
    ] = 1.0

    def __post_init__(self):
        check(self)
        if self.color[3] < 1:
            raise ValueError("color: lines are opaque: expected #rrggbb")

    def passes(self, draft: Draft) -> Sequence[Pass]:
        drawn_on = draft.behind_avatars
        program = draft.program("plane.vert", "grid.frag")
        array = draft.array(program)
        passes: list[Pass] = [GridPass((*drawn_on, array), self, draft.layer, program, array)]
        if self.axes > 0:
            program = draft.program("axes.vert", "axes.frag")
            array = draft.array(program)
            passes.append(AxesPass((*drawn_on, array), self, draft.layer, program, array))
        return passes


@dataclass(frozen=True)
class GridPass(PassBehind):
    uses: tuple[Handle[Any], ...]
    grid: Grid
    layer: Layer
    program: Handle[moderngl.Program]
    array: Handle[moderngl.VertexArray]
    name: str = "grid"

    def decide(self, drawing: Drawing) -> Decision:
        return RUNS if self._sheet(drawing).box(drawing.inputs.camera) is not None else AWAY

    def draw(self, drawing: Drawing) -> None:
        sheet, resources = self._sheet(drawing), drawing.resources
        program, grid = resources[self.program], self.grid
        # a whole number of lines from the world's origin, so that only small numbers are rounded
        origin = -np.fmod(sheet.anchor[[0, 2]], grid.spacing)
        uniform(program, "reach").value = sheet.reach
        uniform(program, "paint").value = grid.color[:3]
        uniform(program, "spacing").value = grid.spacing
        uniform(program, "width").value = LINE
        uniform(program, "origin").value = tuple(origin.tolist())
        uniform(program, "fade").value = (FULL * grid.radius, grid.radius)

        def draw(flipped: bool) -> None:
            sheet.apply(program, drawing.inputs.camera, flipped=flipped)
            self._render(resources)

        draw_behind(drawing, self.layer, draw)

    def _render(self, resources: PlanResources) -> None:
        resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _sheet(self, drawing: Drawing) -> Sheet:
        middle, radius = np.mean([root for _, root in drawing.inputs.poses], axis=0), self.grid.radius
        return Sheet(np.array([middle[0], self.grid.height, middle[2]]), (-radius, -radius, radius, radius))


@dataclass(frozen=True)
class AxesPass(PassBehind):
    uses: tuple[Handle[Any], ...]
    grid: Grid
    layer: Layer
    program: Handle[moderngl.Program]
    array: Handle[moderngl.VertexArray]
    name: str = "grid: axes"

    def decide(self, drawing: Drawing) -> Decision:
        camera, ends = drawing.inputs.camera, self.grid.axes * np.eye(4, 3, -1) + [0, self.grid.height, 0]
        seen = ends @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
        if (seen[:, 2] <= 0).all():
            return AXES_AWAY
        if (seen[:, 2] <= 0).any():
            return RUNS
        at = (seen @ camera.K.T)[:, :2] / seen[:, 2:]
        apart = (at.max(0) < -AXIS).any() or (at.min(0) > np.array(camera.size) + AXIS).any()
        return AXES_AWAY if apart else RUNS

    def draw(self, drawing: Drawing) -> None:
        camera, resources = drawing.inputs.camera, drawing.resources
        program = resources[self.program]
        clip = clip_from_view(camera, NEAR, FAR) @ view_from_world(camera)
        axes = np.eye(4)
        axes[:3, :3] *= self.grid.axes
        axes[1, 3] = self.grid.height
        columns = (clip @ axes).T
        uniform(program, "half_pixel").value = tuple(AXIS / np.array(camera.size))

        def draw(flipped: bool) -> None:
            turned = columns * (1, -1, 1, 1) if flipped else columns
            uniform(program, "clip_from_axes").write(np.ascontiguousarray(turned, np.float32).tobytes())
            self._render(resources)

        draw_behind(drawing, self.layer, draw)

    def _render(self, resources: PlanResources) -> None:
        resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=3)
