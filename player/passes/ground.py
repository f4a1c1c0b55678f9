"""What avatars stand on: a floor, and their shadow on it, sharp where they touch it and softer the higher they are.

The avatars are drawn into a mask in the ground's own coordinates as their lamp sees them, cover and height; from it the
shadow is softened once, in the same coordinates (shaders/shadow.frag). Both are kept while they stand still, and the
shadow is laid over the floor, or over any background, by one fetch a pixel.
All of it is drawn before the avatars, without depth: nothing fights with soles, and below the ground nothing shows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Annotated, Any, ClassVar, NamedTuple

import moderngl
import numpy as np
from jaxtyping import Float

from avatar.camera import view_from_world
from avatar.settings import Above, AtLeast, AtMost, Color, OneOf, check
from player.drawing import Drawing, Layer, Warming
from player.ground_plane import Sheet, draw_behind
from player.passes.secondary_motion import Loosened, loosened
from player.plan import Decision, Draft, Pass, Stage, State
from player.posed_mesh import PosedMesh, posed_mesh
from player.resources import Handle, PlanResources
from player.shader import uniform
from player.tiles import SurfacePatches

KINDS = ("plane", "checker", "shadow")
# degrees above the horizon: of a lower lamp the shadow has no end
LOWEST = 15.0
# texels a side: in software 128 to 512 cost the same within 5 %, below 256 feet part from their shadow
SOFTWARE_TEXELS, TEXELS = 256, 512
# whole texels of the mask's third mip, by which its place goes: within one, an outline keeps its texels
STEP = 8
# mip whose texels are the cells that the shadow is drawn in; shaders/shadow_cells.vert
CELL = 4
# of a body whose shadow looks like that of the finest level
TRIANGLES = 2500
# metres of the ground that are looked over for what is above it
SEARCHED = 0.15
# pixels of the picture
SMALLEST = 24
OTHER_CHECKS = 0.72
# of the metres to the floor's edge
OPAQUE = 0.35

BELOW = Decision(State.SKIPPED, "the ground is out of view, or seen from below")
SHADOW_AWAY = Decision(State.SKIPPED, "the shadow is out of view")
SMALL = Decision(State.SKIPPED, f"the shadow is less than {SMALLEST} pixels across")
STILL = Decision(State.KEPT, "nothing has moved")
MOVED = Decision(State.RUNS, "avatars moved")


@dataclass(frozen=True)
class Ground:
    """The floor and the lamp whose shadow falls on it.

    Raises:
        ValueError: a value that is out of its range, a colour that is not opaque, or a lamp lower than LOWEST.
    """

    stage: ClassVar[Stage] = Stage.GROUND

    kind: Annotated[
        str, OneOf(KINDS), "plane: one color; checker: checks of two; shadow: nothing but the shadow, on the background"
    ] = "plane"
    color: Annotated[tuple[float, float, float, float], Color(), "of the floor, opaque"] = (
        88 / 255,
        91 / 255,
        99 / 255,
        1.0,
    )
    height: Annotated[float, AtLeast(-1e4), AtMost(1e4), "of the ground above the world's origin, metres"] = 0.0
    radius: Annotated[
        float, Above(0), AtMost(1e3), "of the floor about the avatars, metres; it fades into what is behind"
    ] = 6.0
    check: Annotated[float, Above(0), AtMost(100), "of checker: a check's side, metres"] = 0.5
    direction: Annotated[
        tuple[float, float, float],
        "towards the lamp, world, any length; with `light` by lamps, capture or panorama its brightest lamp instead",
    ] = (0.4, 0.85, 0.45)  # fmt: skip
    strength: Annotated[float, AtLeast(0), AtMost(1), "of the shadow; 0: none"] = 0.6
    softness: Annotated[float, AtLeast(0), AtMost(20), "how large the lamp is, degrees from its middle to its edge"] = (
        2.0
    )

    def __post_init__(self):
        check(self)
        if self.color[3] < 1:
            raise ValueError("color: a floor is opaque: expected #rrggbb")
        length = float(np.linalg.norm(self.direction))
        if not length > 1e-6 or np.degrees(np.arcsin(self.direction[1] / length)) < LOWEST:
            raise ValueError(
                f"direction: expected a lamp {LOWEST:g} degrees or more above the horizon, found {self.direction}"
            )

    def passes(self, draft: Draft) -> Sequence[Pass]:
        image = draft.own_image(depth=draft.layer.image is None) if draft.canvas.own_image else None
        drawn_on = () if image is None else image.handles
        passes: list[Pass] = []
        if self.kind != "shadow":
            program = draft.program("plane.vert", "floor.frag")
            array = draft.array(program)
            passes.append(FloorPass((*drawn_on, array), self, draft.layer, program, array))
        if self.strength > 0:
            passes += self._shadow(draft, drawn_on)
        return passes

    def _shadow(self, draft: Draft, drawn_on: tuple[Handle[Any], ...]) -> Sequence[Pass]:
        # avatars stand apart
        side = (SOFTWARE_TEXELS if draft.canvas.software else TEXELS) * (1 if len(draft.avatars) == 1 else 2)
        size = sum(4 * (side >> i) ** 2 for i in range(side.bit_length()))
        mask = draft.texture("shadow mask", size, side, make=lambda made: _mask_texture(made, side))
        target = draft.need(
            Handle(
                moderngl.Framebuffer, "shadow mask", 0, (mask,),
                lambda made: made.context.gl.framebuffer([made[mask]]),
            )
        )  # fmt: skip
        meshes = []
        for index in range(len(draft.avatars)):
            loose = loosened(draft, index)
            # loose parts are bound to the vertices of the level that is drawn
            mesh = posed_mesh(draft, index, level=None if loose is not None else thrown_level(draft, index))
            thrown = draft.program(
                "shadow_mask.vert", "shadow_mask.frag", SKINNING=int(draft.dual), LOOSE=int(loose is not None)
            )
            array = mesh.array(draft, thrown, *(() if loose is None else (loose.buffer,)))
            meshes.append(Thrown(mesh, array, thrown, loose))
        soft = draft.texture("soft shadow", side * side, side, make=lambda made: _soft_texture(made, side))
        soft_target = draft.need(
            Handle(
                moderngl.Framebuffer, "soft shadow", 0, (soft,),
                lambda made: made.context.gl.framebuffer([made[soft]]),
            )
        )  # fmt: skip
        softened = draft.program("shadow_cells.vert", "shadow.frag", samplers=("mask",))
        softening = Softening(softened, draft.array(softened), soft_target)
        program = draft.program("shadow_cells.vert", "shadow_laid.frag", samplers=("mask", "soft"))
        array = draft.array(program)
        x, y, z = _lamp_of(draft, self.direction).tolist()
        edge = 2 * float(np.tan(np.radians(self.softness))) * float(np.hypot(np.hypot(x, z), y)) / y
        lamp = Lamp((-x / y, -z / y), edge, self.height, side, draft.patches(), draft.dual)
        holds = draft.keep((Ground, "mask"), MaskState)
        uses = tuple(handle for one in meshes for handle in one.handles)
        shadow = ShadowPass((*drawn_on, mask, soft, array), self, lamp, draft.layer, mask, soft, program, array, holds)
        owned = (*uses, mask, target, soft, *softening)
        return MaskPass(owned, lamp, tuple(meshes), target, mask, softening, shadow, holds), shadow


def thrown_level(draft: Draft, avatar: int) -> int:
    """The level of detail whose shadow is thrown: the coarsest with TRIANGLES, none finer than what is drawn."""
    levels = draft.avatars[avatar].levels
    enough = [number for number, level in enumerate(levels) if len(level.faces) >= TRIANGLES]
    return max(draft.detail[avatar], max(enough, default=0))


class Thrown(NamedTuple):
    """One avatar as its shadow is thrown."""

    mesh: PosedMesh
    array: Handle[moderngl.VertexArray]
    program: Handle[moderngl.Program]
    loose: Loosened | None

    @property
    def handles(self) -> tuple[Handle[Any], ...]:
        more = () if self.loose is None else self.loose.handles
        return (*self.mesh.handles, self.array, self.program, *more)


class Softening(NamedTuple):
    """What makes a shadow of the mask, in the ground's own coordinates."""

    program: Handle[moderngl.Program]
    array: Handle[moderngl.VertexArray]
    target: Handle[moderngl.Framebuffer]


