"""Which triangle covers each pixel, where on it, and how deep: the measuring rasteriser.

Synthesis, ground truth, part masks, field drawing and bake measurement all look through it, so it draws with
the same cameras as the player and to the pixel of avatar.camera.project.
"""

from typing import NamedTuple

import moderngl
import numpy as np
from jaxtyping import Float, Int

from avatar.camera import Camera, clip_from_view, view_from_world
from player.gl.context import Context
from player.gl.shader import compile_program, set_uniforms

# a float32 counts no further
MAX_FACES = 1 << 24


class Fragments(NamedTuple):
    """One image of triangles; row 0 is the top."""

    face: Int[np.ndarray, "height width"]  # index into faces, -1 where nothing is
    # perspective-correct, sums to 1; 0 where nothing is
    barycentric: Float[np.ndarray, "height width 3"]
    depth: Float[np.ndarray, "height width"]  # metres along the optical axis; inf where nothing is


def clip_planes(depth: Float[np.ndarray, "points"], end: float = np.inf) -> tuple[float, float] | None:
    """Near and far, metres, that hold points of these depths; None when all lie behind the camera.

    Near never falls under a thousandth of where the nearest body ends (`end`; inf: it is the only one), or 24 bits
    could not order surfaces before a camera inside of it.
    """
    far = float(depth.max(initial=-np.inf))
    if not far > 0:
        return None
    near = max(0.999 * float(depth.min()), 1e-3 * min(far, end))
    return near, max(1.001 * far, 1.01 * near)


class Rasteriser:
    """Draws triangle numbers, barycentric coordinates and depth. Keeps one target, remade when the size changes."""

    def __init__(self, context: Context):
        context.make_current()
        self.context = context
        self.program = compile_program(context.gl, "raster.vert", "raster.frag")
        self.vertices = context.gl.buffer(reserve=1 << 16, dynamic=True)
        self.vertex_array = context.gl.vertex_array(self.program, [(self.vertices, "3f4", "position_view")])
        self.target: moderngl.Framebuffer | None = None

    def draw(
        self, vertices_world: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], camera: Camera,
        size: tuple[int, int] | None = None, *, cull: bool = False,
    ) -> Fragments:  # fmt: skip
        """Draw a mesh, world metres, as `camera` sees it (on `size` pixels if given); lens distortion left out.

        cull leaves out triangles that turn their back (clockwise corners). Corners behind the camera are clipped.

        Raises:
            ValueError: faces index past the vertices, or there are more of them than a float can number.
        """
        if size is not None:
            camera = camera.resized(size)
        width, height = camera.size
        faces = np.asarray(faces)
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices_world)):
            raise ValueError(f"faces index {faces.min()}..{faces.max()} of {len(vertices_world)} vertices")
        if len(faces) >= MAX_FACES:
            raise ValueError(f"{len(faces)} faces, at most {MAX_FACES - 1} have a number each")
        # into view space in double precision: a body 10 km from the origin keeps its shape
        view = view_from_world(camera)
        points = np.asarray(vertices_world, np.float64) @ view[:3, :3].T + view[:3, 3]
        planes = clip_planes(-points[faces.reshape(-1), 2])
        raw = np.zeros((height, width, 4), np.float32)
        if planes is not None:
            self.context.make_current()
            gl = self.context.gl
            target, corners = self._used_target((width, height)), points.astype(np.float32)[faces]
            if self.vertices.size < corners.nbytes:
                self.vertices.orphan(corners.nbytes)
            self.vertices.write(np.ascontiguousarray(corners))
            set_uniforms(self.program, clip_from_view=clip_from_view(camera, *planes).T)
            gl.enable_only(moderngl.DEPTH_TEST | (moderngl.CULL_FACE if cull else 0))
            gl.front_face, gl.cull_face = "ccw", "back"
            target.clear()
            self.vertex_array.render(moderngl.TRIANGLES, vertices=3 * len(faces))
            raw = np.frombuffer(target.read(components=4, dtype="f4"), np.float32).reshape(raw.shape)[::-1]
        face = raw[..., 0].astype(np.int32) - 1
        hit = face >= 0
        barycentric = np.empty((height, width, 3), np.float32)
        barycentric[..., 1:] = raw[..., 1:3]
        barycentric[..., 0] = np.where(hit, 1 - raw[..., 1] - raw[..., 2], 0)
        return Fragments(face, barycentric, np.where(hit, raw[..., 3], np.float32(np.inf)))

    def release(self) -> None:
        self.context.make_current()
        self.context.leave_framebuffer()
        for thing in (self.vertex_array, self.vertices, self.program):
            thing.release()
        self._free_target()

    def _used_target(self, size: tuple[int, int]) -> moderngl.Framebuffer:
        if self.target is None or self.target.size != size:
            self.context.leave_framebuffer()
            self._free_target()
            gl = self.context.gl
            self.target = gl.framebuffer([gl.renderbuffer(size, 4, dtype="f4")], gl.depth_renderbuffer(size))
        self.target.use()
        return self.target

    def _free_target(self) -> None:
        if self.target is not None:
            attachments = [*self.target.color_attachments, self.target.depth_attachment]
            self.target.release()  # leaves its attachments alive
            for attachment in attachments:
                attachment.release()
            self.target = None
