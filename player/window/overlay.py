"""One line of text over a picture: frames per second, time, keys. Drawn from Pillow's own bitmap font."""

import moderngl
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from player.context import Context
from player.shader import compile_program, uniform

PADDING = 5  # pixels round the letters
UNIT = 7  # texture unit, away from those of the avatar


class TextLine:
    """A line of text in the lower left corner. Uploads only when the text changes."""

    def __init__(self, context: Context):
        context.make_current()
        self.context = context
        self.program = compile_program(context.gl, "text.vert", "text.frag")
        uniform(self.program, "letters").value = UNIT
        self.array = context.gl.vertex_array(self.program, [])
        self.texture: moderngl.Texture | None = None
        self.text = ""
        self.font = ImageFont.load_default_imagefont()

    def draw(self, text: str, size: tuple[int, int]) -> None:
        """Draw into the framebuffer in use, which has `size` pixels."""
        gl = self.context.gl
        if text != self.text or self.texture is None:
            self._upload(text)
        assert self.texture is not None
        width, height = self.texture.size
        uniform(self.program, "rectangle").value = (
            -1.0,
            -1.0,
            2 * width / size[0] - 1,
            2 * height / size[1] - 1,
        )
        self.texture.use(UNIT)
        gl.enable_only(moderngl.BLEND)
        gl.blend_func = (moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA)
        self.array.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _upload(self, text: str) -> None:
        left, top, right, bottom = self.font.getbbox(text)
        image = Image.new("L", (int(right - left) + 2 * PADDING, int(bottom - top) + 2 * PADDING))
        ImageDraw.Draw(image).text((PADDING, PADDING), text, fill=255, font=self.font)
        letters = np.asarray(image)
        if self.texture is None or self.texture.size != image.size:
            if self.texture is not None:
                self.texture.release()
            self.texture = self.context.gl.texture(image.size, 1, alignment=1)
            self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.texture.write(letters.tobytes(), alignment=1)
        self.text = text

    def release(self) -> None:
        self.context.make_current()
        for thing in (self.array, self.program, self.texture):
            if thing is not None:
                thing.release()
        self.texture = None