class Lamp(NamedTuple):
    """The lamp as the shadow needs it, and what it shines on."""

    # metres along x and z by which the shadow of a point a metre above the ground falls beside it
    slant: tuple[float, float]
    # metres that the edge is wide, of what is a metre above the ground
    edge: float
    # of the ground
    height: float
    # texels of the mask
    side: int
    # of the avatars, and whether dual quaternions move them
    patches: SurfacePatches
    dual: bool

    @property
    def cells(self) -> int:
        return (self.side >> CELL) ** 2


class Footprint(NamedTuple):
    """Where a frame's shadow can lie."""

    sheet: Sheet
    # metres a texel
    texel: float
    # of the highest that throws it, above the ground, metres
    tall: float

    def spread(self, lamp: Lamp) -> float:
        """Texels that the edge of the highest is wide."""
        return lamp.edge * self.tall / self.texel

    def reach(self, lamp: Lamp) -> int:
        """Cells that the shadow may lie beside what throws it."""
        return ceil(max(self.spread(lamp), SEARCHED / self.texel) / (1 << CELL))


class MaskState:
    """What the mask's texture holds, and where the shadow lies in the frame that is being drawn."""

    def __init__(self):
        self.key: tuple[Any, ...] | None = None
        self._drawing: Drawing | None = None
        self._here: Footprint | None = None

    def footprint(self, drawing: Drawing, lamp: Lamp) -> Footprint | None:
        """Where this frame's shadow lies, worked out once a frame."""
        if self._drawing is not drawing:
            self._drawing, self._here = drawing, footprint(drawing, lamp)
        return self._here


