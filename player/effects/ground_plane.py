"""A rectangle of a level plane as passes draw on it: its matrix, and where it is in the picture.

Places on it are metres about an anchor near the avatars, (x, z) of the world less the anchor's: the large numbers of a
scene far from the world's origin cancel in double precision before anything is rounded.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import NamedTuple

import moderngl
import numpy as np
from jaxtyping import Float

from avatar.camera import Camera, clip_from_view, view_from_world
from player.draw.drawing import Drawing, Layer, Warming
from player.draw.plan import Pass
from player.draw.resources import PlanResources
from player.gl.shader import uniform

Array = np.ndarray
# metres; nothing on the plane is tested for depth, so they need not be tight
NEAR, FAR = 0.01, 1e5
# metres before the lens from which on a corner is projected
AHEAD = 0.01


class Sheet(NamedTuple):
    """A rectangle of a level plane."""

    anchor: Float[Array, "3"]  # world, metres
    reach: tuple[float, float, float, float]  # x0, z0, x1, z1 about the anchor, metres

    @property
    def corners(self) -> Float[Array, "4 3"]:
        """Its corners in the world, in turn."""
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
        uniform(program, "clip_from_plane").write(np.ascontiguousarray(columns, np.float32).tobytes())


class PassBehind(Pass):
    """A pass that draws on the picture before the avatars are."""

    @abstractmethod
    def _render(self, resources: PlanResources) -> None:
        """Its draw, with the uniforms that stand."""

    def warm(self, warming: Warming) -> None:
        if warming.enter_picture():
            self._render(warming.resources)


def draw_behind(drawing: Drawing, layer: Layer, draw: Callable[[bool], None]) -> None:
    """Draw on the picture before the avatars are; once more on their layer, where that begins with what is behind them.

    `draw` takes whether row 0 is the top.
    """
    gl = drawing.gl
    drawing.inputs.framebuffer.use()
    _blend(gl)
    draw(drawing.inputs.flipped)
    if layer.begins_with_picture and any(drawing.visible):
        assert layer.image is not None
        drawing.enter(layer)
        drawing.resources[layer.image.framebuffer].use()
        _blend(gl)
        draw(drawing.inputs.flipped or layer.always_flipped)
        # as `enter` left it
        gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)


def _blend(gl: moderngl.Context) -> None:
    """Premultiplied colors over what is there."""
    gl.enable_only(moderngl.BLEND)
    gl.blend_func = (moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA)


def _ahead(polygon: Float[Array, "corners 3"]) -> Float[Array, "clipped 3"]:
    """The part of a polygon in front of the lens, camera space (Sutherland and Hodgman 1974)."""
    out = []
    for a, b in zip(polygon, np.roll(polygon, -1, 0), strict=True):
        if a[2] >= AHEAD:
            out.append(a)
        if (a[2] >= AHEAD) != (b[2] >= AHEAD):
            out.append(a + (b - a) * (AHEAD - a[2]) / (b[2] - a[2]))
    return np.array(out).reshape(-1, 3)
