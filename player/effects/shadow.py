"""Shadow of the avatars on the ground: sharp where they touch it and softer the higher they are.

The avatars are drawn into a mask in the ground's own coordinates as their lamp sees them, cover and height; from it the
shadow is softened once, in the same coordinates (shaders/shadow.frag). Both are kept while they stand still, and the
shadow is laid over the floor, or over any background, by one fetch a pixel.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import moderngl
import numpy as np
from jaxtyping import Float

from avatar.camera import view_from_world
from player.draw.drawing import Drawing, Warming
from player.draw.plan import Decision, Draft, Pass, PassState, clamped
from player.draw.posed_mesh import DrawnMesh
from player.draw.resources import Handle, Image, PlanResources
from player.effects.ground_plane import PassBehind, Sheet, behind_parts, drawn_texture
from player.effects.light import light_on
from player.effects.secondary_motion import LooseOffsets, loose_mesh
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
    mask = drawn_texture(draft, "shadow mask", size, side, side, make=lambda made: _mask_texture(made, side))
    soft = drawn_texture(draft, "soft shadow", side * side, side, side)
    meshes = tuple(
        loose_mesh(draft, index, "shadow_mask.vert", "shadow_mask.frag", level=thrown_level(draft, index))
        for index in range(len(draft.avatars))
    )
    softening = draft.array(draft.program("shadow_cells.vert", "shadow.frag", samplers=("mask",)))
    x, y, z = _lamp_of(draft, direction).tolist()
    edge = 2 * float(np.tan(np.radians(softness))) * float(np.hypot(np.hypot(x, z), y)) / y
    lamp = ShadowLamp((-x / y, -z / y), edge, height, side, draft.patches(), draft.dual)
    parts = behind_parts(draft, "shadow_cells.vert", "laid.frag", mask.color, soft.color, samplers=("mask", "soft"))
    shadow = ShadowPass("ground: shadow", *parts, strength, lamp, mask, soft)
    owned = (*(handle for one in meshes for handle in one.handles), *mask.handles, *soft.handles, softening)
    return MaskPass("ground: mask", owned, lamp, meshes, softening, shadow), shadow


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

    def footprint(self, drawing: Drawing) -> "Footprint | None":
        """Where this frame's shadow lies."""
        return drawing.once(self, lambda: footprint(drawing, self))


class Footprint(NamedTuple):
    """Where a frame's shadow can lie."""

    sheet: Sheet
    texel: float  # metres a texel
    tall: float  # metres above the ground of the highest that throws it
    spread: float  # texels that the edge of the highest is wide
    reach: int  # cells that the shadow may lie beside what throws it

    @property
    def across(self) -> float:
        """Metres of its side."""
        return self.sheet.reach[2]


