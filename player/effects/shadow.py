"""Shadow of the avatars on the ground: sharp where they touch it and softer the higher they are.

The avatars are drawn into a mask in the ground's own coordinates as their lamp sees them, cover and height; from it the
shadow is softened once, in the same coordinates (shaders/shadow.frag). Both are kept while they stand still, and the
shadow is laid over the floor, or over any background, by one fetch a pixel.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import moderngl
import numpy as np
from jaxtyping import Float

from avatar.camera import view_from_world
from player.draw.drawing import Drawing, Warming
from player.draw.plan import Decision, Draft, Pass, PassState, clamped
from player.draw.resources import Handle, PlanResources
from player.effects.ground_plane import PassBehind, Sheet, behind_parts, target_of
from player.effects.light import light_on
from player.effects.secondary_motion import LooseMesh, loose_mesh
from player.gl.shader import set_uniforms
from player.gl.tiles import Patches

LOWEST = 15.0  # degrees above the horizon: the shadow of a lower lamp has no end
# texels a side: in software 128 to 512 cost the same within 5 %, below 256 feet part from their shadow
SOFTWARE_TEXELS, TEXELS = 256, 512
# whole texels of the mask's third mip, by which its place goes: within one, an outline keeps its texels
STEP = 8
# mip whose texels are the cells that the shadow is drawn in; shaders/shadow_cells.vert
CELL = 4
# triangles of a body whose shadow looks like that of the finest level
TRIANGLES = 2500
SEARCHED = 0.15  # metres of the ground that are looked over for what is above it
SMALLEST = 24  # pixels of the picture

SHADOW_AWAY = Decision(PassState.SKIPPED, "the shadow is out of view")
SMALL = Decision(PassState.SKIPPED, f"the shadow is less than {SMALLEST} pixels across")
STILL = Decision(PassState.KEPT, "nothing has moved")
MOVED = Decision(PassState.RUNS, "avatars moved")


def shadow_passes(
    draft: Draft, direction: tuple[float, float, float], strength: float, softness: float, height: float
) -> Sequence[Pass]:
    """The mask, and the shadow that it lays on the ground.

    direction: towards the lamp, world; strength: share of the light that the shadow takes; softness: degrees from the
    lamp's middle to its edge; height: of the ground above the world's origin, metres.
    """
    # avatars stand apart
    side = (SOFTWARE_TEXELS if draft.canvas.software else TEXELS) * (1 if len(draft.avatars) == 1 else 2)
    size = sum(4 * (side >> i) ** 2 for i in range(side.bit_length()))
    mask = draft.texture("shadow mask", size, side, make=lambda made: _mask_texture(made, side))
    soft = draft.texture(
        "soft shadow", side * side, side, make=lambda made: clamped(made.context.gl.texture((side, side), 1))
    )
    meshes = tuple(
        loose_mesh(draft, index, "shadow_mask.vert", "shadow_mask.frag", level=thrown_level(draft, index))
        for index in range(len(draft.avatars))
    )
    softened = draft.program("shadow_cells.vert", "shadow.frag", samplers=("mask",))
    softening = draft.array(softened)
    x, y, z = _lamp_of(draft, direction).tolist()
    edge = 2 * float(np.tan(np.radians(softness))) * float(np.hypot(np.hypot(x, z), y)) / y
    lamp = ShadowLamp((-x / y, -z / y), edge, height, side, draft.patches(), draft.dual)
    holds = draft.keep(MaskState, MaskState)
    parts = behind_parts(draft, "shadow_cells.vert", "laid.frag", mask, soft, samplers=("mask", "soft"))
    shadow = ShadowPass("ground: shadow", *parts, strength, lamp, mask, soft, holds)
    targets = target_of(draft, mask), target_of(draft, soft)
    owned = (*(handle for one in meshes for handle in one.handles), mask, soft, *targets, softened, softening)
    return MaskPass("ground: mask", owned, lamp, meshes, mask, targets, softened, softening, shadow, holds), shadow


def thrown_level(draft: Draft, avatar: int) -> int:
    """The level of detail whose shadow is thrown: the coarsest with TRIANGLES, none finer than what is drawn."""
    levels = draft.avatars[avatar].levels
    enough = [number for number, level in enumerate(levels) if len(level.faces) >= TRIANGLES]
    return max(draft.detail[avatar], max(enough, default=0))


class ShadowLamp(NamedTuple):
    # metres along x and z by which the shadow of a point a metre above the ground falls beside it
    slant: tuple[float, float]
    edge: float  # metres that the edge of what is a metre above the ground is wide
    # the ground above the world's origin, metres
    height: float
    side: int  # texels of the mask
    # the avatars' surface, and whether dual quaternions move it
    patches: Callable[[], list[Patches]]
    dual: bool

    @property
    def cells(self) -> int:
        return (self.side >> CELL) ** 2


class Footprint(NamedTuple):
    """Where a frame's shadow can lie."""

    sheet: Sheet
    texel: float  # metres a texel
    tall: float  # metres above the ground of the highest that throws it

    def spread(self, lamp: ShadowLamp) -> float:
        """Texels that the edge of the highest is wide."""
        return lamp.edge * self.tall / self.texel

    def reach(self, lamp: ShadowLamp) -> int:
        """Cells that the shadow may lie beside what throws it."""
        return ceil(max(self.spread(lamp), SEARCHED / self.texel) / (1 << CELL))


