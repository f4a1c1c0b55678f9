"""Avatars in the paper's colors, where color depends on the surface point alone (the global direction of Eq. 14), or
with view dependence: the network or the linear model of the file changes them with the direction of view, per vertex or
per pixel.

Its program is varied by what a scene calls for: other light, contact darkening, loose parts. What cannot show in a
frame leaves it with the program that never heard of it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import moderngl

from avatar.baked_avatar import Avatar
from player.draw.drawing import Drawing, Layer, Warming
from player.draw.face import FacePass, face_of
from player.draw.mesh import VIEW_VERTEX, view_interleaved
from player.draw.plan import OUT_OF_VIEW, Absent, Attributes, Decision, Draft, Pass, PassState, Stage
from player.draw.posed_mesh import DrawnMesh, drawn_mesh, posed_mesh
from player.draw.resources import AnyHandle, Handle, PlanResources
from player.effects.contact import contact_of
from player.effects.light import light_of
from player.effects.secondary_motion import offsets_of
from player.gl.constants import avatar_constants
from player.gl.texture import image_texture, mipmapped_bytes, read_finer_mip

VIEWS = ("off", "vertex", "linear", "network")
STAGE = {"off": 0, "vertex": 1, "linear": 2, "network": 2}
ATTRIBUTES = ("3f4 3f4 3f4 1f4", "view_mean", "view_q0", "view_q1", "view_seen")
SAMPLERS = ("base_color", "features")
MIN_HEIGHT = 40  # pixels; view dependence of a smaller avatar cannot be seen
TOO_SMALL = Decision(PassState.SKIPPED, f"the avatar is less than {MIN_HEIGHT} pixels tall")
VIEW_DRAWS_IT = Decision(PassState.SKIPPED, "the view pass draws this avatar")


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


@dataclass(frozen=True)
class AvatarPass(Pass):
    """One avatar, in the colors of its texture or with view dependence."""

    layer: Layer
    # from all that is asked for to none of it
    variants: tuple[DrawnMesh, ...]
    # by unit: base color, features, more features
    textures: tuple[Handle[moderngl.Texture], ...]
    running: Decision
    # the pass that draws the avatar instead, where it can show; None: it is that pass, or there is none
    instead: "AvatarPass | None" = None
    min_height: int = 0  # pixels

    def decide(self, drawing: Drawing) -> Decision:
        avatar = self.variants[0].mesh.avatar
        if not drawing.visible[avatar]:
            return OUT_OF_VIEW
        if self.instead is not None and self.instead.decide(drawing).runs:
            return VIEW_DRAWS_IT
        return self.running if drawing.height(avatar) >= self.min_height else TOO_SMALL

    def draw(self, drawing: Drawing) -> None:
        drawing.enter(self.layer)
        self._bind(drawing.resources)
        next(variant for variant in self.variants if variant.shows(drawing)).draw(drawing)

    def warm(self, warming: Warming) -> None:
        if warming.enter(self.layer):
            self._bind(warming.resources)
            for variant in self.variants:
                variant.warm(warming.resources)

    def _bind(self, resources: PlanResources) -> None:
        for unit, texture in enumerate(self.textures):
            resources[texture].use(unit)


class Variants(NamedTuple):
    """One avatar as a scene calls for it."""

    # from all that is asked for to none of it, darkened where contact can be seen and moved where loose parts are
    meshes: tuple[DrawnMesh, ...]
    # all that they read and write, each object once
    uses: tuple[AnyHandle, ...]
    # for people: the end of a pass's reason
    note: str


def variants_of(draft: Draft, who: int, view_stage: int, *more: Attributes, **program: Any) -> Variants:
    """view_stage: VIEW_STAGE of avatar.vert; more: further attributes of the vertices; program: as `Draft.program`."""
    (light, note), contact, loose = light_of(draft, who), contact_of(draft, who), offsets_of(draft, who)
    mesh = posed_mesh(draft, who, directions=light is not None or view_stage > 0)
    lit, face = 0 if light is None else light.variant, int(mesh.face is not None)
    meshes = []
    for touch in dict.fromkeys((contact, None)):
        for moved in dict.fromkeys((loose, None)):
            made = draft.program(
                "avatar.vert", "avatar.frag", SKINNING=int(draft.dual), LIT=lit, CONTACT=int(touch is not None),
                LOOSE=int(moved is not None), FACE=face, VIEW_STAGE=view_stage, **program,
            )  # fmt: skip
            meshes.append(drawn_mesh(draft, mesh, made, [light, touch, moved], *more))
    uses = tuple(dict.fromkeys((*draft.drawn_on, *(handle for one in meshes for handle in one.handles))))
    return Variants(tuple(meshes), uses, note + ("" if contact is None else ", darkened where limbs come near"))


def paper_pass(draft: Draft, avatar: int, base_color: Handle[moderngl.Texture], view: Pass) -> AvatarPass:
    variants, uses, note = variants_of(draft, avatar, 0, samplers=("base_color",))
    what = f"{draft.avatars[avatar].name}, {len(draft.levels[avatar].faces)} triangles"
    running = Decision(PassState.RUNS, what + draft.dual * ", dual quaternions" + note)
    uses, instead = (*uses, base_color), view if isinstance(view, AvatarPass) else None
    return AvatarPass(f"{draft.tag(avatar)}: paper", uses, draft.layer, variants, (base_color,), running, instead)


def base_color_of(draft: Draft, avatar: int) -> Handle[moderngl.Texture]:
    """The texture of an avatar's base color at its level of detail."""
    image = draft.levels[avatar].base_color

    def make(made: PlanResources) -> moderngl.Texture:
        texture = image_texture(made.context, image)
        read_finer_mip(made.context, texture)
        return texture

    return atlas(draft, avatar, "base color", mipmapped_bytes(image.shape), make)


