"""View dependence: the avatar's network or linear model changes its colors with the direction of view, per vertex or
per pixel. Draws the avatar in place of its paper pass."""

import moderngl

from avatar.baked_avatar import Avatar
from player.draw.mesh import VIEW_VERTEX, view_interleaved
from player.draw.plan import Absent, Decision, Draft, PassState
from player.draw.posed_mesh import posed_mesh
from player.draw.resources import Handle
from player.effects.shaded import MIN_HEIGHT, AvatarPass, shading_of
from player.gl.constants import avatar_constants
from player.gl.texture import image_texture, mipmapped_bytes

VIEWS = ("off", "vertex", "linear", "network")
STAGE = {"off": 0, "vertex": 1, "linear": 2, "network": 2}
ATTRIBUTES = ("3f4 3f4 3f4 1f4", "view_mean", "view_q0", "view_q1", "view_seen")
SAMPLERS = ("base_color", "features", "more_features")


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
        VIEW_FEATURES=mesh.features.shape[2],
    )  # fmt: skip
    textures = (base_color, *_feature_textures(draft, avatar))
    uses = (*draft.drawn_on, *posed.handles, vertices, *textures, *shading.handles)
    running = Decision(PassState.RUNS, why + shading.note)
    draft.views[avatar] = mode
    return AvatarPass(
        f"{tag}: view {mode}", uses, draft.layer, posed, shading, textures, running, min_height=MIN_HEIGHT
    )


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
