"""What a scene asks for, as passes and the resources they read: decided from data alone, before any GL object.

Nothing that no pass reads is in the plan, and the renderer makes exactly what the plan holds: no program, buffer
or texture for an effect that is not asked for. A pass that is asked for but cannot show in a frame (an avatar out
of view, view dependence of one forty pixels tall) is skipped for that frame and keeps its resources.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from avatar.baked_avatar import Avatar
from player.blocks import BONES, FRAME, TURNS
from player.effects import VIEWS

STAGE = {"off": 0, "vertex": 1, "linear": 2, "network": 2}
MIN_HEIGHT = 40  # pixels; view dependence of a smaller avatar cannot be seen


@dataclass(frozen=True)
class Variant:
    """A program: two files, defines, and the avatar whose constants it holds (None: shared by all)."""

    vertex: str
    fragment: str
    defines: tuple[tuple[str, int], ...]
    avatar: int | None = None


@dataclass(frozen=True)
class Resource:
    """A GL object the plan owns."""

    name: str
    kind: str  # buffer, texture, framebuffer, renderbuffer
    bytes: int


@dataclass(frozen=True)
class Pass:
    """One draw of one avatar, or a word on why it is not in the plan (variant None)."""

    name: str
    why: str
    avatar: int
    variant: Variant | None
    reads: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """Passes in drawing order with the resources and programs they need."""

    passes: tuple[Pass, ...]
    resources: dict[str, Resource]
    variants: tuple[Variant, ...]

    def objects(self) -> dict[str, int]:
        """Live GL objects by kind, when exactly this plan is realised: tests hold the counts against it."""
        count = Counter(resource.kind for resource in self.resources.values())
        count["program"] = len(self.variants)
        count["vertex_array"] = sum(item.variant is not None for item in self.passes)
        return dict(count)

    def bytes(self, item: Pass) -> int:
        """Memory of what a pass reads, bytes."""
        return sum(self.resources[name].bytes for name in item.reads)


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


def resolve(
    avatars: Sequence[Avatar], size: tuple[int, int] | None, view: str, software: bool, level: int = 0
) -> Plan:
    """The plan for drawing `avatars` on an image of `size` pixels (None: into a window). Makes nothing."""
    resources: dict[str, Resource] = {}
    variants: list[Variant] = []
    passes: list[Pass] = []

    def need(name: str, kind: str, count: int) -> str:
        resources[name] = Resource(name, kind, count)
        return name

    def program(stage: int, network: bool, avatar: int | None, features: int = 0) -> Variant:
        defines = (("VIEW_FEATURES", features), ("VIEW_MODEL", int(network))) if stage else ()
        defines = (*defines, ("VIEW_STAGE", stage))
        variant = Variant("avatar.vert", "avatar.frag", defines, avatar)
        if variant not in variants:
            variants.append(variant)
        return variant

    targets: tuple[str, ...] = ()
    if size is not None:
        need("image", "framebuffer", 0)
        pixels = 4 * size[0] * size[1]
        targets = (need("image color", "renderbuffer", pixels), need("image depth", "renderbuffer", pixels))
    frame = need("frame", "buffer", FRAME.itemsize)
    for index, avatar in enumerate(avatars):
        mesh = avatar.levels[min(level, len(avatar.levels) - 1)]
        tag = f"avatar {index}" if len(avatars) > 1 else "avatar"
        mode, why = resolved_view(avatar, view, software)
        if mode != "off" and mesh.features is None:
            mode, why = "off", f"level {level} holds no features"
        vertices = len(mesh.positions)
        base = (
            *targets,
            frame,
            need(f"{tag} vertices", "buffer", 28 * vertices),
            need(f"{tag} faces", "buffer", 12 * len(mesh.faces)),
            need(f"{tag} bones", "buffer", BONES.itemsize),
            need(f"{tag} base color", "texture", _mipmapped(mesh.base_color.shape)),
        )
        passes.append(Pass(f"{tag}: paper", f"{avatar.name}, {len(mesh.faces)} triangles", index,
                           program(0, False, None), base))  # fmt: skip
        if mode == "off" or mesh.features is None:
            reason = "not asked for" if why == "asked for" else why
            passes.append(Pass(f"{tag}: view", reason, index, None))
            continue
        network = mode == "network" or (mode == "vertex" and avatar.network is not None)
        if mode == "vertex" and view == "auto":
            network = avatar.default_view == "network"
        extra = (
            need(f"{tag} view vertices", "buffer", 40 * vertices),
            need(f"{tag} turns", "buffer", TURNS.itemsize),
            need(f"{tag} features", "texture", _mipmapped(mesh.features.shape)),
        )
        if mesh.features.shape[2] == 8:
            extra += (need(f"{tag} more features", "texture", _mipmapped(mesh.features.shape)),)
        passes.append(
            Pass(f"{tag}: view {mode}", why, index, program(STAGE[mode], network, index, mesh.features.shape[2]), (*base, *extra))
        )
    return Plan(tuple(passes), resources, tuple(variants))


def mip_levels(shape: tuple[int, ...]) -> int:
    """Mipmaps worth having, the texture itself included: coarser ones would mix neighbouring charts.

    The bake leaves gutters of a 256th of the atlas (8 texels at 2048), which stay clean for log2(gutter) levels.
    """
    return min(max(2, max(shape[:2]) // 256).bit_length(), max(shape[:2]).bit_length())


def _mipmapped(shape: tuple[int, ...]) -> int:
    height, width = shape[:2]
    return sum(4 * max(height >> i, 1) * max(width >> i, 1) for i in range(mip_levels(shape)))