def footprint(drawing: Drawing, lamp: Lamp) -> Footprint | None:
    """The rectangle of the ground that the avatars' shadow lies in; None: nothing is above it.

    Its place goes by whole steps of texels, their size by a ladder of quarter octaves: a body that moves on keeps the
    grain of its outline.
    """
    world_from_view = np.linalg.inv(view_from_world(drawing.inputs.camera))
    balls = [
        patches.balls(bones.view_from_canonical, dual=lamp.dual, reach=reach)
        for patches, bones, reach in zip(lamp.patches, drawing.bones, drawing.reaches, strict=True)
    ]
    center, radius = (np.concatenate(part) for part in zip(*balls, strict=True))
    center = center @ world_from_view[:3, :3].T + world_from_view[:3, 3]
    above = center[:, 1] + radius - lamp.height
    if not (above > 0).any():
        return None
    tall = float(above.max())
    slant = np.array(lamp.slant)
    at = center[:, [0, 2]] + np.maximum(center[:, 1:2] - lamp.height, 0) * slant
    wide = radius[:, None] * np.sqrt(1 + slant * slant) + lamp.edge * np.maximum(above, 0)[:, None]
    low, high = (at - wide).min(0), (at + wide).max(0)
    # STEP at one side for the step itself, and a clear rim at both, which mips bleed over
    free = lamp.side - 3 * STEP
    texel = float((high - low).max()) / free
    texel = float(2.0 ** (np.ceil(4 * np.log2(texel)) / 4))
    first = np.floor(low / (STEP * texel)) * STEP * texel - STEP * texel
    anchor = np.array([first[0], lamp.height, first[1]])
    across = lamp.side * texel
    return Footprint(Sheet(anchor, (0.0, 0.0, across, across)), texel, tall)


