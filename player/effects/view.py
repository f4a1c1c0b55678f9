"""View dependence: the avatar's network or linear model changes its colors with the direction of view, per vertex or
per pixel. Draws the avatar in place of its paper pass."""

from dataclasses import dataclass
from typing import Any

import moderngl

from avatar.baked_avatar import Avatar
from player.draw.drawing import Drawing, Layer, Warming
from player.draw.mesh import VIEW_VERTEX, view_interleaved
from player.draw.plan import Absent, Decision, Draft, Pass, PassState
from player.draw.posed_mesh import PosedMesh, posed_mesh, vertex_order
from player.draw.resources import Handle, PlanResources
from player.effects.shaded import AvatarShading, shading_of
from player.gl.constants import avatar_constants
from player.gl.texture import image_texture, mipmapped_bytes

VIEWS = ("off", "vertex", "linear", "network")
STAGE = {"off": 0, "vertex": 1, "linear": 2, "network": 2}
ATTRIBUTES = ("3f4 3f4 3f4 1f4", "view_mean", "view_q0", "view_q1", "view_seen")
SAMPLERS = ("base_color", "features", "more_features")
# pixels; view dependence of a smaller avatar cannot be seen
MIN_HEIGHT = 40
OUT_OF_VIEW = Decision(PassState.SKIPPED, "out of view")
TOO_SMALL = Decision(PassState.SKIPPED, f"the avatar is less than {MIN_HEIGHT} pixels tall")


@dataclass(frozen=True)
class ViewPass(Pass):
    """One avatar with view dependence."""

    name: str
    uses: tuple[Handle[Any], ...]
    layer: Layer
    mode: str
    mesh: PosedMesh
    shading: AvatarShading
    # by unit: base color, features, more features
    textures: tuple[Handle[moderngl.Texture], ...]
    running: Decision

    def decide(self, drawing: Drawing) -> Decision:
        if not drawing.visible[self.mesh.avatar]:
            return OUT_OF_VIEW
        return self.running if drawing.height(self.mesh.avatar) >= MIN_HEIGHT else TOO_SMALL

    def draw(self, drawing: Drawing) -> None:
        drawing.enter(self.layer)
        self.mesh.pose(drawing)
        self._bind(drawing.resources)
        variant = self.shading.variant(drawing)
        variant.apply(drawing)
        drawing.resources[variant.array].render()

    def warm(self, warming: Warming) -> None:
        if warming.enter(self.layer):
            self.mesh.warm(warming.resources)
            self._bind(warming.resources)
            self.shading.warm(warming.resources)

    def _bind(self, resources: PlanResources) -> None:
        for unit, texture in enumerate(self.textures):
            resources[texture].use(unit)


def view_pass(draft: Draft, avatar: int, view: str, base_color: Handle[moderngl.Texture]) -> ViewPass | Absent:
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
    vertices = draft.buffer(
        f"{draft.tag(first)} view vertices", VIEW_VERTEX.itemsize * len(mesh.positions), first, draft.detail[avatar],
        content=lambda made: view_interleaved(mesh)[vertex_order(made, mesh)[0]].tobytes(),
    )  # fmt: skip
    features = _feature_textures(draft, avatar)
    shading = shading_of(
        draft, avatar, posed, (vertices, *ATTRIBUTES), samplers=SAMPLERS, avatar=first,
        constants=lambda: avatar_constants(who), VIEW_STAGE=STAGE[mode], VIEW_MODEL=int(network),
        VIEW_FEATURES=mesh.features.shape[2],
    )  # fmt: skip
    textures = (base_color, *features)
    uses = (*draft.drawn_on, *posed.handles, vertices, *textures, *shading.handles)
    running = Decision(PassState.RUNS, why + shading.note)
    draft.views[avatar] = mode
    return ViewPass(f"{tag}: view {mode}", uses, draft.layer, mode, posed, shading, textures, running)


def _feature_textures(draft: Draft, avatar: int) -> list[Handle[moderngl.Texture]]:
    """Textures that hold a level's features, four in each."""
    features, first = draft.levels[avatar].features, draft.first(avatar)
    assert features is not None
    return [
        draft.texture(
            f"{draft.tag(first)} {name}", mipmapped_bytes(features.shape), first, draft.detail[avatar],
            make=lambda made, four=features[..., 4 * k : 4 * k + 4]: image_texture(made.context, four, coarse=True),
        )
        for k, name in enumerate(("features", "more features")[: features.shape[2] // 4])
    ]  # fmt: skip


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
    has = {"network": avatar.network is not None, "linear": avatar.linear is not None}
    if (view in has and not has[view]) or (view == "vertex" and not any(has.values())):
        held = [name for name, there in has.items() if there]
        raise ValueError(f"view {view} is not in avatar {avatar.name}; it has {', '.join(['off', *held])}")
    return view, "asked for"
