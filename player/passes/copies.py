"""Copies of one avatar, drawn at once: one palette of bones a frame, one draw for those with view dependence, and one
for the rest."""

from dataclasses import dataclass
from typing import Any

import moderngl

from player.copies import SECTIONS, TURNS_SECTION, palette
from player.drawing import Drawing, Layer, Warming
from player.passes.shaded import Variant, shaded
from player.passes.view import MIN_HEIGHT, OUT_OF_VIEW, SAMPLERS, ViewLook, view_look
from player.plan import Absent, Decision, Draft, State
from player.posed_mesh import posed_mesh
from player.resources import Handle, PlanResources
from player.shader import uniform

UNIT = len(SAMPLERS)


@dataclass(frozen=True)
class CopiesPass:
    """All copies of one avatar, in its paper's colors or with view dependence as each can show it."""

    name: str
    uses: tuple[Handle[Any], ...]
    # their numbers in the scene
    avatars: tuple[int, ...]
    palette: Handle[moderngl.Texture]
    layer: Layer
    paper: Variant
    base_color: Handle[moderngl.Texture]
    view: ViewLook | None
    dual: bool
    # whether rotations of the bones are read
    directions: bool
    running: Decision

    @property
    def mode(self) -> str:
        """The view mode."""
        return "off" if self.view is None else self.view.mode

    def decide(self, drawing: Drawing) -> Decision:
        return self.running if any(drawing.visible[avatar] for avatar in self.avatars) else OUT_OF_VIEW

    def draw(self, drawing: Drawing) -> None:
        drawing.enter(self.layer)
        resources = drawing.resources
        seen = [avatar for avatar in self.avatars if drawing.visible[avatar]]
        # those whose view dependence can be seen
        near = [avatar for avatar in seen if self.view is not None and drawing.height(avatar) >= MIN_HEIGHT]
        far = sorted(set(seen).difference(near))
        rows = palette([drawing.bones[avatar] for avatar in near + far], dual=self.dual, directions=self.directions)
        texture = resources[self.palette]
        texture.write(rows, viewport=(0, 0, rows.shape[1], len(rows)))
        texture.use(UNIT)
        resources[self.base_color].use(0)
        if near and self.view is not None:
            self.view.bind(resources)
            self._render(drawing, self.view.shading.plain, 0, len(near))
        if far:
            self._render(drawing, self.paper, len(near), len(far))

    def warm(self, warming: Warming) -> None:
        if warming.enter(self.layer):
            texture = warming.resources[self.palette]
            texture.write(bytes(16 * texture.width * texture.height))
            texture.use(UNIT)
            warming.resources[self.base_color].use(0)
            if self.view is not None:
                self.view.bind(warming.resources)
                self.view.shading.warm(warming.resources)
            warming.resources[self.paper.array].render(vertices=3)

    def _render(self, drawing: Drawing, variant: Variant, first: int, count: int) -> None:
        variant.apply(drawing)
        uniform(drawing.resources[variant.program], "first_copy").value = first
        drawing.resources[variant.array].render(instances=count)


def copies_pass(draft: Draft, avatars: tuple[int, ...], view: str, base_color: Handle[moderngl.Texture]) -> CopiesPass:
    """The pass of avatars that are copies of one.

    Raises:
        ValueError: as `view_look`.
    """
    first = avatars[0]
    mesh = posed_mesh(draft, first, posed=False)
    look = view_look(draft, first, view, base_color, copies=True)
    shading = shaded(draft, first, mesh, samplers=(*SAMPLERS, "palettes"), copies=True, VIEW_STAGE=0)
    directions = not isinstance(look, Absent) or draft.lights(first)
    columns = 52 * (SECTIONS if draft.dual or directions else TURNS_SECTION)
    name = f"avatars {', '.join(str(avatar + 1) for avatar in avatars)}"

    def make(made: PlanResources) -> moderngl.Texture:
        texture = made.context.gl.texture((columns, len(avatars)), 4, dtype="f4")
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return texture

    rows = draft.texture(f"{name} bones", 16 * columns * len(avatars), avatars, columns, make=make)
    uses = (*draft.drawn_on, *mesh.handles, rows, base_color, *shading.handles)
    what = f"{draft.avatars[first].name}, {len(draft.levels[first].faces)} triangles, {len(avatars)} copies"
    if isinstance(look, Absent):
        mode, seen = "paper", None
    else:
        mode, seen, uses = f"view {look.mode}", look, (*uses, *look.handles)
    return CopiesPass(
        f"{name}: {mode}", uses, avatars, rows, draft.layer, shading.plain, base_color, seen, draft.dual, directions,
        Decision(State.RUNS, what + draft.dual * ", dual quaternions" + shading.note),
    )  # fmt: skip