@dataclass(frozen=True)
class FloorPass:
    uses: tuple[Handle[Any], ...]
    ground: Ground
    layer: Layer
    program: Handle[moderngl.Program]
    array: Handle[moderngl.VertexArray]
    name: str = "ground: floor"

    def decide(self, drawing: Drawing) -> Decision:
        seen = self._sheet(drawing).box(drawing.inputs.camera) is not None
        return Decision(State.RUNS, self.ground.kind) if seen else BELOW

    def draw(self, drawing: Drawing) -> None:
        sheet, program = self._sheet(drawing), drawing.resources[self.program]

        uniform(program, "reach").value = sheet.reach

        def draw(flipped: bool) -> None:
            sheet.apply(program, drawing.inputs.camera, flipped=flipped)
            self._render(drawing.resources)

        draw_behind(drawing, self.layer, draw)

    def warm(self, warming: Warming) -> None:
        if warming.framebuffer is not None:
            warming.framebuffer.use()
            warming.resources.context.gl.enable_only(moderngl.BLEND)
            self._render(warming.resources)

    def _render(self, resources: PlanResources) -> None:
        ground, program = self.ground, resources[self.program]
        uniform(program, "paint").value = ground.color[:3]
        uniform(program, "other").value = OTHER_CHECKS
        uniform(program, "check").value = ground.check if ground.kind == "checker" else 0.0
        uniform(program, "fade").value = (OPAQUE * ground.radius, ground.radius)
        resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _sheet(self, drawing: Drawing) -> Sheet:
        """About the middle of the avatars; checks stay where they are in the world."""
        radius, checks = self.ground.radius, 2 * self.ground.check
        middle = np.mean([root for _, root in drawing.inputs.poses], axis=0)
        if self.ground.kind == "checker":
            middle = np.floor(middle / checks) * checks
        return Sheet(np.array([middle[0], self.ground.height, middle[2]]), (-radius, -radius, radius, radius))


@dataclass(frozen=True)
class ShadowPass:
    """The softened shadow laid on the ground."""

    uses: tuple[Handle[Any], ...]
    ground: Ground
    lamp: Lamp
    layer: Layer
    mask: Handle[moderngl.Texture]
    soft: Handle[moderngl.Texture]
    program: Handle[moderngl.Program]
    array: Handle[moderngl.VertexArray]
    holds: MaskState
    name: str = "ground: shadow"

    def decide(self, drawing: Drawing) -> Decision:
        here = self.holds.footprint(drawing, self.lamp)
        box = None if here is None else here.sheet.box(drawing.inputs.camera)
        if here is None or box is None:
            return SHADOW_AWAY
        if max(box[2] - box[0], box[3] - box[1]) < SMALLEST:
            return SMALL
        return Decision(State.RUNS, f"{here.texel * 1e3:.0f} mm a texel")

    def draw(self, drawing: Drawing) -> None:
        here, resources = self.holds.footprint(drawing, self.lamp), drawing.resources
        assert here is not None
        program = resources[self.program]
        uniform(program, "across").value = self.lamp.side * here.texel
        uniform(program, "reach").value = here.reach(self.lamp)
        uniform(program, "strength").value = self.ground.strength

        def draw(flipped: bool) -> None:
            here.sheet.apply(program, drawing.inputs.camera, flipped=flipped)
            self._render(resources)

        draw_behind(drawing, self.layer, draw)

    def warm(self, warming: Warming) -> None:
        if warming.framebuffer is not None:
            warming.framebuffer.use()
            warming.resources.context.gl.enable_only(moderngl.BLEND)
            self._render(warming.resources)

    def _render(self, resources: PlanResources) -> None:
        resources[self.mask].use(0)
        resources[self.soft].use(1)
        resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self.lamp.cells)


