"""Avatars in the paper's colors: color depends on the surface point alone (the global direction of Eq. 14)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import moderngl

from player.draw.plan import Decision, Draft, Pass, PassState, Stage
from player.draw.posed_mesh import posed_mesh
from player.draw.resources import Handle, PlanResources
from player.effects.light import light_on
from player.effects.shaded import AvatarPass, shading_of
from player.effects.view import view_pass
from player.gl.texture import image_texture, mipmapped_bytes, read_finer_mip


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


def paper_pass(draft: Draft, avatar: int, base_color: Handle[moderngl.Texture], view: Pass) -> AvatarPass:
    """The pass in the paper's colors, where the pass `view` does not show."""
    mesh = posed_mesh(draft, avatar, directions=light_on(draft, avatar) is not None)
    shading = shading_of(draft, avatar, mesh, samplers=("base_color",), VIEW_STAGE=0)
    what = f"{draft.avatars[avatar].name}, {len(draft.levels[avatar].faces)} triangles"
    running = Decision(PassState.RUNS, what + draft.dual * ", dual quaternions" + shading.note)
    uses = (*draft.drawn_on, *mesh.handles, base_color, *shading.handles)
    instead = view if isinstance(view, AvatarPass) else None
    return AvatarPass(f"{draft.tag(avatar)}: paper", uses, draft.layer, mesh, shading, (base_color,), running, instead)


def base_color_of(draft: Draft, avatar: int) -> Handle[moderngl.Texture]:
    """The texture of an avatar's base color at its level of detail."""
    image, first = draft.levels[avatar].base_color, draft.first(avatar)

    def make(made: PlanResources) -> moderngl.Texture:
        texture = image_texture(made.context, image)
        if made.context.software:
            read_finer_mip(made.context, texture)
        return texture

    size, number = mipmapped_bytes(image.shape), draft.detail[avatar]
    return draft.texture(f"{draft.tag(first)} base color", size, first, number, make=make)
