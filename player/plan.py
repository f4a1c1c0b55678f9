"""What a scene asks for, as passes and the resources they read: decided from data alone, before any GL object.

Nothing that no pass reads is in the plan, and the renderer makes exactly what the plan holds: no program, buffer
or texture for an effect that is not asked for. A pass that is asked for but cannot show in a frame (an avatar out
of view, view dependence of one forty pixels tall) is skipped for that frame and keeps its resources.

Order: background, avatars, antialiasing. Skipping a pass skips whatever only it needs, so a frame in which an
effect cannot show is, byte for byte and draw for draw, the frame of a scene that never asked for it.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from avatar.baked_avatar import Avatar, Level
from avatar.texture import mip_levels
from player.blocks import BONES, DUALS, FRAME, TURNS
from player.scenes.effects import VIEWS, Background, Effects

STAGE = {"off": 0, "vertex": 1, "linear": 2, "network": 2}
# pixels; view dependence of a smaller avatar cannot be seen
MIN_HEIGHT = 40
# of MSAA: asked for as a number, never as the device's maximum, so that machines agree
SAMPLES = 4
# pixels a side; FXAA runs on the tiles that an avatar can reach
TILE = 16


@dataclass(frozen=True)
class Variant:
    """A program: two files, defines, and the avatar whose constants it holds (None: shared by all)."""

    vertex: str
    fragment: str
    defines: tuple[tuple[str, int], ...] = ()
    avatar: int | None = None


@dataclass(frozen=True)
class Resource:
    """A GL object the plan owns. Two plans with an equal resource share it."""

    name: str
    kind: str  # buffer, texture, framebuffer, renderbuffer
    bytes: int
    # what else it depends on: pixels and samples, or the level of detail
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class Pass:
    """One step of a frame, or a word on why it is not in the plan (asked False)."""

    name: str
    # background | avatar | view | antialiasing
    kind: str
    why: str
    asked: bool = True
    avatar: int = -1
    variant: Variant | None = None  # None: nothing is drawn, pixels are copied
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
        return {kind: number for kind, number in count.items() if number}

    def bytes(self, item: Pass) -> int:
        """Memory of what a pass reads and writes, bytes."""
        return sum(self.resources[name].bytes for name in item.reads)


@dataclass(frozen=True)
class Canvas:
    """Where a plan is to run: facts of the device and of the image, none of them a GL object."""

    # pixels; None: a window that has not said yet
    size: tuple[int, int] | None
    # False: a window is drawn into
    own_image: bool = True
    software: bool = True
    max_samples: int = SAMPLES
    panorama: tuple[int, int] | None = None  # width and height of an HDR background's picture


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


class _Draft:
    """A plan being written."""

    def __init__(self):
        self.resources: dict[str, Resource] = {}
        self.variants: list[Variant] = []
        self.passes: list[Pass] = []

    def need(self, name: str, kind: str, count: int, *shape: int) -> str:
        self.resources[name] = Resource(name, kind, count, shape)
        return name

    def program(self, vertex: str, fragment: str, avatar: int | None = None, **defines: int) -> Variant:
        variant = Variant(vertex, fragment, tuple(defines.items()), avatar)
        if variant not in self.variants:
            self.variants.append(variant)
        return variant

    def image(self, name: str, size: tuple[int, int], *, depth: bool, kind: str = "renderbuffer", samples=0):
        """A framebuffer with its attachments; their names."""
        pixels = 4 * size[0] * size[1] * max(samples, 1)
        names = [
            self.need(name, "framebuffer", 0, *size, samples, int(depth)),
            self.need(f"{name} color", kind, pixels, *size, samples),
        ]
        if depth:
            names.append(self.need(f"{name} depth", kind, pixels, *size, samples))
        return tuple(names)


def resolve(
    avatars: Sequence[Avatar],
    canvas: Canvas,
    effects: Effects,
    background: Background = Background(),  # noqa: B008  frozen
    level: int = 0,
) -> Plan:
    """The plan for drawing `avatars` with these effects. Makes nothing.

    Raises:
        ValueError: a view mode that an avatar does not hold.
    """
    draft = _Draft()
    smoothing, refused = _smoothing(canvas, effects)
    size, targets = canvas.size, ()
    if size is not None and (canvas.own_image or smoothing == "msaa"):
        targets = draft.image("image", size, depth=smoothing == "none")
    _background(draft, canvas, background)
    frame = draft.need("frame", "buffer", FRAME.itemsize)
    drawn_on = targets
    if size is not None and smoothing == "msaa":
        drawn_on = draft.image("samples", size, depth=True, samples=SAMPLES)
    elif size is not None and smoothing == "fxaa":
        drawn_on = draft.image("layer", size, depth=True, kind="texture")
    for index, avatar in enumerate(avatars):
        tag = f"avatar {index}" if len(avatars) > 1 else "avatar"
        _avatar(draft, index, avatar, tag, (*drawn_on, frame), canvas.software, effects, level)
    if smoothing == "none":
        draft.passes.append(Pass("antialiasing", "antialiasing", refused or "not asked for", asked=False))
    elif size is not None:  # else a window: planned with its first frame
        _antialiasing(draft, size, smoothing, (*targets, *drawn_on))
    return Plan(tuple(draft.passes), draft.resources, tuple(draft.variants))


def _smoothing(canvas: Canvas, effects: Effects) -> tuple[str, str]:
    """The antialiasing that the device can do, and why it cannot where it was asked to. `auto` is MSAA on a GPU; on a
    software rasteriser, where MSAA costs more than twice as much, FXAA."""
    if effects.antialiasing == "auto":
        return "fxaa" if canvas.software or canvas.max_samples < SAMPLES else "msaa", ""
    if effects.antialiasing == "msaa" and canvas.max_samples < SAMPLES:
        return "none", f"the device has {canvas.max_samples} samples a pixel, {SAMPLES} are needed"
    return effects.antialiasing, ""


def _background(draft: _Draft, canvas: Canvas, background: Background) -> None:
    """Pixels of the background at the size of the image, copied in each frame: a copy costs 1.04 of a bare frame in
    software, a textured triangle 1.4 to 1.8."""
    kind = background.kind
    if kind in ("color", "transparent"):
        draft.passes.append(Pass("background", "background", "not asked for", asked=False))
        return
    if canvas.size is None:
        return  # a window: planned with its first frame
    pixels = draft.image("background", canvas.size, depth=False, kind="texture")
    if kind == "video":
        draft.passes.append(Pass("background: video", "background", "a new frame", reads=pixels))
    if kind == "hdr":
        assert canvas.panorama is not None
        width, height = canvas.panorama
        levels = max(width, height).bit_length()
        texels = sum(max(width >> i, 1) * max(height >> i, 1) for i in range(levels))
        panorama = draft.need("panorama", "texture", 8 * texels, width, height)
        variant = draft.program("screen.vert", "panorama.frag")
        draft.passes.append(Pass("background: hdr", "background", "the camera turned", variant=variant,
                                 reads=(*pixels, panorama)))  # fmt: skip
    draft.passes.append(Pass("background", "background", "asked for", reads=pixels))


def _avatar(
    draft: _Draft, index: int, avatar: Avatar, tag: str, base: tuple[str, ...], software: bool, effects: Effects,
    level: int,
) -> None:  # fmt: skip
    mesh = avatar.levels[min(level, len(avatar.levels) - 1)]
    mode, why = resolved_view(avatar, effects.view, software)
    if mode != "off" and mesh.features is None:
        mode, why = "off", f"level {level} holds no features"
    dual = effects.skinning == "dual_quaternion"
    vertices = len(mesh.positions)
    base = (
        *base,
        draft.need(f"{tag} vertices", "buffer", 28 * vertices, level),
        draft.need(f"{tag} faces", "buffer", 12 * len(mesh.faces), level),
        draft.need(f"{tag} base color", "texture", _mipmapped(mesh.base_color.shape), level),
        draft.need(f"{tag} duals", "buffer", DUALS.itemsize)
        if dual
        else draft.need(f"{tag} bones", "buffer", BONES.itemsize),
    )
    turns = (draft.need(f"{tag} turns", "buffer", TURNS.itemsize),) if dual or mode != "off" else ()
    paper = draft.program("avatar.vert", "avatar.frag", SKINNING=int(dual), VIEW_STAGE=0)
    what = f"{avatar.name}, {len(mesh.faces)} triangles" + dual * ", dual quaternions"
    draft.passes.append(Pass(f"{tag}: paper", "avatar", what, True, index, paper, base + turns * dual))
    if mode == "off" or mesh.features is None:
        reason = "not asked for" if why == "asked for" else why
        draft.passes.append(Pass(f"{tag}: view", "view", reason, False, index))
        return
    network = mode == "network" or (mode == "vertex" and avatar.network is not None)
    if mode == "vertex" and effects.view == "auto":
        network = avatar.default_view == "network"
    features = mesh.features.shape
    extra = (*turns, draft.need(f"{tag} view vertices", "buffer", 40 * vertices, level))
    for name in feature_textures(mesh):
        extra += (draft.need(f"{tag} {name}", "texture", _mipmapped(features), level),)
    variant = draft.program("avatar.vert", "avatar.frag", index, SKINNING=int(dual), VIEW_STAGE=STAGE[mode],
                            VIEW_MODEL=int(network), VIEW_FEATURES=features[2])  # fmt: skip
    draft.passes.append(Pass(f"{tag}: view {mode}", "view", why, True, index, variant, (*base, *extra)))


def _antialiasing(draft: _Draft, size: tuple[int, int], smoothing: str, images: tuple[str, ...]) -> None:
    if smoothing == "msaa":
        why = f"{SAMPLES} samples, resolved on the avatars' box"
        draft.passes.append(Pass("antialiasing: msaa", "antialiasing", why, reads=images))
        return
    tiles = 8 * -(-size[0] // TILE) * -(-size[1] // TILE)
    reads = (*images, draft.need("fxaa tiles", "buffer", tiles, *size))
    variant = draft.program("tiles.vert", "fxaa.frag")
    why = "on the tiles that avatars reach"
    draft.passes.append(Pass("antialiasing: fxaa", "antialiasing", why, variant=variant, reads=reads))


def feature_textures(level: Level) -> list[str]:
    """Names of the textures that hold a level's features, four in each."""
    count = 0 if level.features is None else level.features.shape[2]
    return ["features", "more features"][: count // 4]


def _mipmapped(shape: tuple[int, ...]) -> int:
    height, width = shape[:2]
    return sum(4 * max(height >> i, 1) * max(width >> i, 1) for i in range(mip_levels(shape)))