def footprint(drawing: Drawing, lamp: ShadowLamp) -> Footprint | None:
    """The rectangle of the ground that the avatars' shadow lies in; None: nothing is above it.

    Its place goes by steps of texels, their size by quarters of a power of two: a moving outline keeps its grain.
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
    across, spread = lamp.side * texel, lamp.edge * tall / texel
    reach = ceil(max(spread, SEARCHED / texel) / (1 << CELL))
    return Footprint(Sheet(anchor, (0.0, 0.0, across, across)), texel, tall, spread, reach)


@dataclass(frozen=True)
class ShadowPass(PassBehind):
    """The softened shadow laid on the ground."""

    strength: float
    lamp: ShadowLamp
    mask: Image
    soft: Image

    def decide(self, drawing: Drawing) -> Decision:
        here = self.lamp.footprint(drawing)
        box = None if here is None else here.sheet.box(drawing.inputs.camera)
        if here is None or box is None:
            return SHADOW_AWAY
        if max(box[2] - box[0], box[3] - box[1]) < SMALLEST:
            return SMALL
        return Decision(PassState.RUNS, f"{here.texel * 1e3:.0f} mm a texel")

    def draw(self, drawing: Drawing) -> None:
        here, program = self.lamp.footprint(drawing), drawing.resources[self.array].program
        assert here is not None
        set_uniforms(program, across=here.across, reach=here.reach, strength=self.strength)
        self.draw_sheet(drawing, here.sheet)

    def render(self, resources: PlanResources) -> None:
        resources[self.mask.color].use(0)
        resources[self.soft.color].use(1)
        resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self.lamp.cells)


@dataclass(frozen=True)
class MaskPass(Pass):
    """What the lamp throws on the ground, and the shadow that this makes."""

    lamp: ShadowLamp
    meshes: tuple[DrawnMesh, ...]
    # what makes a shadow of the mask
    softening: Handle[moderngl.VertexArray]
    shadow: ShadowPass

    def decide(self, drawing: Drawing) -> Decision:
        read = self.shadow.decide(drawing)
        if not read.runs:
            return read
        return STILL if drawing.resources.holds.get(self.shadow.mask.color) == self._wanted(drawing) else MOVED

    def draw(self, drawing: Drawing) -> None:
        """The mask, and the shadow softened."""
        here, resources = self.lamp.footprint(drawing), drawing.resources
        assert here is not None
        rows = self._rows(drawing, here)
        for program in {resources[one.array].program for one in self.meshes}:
            set_uniforms(program, mask_from_view=rows)
        self._throw(resources, lambda one: one.draw(drawing))
        resources[self.shadow.mask.color].build_mipmaps()
        # the plane's metres to the whole of the target
        columns = np.array([[2 / here.across, 0, 0, 0], [0, 2 / here.across, 0, 0], [-1, -1, 0, 1]])
        set_uniforms(
            resources[self.softening].program, clip_from_plane=columns, across=here.across, reach=here.reach,
            spread=here.spread, search=max(float(np.log2(SEARCHED / here.texel)), 0.0),
        )  # fmt: skip
        self._draw_soft(resources)
        drawing.inputs.framebuffer.use()
        resources.holds[self.shadow.mask.color] = self._wanted(drawing)

    def warm(self, warming: Warming) -> None:
        self._throw(warming.resources, lambda one: one.warm(warming.resources))
        self._draw_soft(warming.resources)
        # nothing that a frame would keep
        warming.resources.holds.pop(self.shadow.mask.color, None)

    def _throw(self, resources: PlanResources, draw: Callable[[DrawnMesh], None]) -> None:
        """The avatars into the mask."""
        gl, target = resources.context.gl, resources[self.shadow.mask.framebuffer]
        target.use()
        target.clear()
        gl.enable_only(moderngl.BLEND)
        # the lowest that is in the way, whatever the order of triangles
        gl.blend_func = (moderngl.ONE, moderngl.ONE)
        gl.blend_equation = moderngl.MAX, moderngl.MAX
        for one in self.meshes:
            draw(one)
        gl.blend_equation = moderngl.FUNC_ADD, moderngl.FUNC_ADD

    def _draw_soft(self, resources: PlanResources) -> None:
        target = resources[self.shadow.soft.framebuffer]
        target.use()
        target.clear()
        resources.context.gl.enable_only(0)
        resources[self.shadow.mask.color].use(0)
        resources[self.softening].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self.lamp.cells)

    def _rows(self, drawing: Drawing, here: Footprint) -> Float[np.ndarray, "3 4"]:
        """Rows across and along the mask, [-1, 1], and of height, [0, 1], of points in view space."""
        (sx, sz), across = self.lamp.slant, here.across
        x0, low, z0 = here.sheet.anchor.tolist()
        rows = [[2 / across, 2 * sx / across, 0, -2 * (x0 + sx * low) / across - 1],
                [0, 2 * sz / across, 2 / across, -2 * (z0 + sz * low) / across - 1],
                [0, 1 / here.tall, 0, -low / here.tall]]  # fmt: skip
        return np.array(rows) @ np.linalg.inv(view_from_world(drawing.inputs.camera))

    def _wanted(self, drawing: Drawing) -> tuple[Hashable, ...]:
        """Equal while nothing moves, whatever the camera does."""
        poses = tuple(part.tobytes() for pose in drawing.inputs.poses for part in pose[:2])
        added = [one for mesh in self.meshes for one in mesh.added]
        moved = tuple(one.motion().version for one in added if isinstance(one, LooseOffsets))
        faces = tuple(one.mesh.face.frame(drawing) for one in self.meshes if one.mesh.face is not None)
        turned = tuple(part.tobytes() for face in faces for part in (face.weights, face.gaze))
        return self.lamp, poses, moved, turned


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