class MaskState:
    def __init__(self):
        self.key: tuple[object, ...] | None = None

    def footprint(self, drawing: Drawing, lamp: ShadowLamp) -> Footprint | None:
        """Where this frame's shadow lies."""
        return drawing.once(self, lambda: footprint(drawing, lamp))


def footprint(drawing: Drawing, lamp: ShadowLamp) -> Footprint | None:
    """The rectangle of the ground that the avatars' shadow lies in; None: nothing is above it.

    Its place goes by whole steps of texels, their size by quarters of a power of two: a body that moves on keeps the
    grain of its outline.
    """
    world_from_view = np.linalg.inv(view_from_world(drawing.inputs.camera))
    balls = [
        patches.balls(bones.view_from_canonical, dual=lamp.dual, reach=reach)
        for patches, bones, reach in zip(lamp.patches(), drawing.bones, drawing.reaches, strict=True)
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
    texel = float((high - low).max()) / (lamp.side - 3 * STEP)
    quarter = 2.0 ** (np.floor(np.log2(texel)) - 2)
    texel = float(np.ceil(texel / quarter) * quarter)
    first = np.floor(low / (STEP * texel)) * STEP * texel - STEP * texel
    anchor = np.array([first[0], lamp.height, first[1]])
    across = lamp.side * texel
    return Footprint(Sheet(anchor, (0.0, 0.0, across, across)), texel, tall)


@dataclass(frozen=True)
class ShadowPass(PassBehind):
    """The softened shadow laid on the ground."""

    strength: float
    lamp: ShadowLamp
    mask: Handle[moderngl.Texture]
    soft: Handle[moderngl.Texture]
    holds: MaskState

    def decide(self, drawing: Drawing) -> Decision:
        here = self.holds.footprint(drawing, self.lamp)
        box = None if here is None else here.sheet.box(drawing.inputs.camera)
        if here is None or box is None:
            return SHADOW_AWAY
        if max(box[2] - box[0], box[3] - box[1]) < SMALLEST:
            return SMALL
        return Decision(PassState.RUNS, f"{here.texel * 1e3:.0f} mm a texel")

    def draw(self, drawing: Drawing) -> None:
        here, program = self.holds.footprint(drawing, self.lamp), drawing.resources[self.program]
        assert here is not None
        across = self.lamp.side * here.texel
        set_uniforms(program, across=across, reach=here.reach(self.lamp), strength=self.strength)
        self.draw_sheet(drawing, here.sheet)

    def render(self, resources: PlanResources) -> None:
        resources[self.mask].use(0)
        resources[self.soft].use(1)
        resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self.lamp.cells)