def atlas(
    draft: Draft, avatar: int, name: str, size: int, make: Callable[[PlanResources], moderngl.Texture]
) -> Handle[moderngl.Texture]:
    """A texture of an avatar at its level of detail, of `size` bytes; made once for avatars that are the same."""
    first = draft.first(avatar)
    return draft.texture(f"{draft.tag(first)} {name}", size, first, draft.detail[avatar], make=make)


def view_pass(draft: Draft, avatar: int, view: str, base_color: Handle[moderngl.Texture]) -> AvatarPass | Absent:
    """The pass of the mode that `view` means for an avatar.

    Raises:
        ValueError: as `resolved_view`.
    """
    who, mesh, tag = draft.avatars[avatar], draft.levels[avatar], draft.tag(avatar)
    mode, why = resolved_view(who, view, draft.canvas.software)
    if mode == "off":
        return Absent(f"{tag}: view", "not asked for" if why == "asked for" else why)
    if mesh.features is None:
        return Absent(f"{tag}: view", f"level {draft.detail[avatar]} holds no features")
    network = mode == "network" or (mode == "vertex" and who.network is not None)
    if mode == "vertex" and view == "auto":
        network = who.default_view == "network"
    vertices = draft.vertices("view vertices", avatar, VIEW_VERTEX.itemsize, lambda: view_interleaved(mesh))
    variants, uses, note = variants_of(
        draft, avatar, STAGE[mode], (vertices, *ATTRIBUTES), samplers=SAMPLERS, avatar=draft.first(avatar),
        constants=lambda: avatar_constants(who), VIEW_MODEL=int(network),
    )  # fmt: skip
    features = mesh.features
    make = lambda made: image_texture(made.context, features, coarse=True)
    textures = base_color, atlas(draft, avatar, "features", mipmapped_bytes(features.shape), make)
    uses, running = (*uses, *textures), Decision(PassState.RUNS, why + note)
    draft.views[avatar] = mode
    return AvatarPass(f"{tag}: view {mode}", uses, draft.layer, variants, textures, running, min_height=MIN_HEIGHT)


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
