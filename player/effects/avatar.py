"""Avatars in the paper's colors, where color depends on the surface point alone (the global direction of Eq. 14), or
with view dependence: the network or the linear model of the file changes them with the direction of view, per vertex or
per pixel."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import moderngl

from avatar.baked_avatar import Avatar
from player.draw.face import FacePass, face_of
from player.draw.mesh import VIEW_VERTEX, view_interleaved
from player.draw.plan import Absent, Decision, Draft, Pass, PassState, Stage
from player.draw.posed_mesh import posed_mesh
from player.draw.resources import Handle, PlanResources
from player.effects.light import light_on
from player.effects.shaded import MIN_HEIGHT, AvatarPass, shading_of
from player.gl.constants import avatar_constants
from player.gl.texture import image_texture, mipmapped_bytes, read_finer_mip

VIEWS = ("off", "vertex", "linear", "network")
STAGE = {"off": 0, "vertex": 1, "linear": 2, "network": 2}
ATTRIBUTES = ("3f4 3f4 3f4 1f4", "view_mean", "view_q0", "view_q1", "view_seen")
SAMPLERS = ("base_color", "features")


@dataclass(frozen=True)
class Avatars:
    """Every avatar of the scene, in paper mode or with view dependence."""

    view: str = "auto"
    stage: ClassVar[Stage] = Stage.AVATARS

    def passes(self, draft: Draft) -> Sequence[Pass]:
        """For each avatar the pass in paper colors, and the one with view dependence or why there is none."""
        if draft.canvas.own_image and draft.layer.image is None:
            draft.own_image(depth=True)
        passes: list[Pass] = []
        for index in range(len(draft.avatars)):
            base_color = base_color_of(draft, index)
            view = view_pass(draft, index, self.view, base_color)
            face = face_of(draft, index, draft.detail[index])
            passes += [] if face is None else [FacePass(f"{draft.tag(index)}: face", face.handles, face)]
            passes += [paper_pass(draft, index, base_color, view), view]
        return passes


def paper_pass(draft: Draft, avatar: int, base_color: Handle[moderngl.Texture], view: Pass) -> AvatarPass:
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


def view_pass(draft: Draft, avatar: int, view: str, base_color: Handle[moderngl.Texture]) -> AvatarPass | Absent:
    """The pass of the mode that `view` means for an avatar.

    Raises:
        ValueError: as `resolved_view`.
    """
    who, mesh, tag, first = draft.avatars[avatar], draft.levels[avatar], draft.tag(avatar), draft.first(avatar)
    mode, why = resolved_view(who, view, draft.canvas.software)
    if mode == "off":
        return Absent(f"{tag}: view", "not asked for" if why == "asked for" else why)
    if mesh.features is None:
        return Absent(f"{tag}: view", f"level {draft.detail[avatar]} holds no features")
    network = mode == "network" or (mode == "vertex" and who.network is not None)
    if mode == "vertex" and view == "auto":
        network = who.default_view == "network"
    posed = posed_mesh(draft, avatar, directions=True)
    vertices = draft.vertices("view vertices", avatar, VIEW_VERTEX.itemsize, lambda: view_interleaved(mesh))
    shading = shading_of(
        draft, avatar, posed, (vertices, *ATTRIBUTES), samplers=SAMPLERS, avatar=first,
        constants=lambda: avatar_constants(who), VIEW_STAGE=STAGE[mode], VIEW_MODEL=int(network),
    )  # fmt: skip
    features, number = mesh.features, draft.detail[avatar]
    make = lambda made: image_texture(made.context, features, coarse=True)
    size = mipmapped_bytes(features.shape)
    textures = base_color, draft.texture(f"{draft.tag(first)} features", size, first, number, make=make)
    uses = (*draft.drawn_on, *posed.handles, vertices, *textures, *shading.handles)
    running = Decision(PassState.RUNS, why + shading.note)
    draft.views[avatar] = mode
    return AvatarPass(
        f"{tag}: view {mode}", uses, draft.layer, posed, shading, textures, running, min_height=MIN_HEIGHT
    )


def resolved_view(avatar: Avatar, view: str, software: bool) -> tuple[str, str]:
    """The view mode that `view` means for an avatar on this device, and why.

    Raises:
        ValueError: the mode is unknown, or the avatar's file does not hold what it needs.
    """
    if view == "auto":
        if avatar.default_view == "off":
            return "off", "the avatar ships without view dependence"
        if software:
            return "vertex", f"software rasteriser: {avatar.default_view} evaluated per vertex"
        return avatar.default_view, "the avatar's own default"
    if view not in VIEWS:
        raise ValueError(f"view should be auto or one of {', '.join(VIEWS)}, is {view!r}")
    if view not in views_of(avatar):
        raise ValueError(f"view {view} is not in avatar {avatar.name}; it has {', '.join(views_of(avatar))}")
    return view, "asked for"


def views_of(avatar: Avatar) -> list[str]:
    """View modes the file holds, dearest first: network, linear, vertex, off."""
    models = {"network": avatar.network, "linear": avatar.linear}
    held = [view for view, model in models.items() if model is not None]
    return [*held, *(["vertex"] if held else []), "off"]
