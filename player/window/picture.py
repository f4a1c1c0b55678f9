"""A picture drawn in the window: over what is there, or under it where the alpha is not yet full."""

from typing import Any

import moderngl
import numpy as np
from jaxtyping import UInt8

from avatar.camera import Camera
from player.gl.context import Context
from player.gl.shader import compile_program, uniform

# texture unit, away from those of the avatar and the text
UNIT = 6
Number = float | int
# left, top, width, height, pixels from the upper left corner
Box = tuple[Number, Number, Number, Number]


class PictureLayer:
    """One texture, remade when the size changes, and the program that draws it."""

    def __init__(self, context: Context):
        context.make_current()
        self.context = context
        self.program = compile_program(context.gl, "picture.vert", "picture.frag")
        uniform(self.program, "picture").value = UNIT
        self.array = context.gl.vertex_array(self.program, [])
        self.texture = context.gl.texture((1, 1), 4, bytes(4))
        self.camera: Camera | None = None

    def show(self, image: UInt8[np.ndarray, "height width 3"], camera: Camera) -> None:
        """Take a picture and the camera that took it; its lens distortion is undone in drawing."""
        height, width = image.shape[:2]
        rgba = np.dstack([image, np.full((height, width), 255, np.uint8)])
        self.context.make_current()
        if self.texture.size != (width, height):
            self.texture.release()
            self.texture = self.context.gl.texture((width, height), 4)
            self.texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
            self.texture.repeat_x = self.texture.repeat_y = False
        self.texture.write(np.ascontiguousarray(rgba))
        self.camera = camera

    def draw(self, box: Box, size: tuple[int, int], *, under: bool = False, part: Box | None = None) -> None:
        """Draw the picture into the framebuffer in use; only `part` of the window is touched if given."""
        camera = self.camera
        assert camera is not None, "no picture was shown yet"
        width, height = camera.size
        K, d = camera.K, camera.distortion
        uniform(self.program, "lens").value = (K[0, 0] / width, K[1, 1] / height, K[0, 2] / width, K[1, 2] / height)
        uniform(self.program, "distortion").value = tuple(float(x) for x in d[:4])
        uniform(self.program, "more").value = (float(d[4]), K[0, 1] / width)
        self._render(box, size, (0.0, 0.0, 0.0, 0.0), under, part)

    def fill(self, color: tuple[float, float, float], box: Box, size: tuple[int, int], *, under: bool = False) -> None:
        uniform(self.program, "lens").value = (1.0, 1.0, 0.0, 0.0)
        self._render(box, size, (*color, 1.0), under, None)

    def _render(self, box: Box, size: tuple[int, int], plain: tuple[float, ...], under: bool, part: Box | None) -> None:
        left, top, width, height = box
        gl: Any = self.context.gl
        uniform(self.program, "rectangle").value = (
            2 * left / size[0] - 1, 1 - 2 * (top + height) / size[1],
            2 * (left + width) / size[0] - 1, 1 - 2 * top / size[1],
        )  # fmt: skip
        uniform(self.program, "plain").value = plain
        self.texture.use(UNIT)
        gl.enable_only(moderngl.BLEND if under else 0)
        gl.blend_func = (moderngl.ONE_MINUS_DST_ALPHA, moderngl.ONE) if under else (moderngl.ONE, moderngl.ZERO)
        if part is not None:
            x, y, w, h = (round(value) for value in part)
            gl.fbo.scissor = (max(x, 0), max(size[1] - y - h, 0), max(w, 0), max(h, 0))
        self.array.render(moderngl.TRIANGLE_STRIP, vertices=4)
        gl.fbo.scissor = None

    def release(self) -> None:
        self.context.make_current()
        for thing in (self.array, self.program, self.texture):
            thing.release()
