"""A rectangle of a level plane as passes draw on it: its matrix, and where it is in the picture.

Places on it are metres about an anchor near the avatars, (x, z) of the world less the anchor's: the large numbers of a
scene far from the world's origin cancel in double precision before anything is rounded.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import moderngl
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.camera import Camera, clip_from_view, view_from_world
from player.draw.drawing import Drawing, Layer, Warming
from player.draw.plan import Decision, Draft, Pass, PassState, clamped
from player.draw.resources import AnyHandle, Handle, Image, PlanResources
from player.gl.shader import Uniforms, set_uniforms

NEAR, FAR = 0.01, 1e5  # metres; nothing on the plane is tested for depth, so they need not be tight
AHEAD = 0.01  # metres before the lens from which on a corner is projected
AWAY = Decision(PassState.SKIPPED, "the ground is out of view, or seen from below")


class Sheet(NamedTuple):
    anchor: Float[Array, "3"]  # world, metres
    reach: tuple[float, float, float, float]  # x0, z0, x1, z1 about the anchor, metres

    @property
    def corners(self) -> Float[Array, "4 3"]:
        x0, z0, x1, z1 = self.reach
        return self.anchor + np.array([[x0, 0, z0], [x1, 0, z0], [x1, 0, z1], [x0, 0, z1]])

    def box(self, camera: Camera) -> Float[Array, "4"] | None:
        """Left, top, right, bottom of what the picture shows of it, pixels; None: nothing, or its lower side."""
        if camera.eye[1] <= self.anchor[1]:
            return None
        R, t = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
        seen = _ahead(self.corners @ R.T + t)
        if not len(seen):
            return None
        pixels = (seen @ camera.K.T)[:, :2] / seen[:, 2:]
        low, high = np.maximum(pixels.min(0), 0), np.minimum(pixels.max(0), camera.size)
        return np.concatenate([low, high]) if (high > low).all() else None

    def apply(self, program: moderngl.Program, camera: Camera, *, flipped: bool) -> None:
        """Give a program the plane's matrix, as this camera sees it."""
        clip = clip_from_view(camera, NEAR, FAR) @ view_from_world(camera)
        if flipped:
            clip[1] = -clip[1]
        columns = np.stack([clip[:, 0], clip[:, 2], clip @ np.append(self.anchor, 1.0)])
        set_uniforms(program, clip_from_plane=columns)


@dataclass(frozen=True)
class PassBehind(Pass):
    """A pass that draws on the picture before the avatars are, by one program."""

    layer: Layer
    array: Handle[moderngl.VertexArray]

    def render(self, resources: PlanResources) -> None:
        """Its draw, with the uniforms that stand."""
        resources[self.array].render(moderngl.TRIANGLE_STRIP, vertices=4)

    def draw_sheet(self, drawing: Drawing, sheet: Sheet) -> None:
        """Draw on the picture; once more on the avatars' layer, where that begins with what is behind them."""
        flipped, image = drawing.inputs.flipped, self.layer.image
        self._draw_into(drawing.inputs.framebuffer, drawing, sheet, flipped)
        if self.layer.begins_with_picture and image is not None and any(drawing.visible):
            drawing.enter(self.layer)
            framebuffer = drawing.resources[image.framebuffer]
            self._draw_into(framebuffer, drawing, sheet, flipped or self.layer.always_flipped)
            # as `enter` left it
            drawing.gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)

    def _draw_into(self, target: moderngl.Framebuffer, drawing: Drawing, sheet: Sheet, flipped: bool) -> None:
        """Premultiplied colors over what is there."""
        target.use()
        drawing.gl.enable_only(moderngl.BLEND)
        drawing.gl.blend_func = (moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA)
        sheet.apply(drawing.resources[self.array].program, drawing.inputs.camera, flipped=flipped)
        self.render(drawing.resources)

    def warm(self, warming: Warming) -> None:
        if warming.enter_picture():
            self.render(warming.resources)


@dataclass(frozen=True)
class SquarePass(PassBehind):
    """A square of the ground about the middle of the avatars, strong in the middle and gone at its edge."""

    height: float  # metres
    radius: float  # metres to its edge
    share: float  # part of the radius, up to where it is as strong as it is
    step: float  # metres, of which its middle goes a whole number; 0: as the avatars do
    # the uniforms of its program, once it is known where it lies
    paint: Callable[[Sheet], Uniforms]
    running: Decision

    def decide(self, drawing: Drawing) -> Decision:
        return self.running if self._sheet(drawing).box(drawing.inputs.camera) is not None else AWAY

    def draw(self, drawing: Drawing) -> None:
        sheet, fade = self._sheet(drawing), (self.share * self.radius, self.radius)
        set_uniforms(drawing.resources[self.array].program, reach=sheet.reach, fade=fade, **self.paint(sheet))
        self.draw_sheet(drawing, sheet)

    def _sheet(self, drawing: Drawing) -> Sheet:
        middle, radius = np.mean([pose.root for pose in drawing.inputs.poses], axis=0), self.radius
        if self.step:
            middle = np.floor(middle / self.step) * self.step
        return Sheet(np.array([middle[0], self.height, middle[2]]), (-radius, -radius, radius, radius))


def behind_parts(
    draft: Draft, vertex: str, fragment: str, *more: AnyHandle, samplers: Sequence[str] = (), **defines: int
) -> tuple[tuple[AnyHandle, ...], Layer, Handle[moderngl.VertexArray]]:
    """What such a pass begins with, after its name; more: what it reads beside its vertices."""
    uses = draft.behind_avatars
    program = draft.program(vertex, fragment, samplers=samplers, avatar=None, constants=dict, **defines)
    array = draft.array(program)
    return (*uses, *more, array), draft.layer, array


def drawn_texture(
    draft: Draft, name: str, size: int, side: int, *depends_on: Hashable,
    make: Callable[[PlanResources], moderngl.Texture] | None = None,
) -> Image:  # fmt: skip
    """A square texture of the ground that passes draw on, of `size` bytes; of one channel unless `make` says else."""
    plain = lambda made: clamped(made.context.gl.texture((side, side), 1))
    texture = draft.texture(name, size, *depends_on, make=make or plain)
    target = lambda made: made.context.gl.framebuffer([made[texture]])
    return Image((side, side), draft.need(Handle(moderngl.Framebuffer, name, 0, (texture,), target)), texture, None)


def _ahead(polygon: Float[Array, "corners 3"]) -> Float[Array, "clipped 3"]:
    """The part of a polygon in front of the lens, camera space (Sutherland and Hodgman 1974)."""
    out = []
    for a, b in zip(polygon, np.roll(polygon, -1, 0), strict=True):
        if a[2] >= AHEAD:
            out.append(a)
        if (a[2] >= AHEAD) != (b[2] >= AHEAD):
            out.append(a + (b - a) * (AHEAD - a[2]) / (b[2] - a[2]))
    return np.array(out).reshape(-1, 3)
