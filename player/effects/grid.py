"""A grid on the ground and the world's axes, to see where things are and how large. Drawn behind the avatars."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import moderngl
import numpy as np

from avatar.camera import clip_from_view, view_from_world
from command.settings import RGBA, Above, AtLeast, AtMost, Color, settings
from player.draw.drawing import Drawing
from player.draw.plan import Decision, Draft, Pass, PassState, Stage
from player.draw.resources import PlanResources
from player.effects.ground_plane import FAR, NEAR, PassBehind, Sheet, SquarePass, behind_parts, draw_behind
from player.gl.shader import Uniforms, set_uniforms

AXES_AWAY = Decision(PassState.SKIPPED, "the origin is out of view")
RUNS = Decision(PassState.RUNS, "asked for")
LINE, AXIS = 1.2, 3.0  # pixels
FULL = 0.3  # share of the metres to the grid's edge


@settings
class Grid:
    """How the grid looks."""

    stage: ClassVar[Stage] = Stage.GROUND

    spacing: Annotated[float, AtLeast(1e-3), AtMost(1e3), "of its lines, metres; thinner ones divide it by five"] = 1.0
    height: Annotated[float, AtLeast(-1e4), AtMost(1e4), "above the world's origin, metres"] = 0.0
    radius: Annotated[float, Above(0), AtMost(1e4), "about the avatars, metres; it fades towards its edge"] = 8.0
    color: Annotated[RGBA, Color(opaque=True), "of the lines, opaque"] = (0.55, 0.57, 0.62, 1.0)
    axes: Annotated[float, AtLeast(0), AtMost(1e3),
        "length of the world's axes, metres: x red, y green, z blue; 0: none"] = 1.0

    def passes(self, draft: Draft) -> Sequence[Pass]:
        """The lines, and the axes where they have a length."""
        passes: list[Pass] = [
            SquarePass(
                "grid", *behind_parts(draft, "plane.vert", "grid.frag"), self.height, self.radius, FULL, 0.0,
                self._paint, RUNS,
            )
        ]  # fmt: skip
        if self.axes > 0:
            passes.append(AxesPass("grid: axes", *behind_parts(draft, "axes.vert", "axes.frag"), self))
        return passes

    def _paint(self, sheet: Sheet) -> Uniforms:
        # a whole number of lines from the world's origin, so that only small numbers are rounded
        origin = -np.fmod(sheet.anchor[[0, 2]], self.spacing)
        return {"paint": self.color[:3], "spacing": self.spacing, "width": LINE, "origin": tuple(origin.tolist())}


@dataclass(frozen=True)
class AxesPass(PassBehind):
    """The world's axes, as bars of a few pixels."""

    grid: Grid

    def decide(self, drawing: Drawing) -> Decision:
        """Whether any of the three bars can be in the picture."""
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
        """The bars, a few pixels wide wherever they are."""
        camera, resources = drawing.inputs.camera, drawing.resources
        program = resources[self.program]
        clip = clip_from_view(camera, NEAR, FAR) @ view_from_world(camera)
        axes = np.eye(4)
        axes[:3, :3] *= self.grid.axes
        axes[1, 3] = self.grid.height
        columns = (clip @ axes).T
        set_uniforms(program, half_pixel=tuple(AXIS / np.array(camera.size)))

        def draw(flipped: bool) -> None:
            set_uniforms(program, clip_from_axes=columns * (1, -1, 1, 1) if flipped else columns)
            self.render(resources)

        draw_behind(drawing, self.layer, draw)

    def render(self, resources: PlanResources) -> None:
        resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=3)
