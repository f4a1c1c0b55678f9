"""Avatars in the paper's colors: color depends on the surface point alone (the global direction of Eq. 14)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import moderngl

from player.draw.drawing import Drawing, Layer, Warming
from player.draw.plan import Decision, Draft, Pass, PassState, Stage
from player.draw.posed_mesh import PosedMesh, posed_mesh
from player.draw.resources import Handle, PlanResources
from player.effects.light import light_on
from player.effects.shaded import AvatarShading, shading_of
from player.effects.view import OUT_OF_VIEW, ViewPass, view_pass
from player.gl.texture import image_texture, mipmapped_bytes, read_finer_mip

VIEW_DRAWS_IT = Decision(PassState.SKIPPED, "the view pass draws this avatar")


@dataclass(frozen=True)
class Avatars:
    """Every avatar of the scene, in paper mode or with view dependence."""

    view: str = "auto"
    stage: ClassVar[Stage] = Stage.AVATARS

    def passes(self, draft: Draft) -> Sequence[Pass]:
        if draft.canvas.own_image and draft.layer.image is None:
            draft.own_image(depth=True)
        passes: list[Pass] = []
        for index in range(len(draft.avatars)):
            base_color = base_color_of(draft, index)
            view = view_pass(draft, index, self.view, base_color)
            passes += [paper_pass(draft, index, base_color, view), view]
        return passes


@dataclass(frozen=True)
class PaperPass(Pass):
    """One avatar in the colors of its texture."""

    name: str
    uses: tuple[Handle[Any], ...]
    mesh: PosedMesh
    layer: Layer
    shading: AvatarShading
    base_color: Handle[moderngl.Texture]
    # draws the avatar instead, where it can show
    view: ViewPass | None
    running: Decision

    def decide(self, drawing: Drawing) -> Decision:
        if not drawing.visible[self.mesh.avatar]:
            return OUT_OF_VIEW
        if self.view is not None and self.view.decide(drawing).runs:
            return VIEW_DRAWS_IT
        return self.running

    def draw(self, drawing: Drawing) -> None:
        drawing.enter(self.layer)
        self.mesh.pose(drawing)
        drawing.resources[self.base_color].use(0)
        variant = self.shading.variant(drawing)
        variant.apply(drawing)
        drawing.resources[variant.array].render()

    def warm(self, warming: Warming) -> None:
        if warming.enter(self.layer):
            self.mesh.warm(warming.resources)
            warming.resources[self.base_color].use(0)
            self.shading.warm(warming.resources)


def paper_pass(draft: Draft, avatar: int, base_color: Handle[moderngl.Texture], view: Pass) -> PaperPass:
    mesh = posed_mesh(draft, avatar, directions=light_on(draft, avatar) is not None)
    shading = shading_of(draft, avatar, mesh, samplers=("base_color",), VIEW_STAGE=0)
    what = f"{draft.avatars[avatar].name}, {len(draft.levels[avatar].faces)} triangles"
    return PaperPass(
        f"{draft.tag(avatar)}: paper", (*draft.drawn_on, *mesh.handles, base_color, *shading.handles),
        mesh, draft.layer, shading, base_color, view if isinstance(view, ViewPass) else None,
        Decision(PassState.RUNS, what + draft.dual * ", dual quaternions" + shading.note),
    )  # fmt: skip


def base_color_of(draft: Draft, avatar: int) -> Handle[moderngl.Texture]:
    image, first = draft.levels[avatar].base_color, draft.first(avatar)

    def make(made: PlanResources) -> moderngl.Texture:
        texture = image_texture(made.context, image)
        if made.context.software:
            read_finer_mip(made.context, texture)
        return texture

    size, number = mipmapped_bytes(image.shape), draft.detail[avatar]
    return draft.texture(f"{draft.tag(first)} base color", size, first, number, make=make)