@dataclass(frozen=True)
class MaskPass(Pass):
    """What the lamp throws on the ground, and the shadow that this makes."""

    lamp: ShadowLamp
    meshes: tuple[LooseMesh, ...]
    mask: Handle[moderngl.Texture]
    # that draw on the mask, and on the shadow softened
    targets: tuple[Handle[moderngl.Framebuffer], Handle[moderngl.Framebuffer]]
    # what makes a shadow of the mask
    softened: Handle[moderngl.Program]
    softening: Handle[moderngl.VertexArray]
    shadow: ShadowPass
    holds: MaskState

    def decide(self, drawing: Drawing) -> Decision:
        read = self.shadow.decide(drawing)
        if not read.runs:
            return read
        return STILL if self.holds.key == self._wanted(drawing) else MOVED

    def draw(self, drawing: Drawing) -> None:
        """The mask, and the shadow softened."""
        here, resources = self.holds.footprint(drawing, self.lamp), drawing.resources
        assert here is not None
        rows = self._rows(drawing, here)
        for program in {one.program for one in self.meshes}:
            set_uniforms(resources[program], mask_from_view=rows)
        self._begin(resources)
        for one in self.meshes:
            one.draw(drawing)
        drawing.gl.blend_equation = moderngl.FUNC_ADD, moderngl.FUNC_ADD
        resources[self.mask].build_mipmaps()
        self._soften(resources, here)
        drawing.inputs.framebuffer.use()
        self.holds.key = self._wanted(drawing)

    def warm(self, warming: Warming) -> None:
        self._begin(warming.resources)
        for one in self.meshes:
            one.warm(warming.resources)
        warming.resources.context.gl.blend_equation = moderngl.FUNC_ADD, moderngl.FUNC_ADD
        self._draw_soft(warming.resources)
        # nothing that a frame would keep
        self.holds.key = None

    def _begin(self, resources: PlanResources) -> None:
        gl, target = resources.context.gl, resources[self.targets[0]]
        target.use()
        target.clear()
        gl.enable_only(moderngl.BLEND)
        # the lowest that is in the way, whatever the order of triangles
        gl.blend_func = (moderngl.ONE, moderngl.ONE)
        gl.blend_equation = moderngl.MAX, moderngl.MAX

    def _soften(self, resources: PlanResources, here: Footprint) -> None:
        across, search = self.lamp.side * here.texel, max(float(np.log2(SEARCHED / here.texel)), 0.0)
        # the plane's metres to the whole of the target
        columns = np.array([[2 / across, 0, 0, 0], [0, 2 / across, 0, 0], [-1, -1, 0, 1]])
        set_uniforms(
            resources[self.softened], clip_from_plane=columns, across=across, reach=here.reach(self.lamp),
            spread=here.spread(self.lamp), search=search,
        )  # fmt: skip
        self._draw_soft(resources)

    def _draw_soft(self, resources: PlanResources) -> None:
        target = resources[self.targets[1]]
        target.use()
        target.clear()
        resources.context.gl.enable_only(0)
        resources[self.mask].use(0)
        resources[self.softening].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self.lamp.cells)

    def _rows(self, drawing: Drawing, here: Footprint) -> Float[np.ndarray, "3 4"]:
        """Rows across and along the mask, [-1, 1], and of height, [0, 1], of points in view space."""
        (sx, sz), across = self.lamp.slant, self.lamp.side * here.texel
        x0, _, z0 = here.sheet.anchor.tolist()
        low = self.lamp.height
        rows = [[2 / across, 2 * sx / across, 0, -2 * (x0 + sx * low) / across - 1],
                [0, 2 * sz / across, 2 / across, -2 * (z0 + sz * low) / across - 1],
                [0, 1 / here.tall, 0, -low / here.tall]]  # fmt: skip
        return np.array(rows) @ np.linalg.inv(view_from_world(drawing.inputs.camera))

    def _wanted(self, drawing: Drawing) -> tuple[object, ...]:
        """Equal while nothing moves, whatever the camera does."""
        poses = tuple(part.tobytes() for pose in drawing.inputs.poses for part in pose[:2])
        moved = tuple(one.loose.motion.found.version for one in self.meshes if one.loose is not None)
        faces = tuple(one.mesh.face.frame(drawing) for one in self.meshes if one.mesh.face is not None)
        turned = tuple(part.tobytes() for face in faces for part in (face.weights, face.gaze))
        return drawing.resources[self.mask], self.lamp, poses, moved, turned


def _mask_texture(made: PlanResources, side: int) -> moderngl.Texture:
    texture = made.context.gl.texture((side, side), 2, dtype="f2")
    texture.build_mipmaps()
    texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    return clamped(texture)


def _lamp_of(draft: Draft, direction: tuple[float, float, float]) -> Float[np.ndarray, "3"]:
    """Towards the brightest lamp that lights an avatar of the plan; of none, `direction`. Raised to LOWEST."""
    found = np.array(direction, np.float64)
    for avatar in range(len(draft.avatars)):
        light = light_on(draft, avatar)
        if light is not None and light.lamps:
            found = light.directions[light.strengths.argmax()]
            break
    level = max(float(np.hypot(found[0], found[2])), 1e-9)
    return np.array([found[0], max(found[1], level * np.tan(np.radians(LOWEST))), found[2]])