@dataclass(frozen=True)
class MaskPass:
    """What the lamp throws on the ground, and the shadow that this makes."""

    uses: tuple[Handle[Any], ...]
    lamp: Lamp
    meshes: tuple[Thrown, ...]
    target: Handle[moderngl.Framebuffer]
    mask: Handle[moderngl.Texture]
    softening: Softening
    shadow: ShadowPass
    holds: MaskState
    name: str = "ground: mask"

    def decide(self, drawing: Drawing) -> Decision:
        read = self.shadow.decide(drawing)
        if not read.runs:
            return read
        return STILL if self.holds.key == self._wanted(drawing) else MOVED

    def draw(self, drawing: Drawing) -> None:
        here, resources, gl = self.holds.footprint(drawing, self.lamp), drawing.resources, drawing.gl
        assert here is not None
        rows = np.ascontiguousarray(self._rows(drawing, here), np.float32).tobytes()
        for program in {one.program for one in self.meshes}:
            uniform(resources[program], "mask_from_view").write(rows)
        self._begin(resources)
        for one in self.meshes:
            one.mesh.pose(drawing)
            if one.loose is not None:
                one.loose.bind(drawing)
            resources[one.array].render()
        self._end(gl)
        resources[self.mask].build_mipmaps()
        self._soften(resources, here)
        drawing.inputs.framebuffer.use()
        self.holds.key = self._wanted(drawing)

    def warm(self, warming: Warming) -> None:
        self._begin(warming.resources)
        for one in self.meshes:
            one.mesh.warm(warming.resources)
            if one.loose is not None:
                one.loose.warm(warming.resources)
            warming.resources[one.array].render(vertices=3)
        self._end(warming.resources.context.gl)
        self._softened(warming.resources)
        # nothing that a frame would keep
        self.holds.key = None

    def _begin(self, resources: PlanResources) -> None:
        gl, target = resources.context.gl, resources[self.target]
        target.use()
        target.clear()
        gl.enable_only(moderngl.BLEND)
        # the lowest that is in the way, whatever the order of triangles
        gl.blend_func = (moderngl.ONE, moderngl.ONE)
        gl.blend_equation = moderngl.MAX, moderngl.MAX

    def _end(self, gl: moderngl.Context) -> None:
        gl.blend_equation = moderngl.FUNC_ADD, moderngl.FUNC_ADD

    def _soften(self, resources: PlanResources, here: Footprint) -> None:
        program, across = resources[self.softening.program], self.lamp.side * here.texel
        # the plane's metres to the whole of the target
        columns = np.array([[2 / across, 0, 0, 0], [0, 2 / across, 0, 0], [-1, -1, 0, 1]], np.float32)
        uniform(program, "clip_from_plane").write(columns.tobytes())
        uniform(program, "across").value = across
        uniform(program, "reach").value = here.reach(self.lamp)
        uniform(program, "spread").value = here.spread(self.lamp)
        uniform(program, "search").value = max(float(np.log2(SEARCHED / here.texel)), 0.0)
        self._softened(resources)

    def _softened(self, resources: PlanResources) -> None:
        target = resources[self.softening.target]
        target.use()
        target.clear()
        resources.context.gl.enable_only(0)
        resources[self.mask].use(0)
        resources[self.softening.array].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self.lamp.cells)

    def _rows(self, drawing: Drawing, here: Footprint) -> Float[np.ndarray, "3 4"]:
        """Rows across and along the mask, [-1, 1], and of height, [0, 1], of points in view space."""
        (sx, sz), across = self.lamp.slant, self.lamp.side * here.texel
        x0, _, z0 = here.sheet.anchor.tolist()
        low = self.lamp.height
        rows = np.array(
            [
                [2 / across, 2 * sx / across, 0, -2 * (x0 + sx * low) / across - 1],
                [0, 2 * sz / across, 2 / across, -2 * (z0 + sz * low) / across - 1],
                [0, 1 / here.tall, 0, -low / here.tall],
            ]
        )
        return rows @ np.linalg.inv(view_from_world(drawing.inputs.camera))

    def _wanted(self, drawing: Drawing) -> tuple[Any, ...]:
        """Equal while nothing moves, whatever the camera does."""
        poses = tuple(part.tobytes() for pose in drawing.inputs.poses for part in pose)
        moved = tuple(one.loose.motion.found.version for one in self.meshes if one.loose is not None)
        return drawing.resources[self.mask], self.lamp, poses, moved


def _mask_texture(made: PlanResources, side: int) -> moderngl.Texture:
    texture = made.context.gl.texture((side, side), 2, dtype="f2")
    texture.build_mipmaps()
    texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    texture.repeat_x = texture.repeat_y = False
    return texture


def _soft_texture(made: PlanResources, side: int) -> moderngl.Texture:
    texture = made.context.gl.texture((side, side), 1, dtype="f1")
    texture.repeat_x = texture.repeat_y = False
    return texture


def _lamp_of(draft: Draft, direction: tuple[float, float, float]) -> Float[np.ndarray, "3"]:
    """Towards the brightest lamp that lights an avatar of the plan; of none, `direction`. Raised to LOWEST."""
    found = np.array(direction, np.float64)
    for avatar in draft.avatars:
        light = None if draft.light_of is None else draft.light_of(avatar)
        if light is not None and light.lamps:
            found = light.directions[light.strengths.argmax()]
            break
    level = max(float(np.hypot(found[0], found[2])), 1e-9)
    return np.array([found[0], max(found[1], level * np.tan(np.radians(LOWEST))), found[2]])
