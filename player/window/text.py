"""Text over the picture without Dear ImGui: a line in the corner, and the list of keys in the middle.

Letters are Pillow's own (Aileron, public domain under CC0), rasterised for the size of the screen's letters.
"""

from collections.abc import Callable, Hashable, Sequence
from functools import lru_cache

import moderngl
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from player.gl.context import Context
from player.gl.shader import compile_program, uniform
from player.window.actions import KeyGroup
from player.window.help import mouse_rows, rows

UNIT = 7  # texture unit, away from those of the avatar
PLATE, INK, KEY, TITLE = (0, 0, 0, 140), (255, 255, 255, 255), (255, 204, 51, 255), (150, 190, 240, 255)
HELP_PLATE = (18, 20, 24, 248)
# letters' heights between lines, and round the text
SPACING, PADDING = 1.35, 0.25

Block = tuple[str, Sequence[tuple[str, str]]]  # a heading, keys and what they do


@lru_cache(maxsize=8)
def font(height: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Letters so many pixels high, from below to above; a bitmap font where Pillow was built without FreeType."""
    return ImageFont.load_default(max(height, 6))


class TextPlate:
    """A picture of text in a window. It is painted and uploaded anew only when what it says changes."""

    def __init__(self, context: Context):
        context.make_current()
        self.context = context
        self.program = compile_program(context.gl, "text.vert", "text.frag")
        uniform(self.program, "plate").value = UNIT
        self.array = context.gl.vertex_array(self.program, [])
        self.texture: moderngl.Texture | None = None
        self.shown: Hashable = None

    def line(self, text: str, size: tuple[int, int], letter: float) -> None:
        """Draw a line in the lower left corner of the window of `size` pixels."""
        key = (text, size[0], letter)
        if key != self.shown:
            self._upload(key, line_image(text, size[0], round(letter)))
        self._draw(0, 0, size)

    def keys(self, groups: Sequence[KeyGroup], size: tuple[int, int], letter: float) -> None:
        """Draw the list of keys in the middle of the window."""
        key = (tuple(groups), size, letter)
        if key != self.shown:
            self._upload(key, keys_image(groups, size, round(letter)))
        assert self.texture is not None
        width, height = self.texture.size
        self._draw(max(size[0] - width, 0) // 2, (size[1] - height) // 2, size)

    def _draw(self, left: int, bottom: int, size: tuple[int, int]) -> None:
        """Draw into the framebuffer in use."""
        gl = self.context.gl
        assert self.texture is not None
        width, height = self.texture.size
        uniform(self.program, "rectangle").value = (
            2 * left / size[0] - 1,
            2 * bottom / size[1] - 1,
            2 * (left + width) / size[0] - 1,
            2 * (bottom + height) / size[1] - 1,
        )
        self.texture.use(UNIT)
        gl.enable_only(moderngl.BLEND)
        gl.blend_func = (moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA)
        self.array.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _upload(self, key: Hashable, image: Image.Image) -> None:
        pixels = np.asarray(image.convert("RGBa"))
        if self.texture is None or self.texture.size != image.size:
            if self.texture is not None:
                self.texture.release()
            self.texture = self.context.gl.texture(image.size, 4)
            self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.texture.write(np.ascontiguousarray(pixels))
        self.shown = key

    def release(self) -> None:
        self.context.make_current()
        for thing in (self.array, self.program, self.texture):
            if thing is not None:
                thing.release()
        self.texture = None


def line_image(text: str, width: int, letter: int) -> Image.Image:
    """A line of text on a dark plate; what is wider than the window loses its middle."""
    letters, pad = font(letter), max(round(PADDING * letter), 1)
    text = shortened(text, lambda cut: letters.getlength(cut) <= width - 2 * pad)
    size = int(letters.getlength(text)) + 2 * pad + 1, round(SPACING * letter) + pad
    image = Image.new("RGBA", size, PLATE)
    ImageDraw.Draw(image).text((pad, size[1] // 2), text, fill=INK, font=letters, anchor="lm")
    return image


def keys_image(groups: Sequence[KeyGroup], size: tuple[int, int], letter: int) -> Image.Image:
    """Keys and what they do, under headings, in as many columns as fit a window of `size`; smaller where it must be."""
    blocks = [(group.title, rows(group)) for group in groups] + [("Mouse", mouse_rows(groups))]
    for height in range(letter, 7, -1):
        for count in (1, 2, 3, 4):
            image = _in_columns(in_columns(blocks, count), height)
            if image.width <= 0.96 * size[0] and image.height <= 0.96 * size[1]:
                return image
    return _in_columns([blocks], 8)


def in_columns(blocks: Sequence[Block], count: int) -> list[list[Block]]:
    """Blocks in at most so many columns, in order and as even as can be without breaking one."""
    for high in range(sum(len(lines) + 2 for _, lines in blocks) + 1):
        columns, free = [], 0
        for block in blocks:
            lines = len(block[1]) + 2
            if lines > free:
                columns.append([])
                free = high
            columns[-1].append(block)
            free -= lines
        if len(columns) <= count and free >= 0 and all(_lines(column) <= high for column in columns):
            return columns
    return [list(blocks)]


def _lines(column: Sequence[Block]) -> int:
    """Lines that a column takes: a heading and an empty line a block."""
    return sum(len(lines) + 2 for _, lines in column)


def _in_columns(columns: Sequence[Sequence[Block]], letter: int) -> Image.Image:
    letters, row, pad = font(letter), round(SPACING * letter), round(1.2 * letter)
    cells = [cell for column in columns for _, lines in column for cell in lines]
    key = max(letters.getlength(left) for left, _ in cells) + letter
    wide = key + max(letters.getlength(right) for _, right in cells) + 2 * letter
    high = max(_lines(column) for column in columns) - 1
    image = Image.new("RGBA", (round(len(columns) * wide - 2 * letter) + 2 * pad, high * row + 2 * pad), HELP_PLATE)
    draw = ImageDraw.Draw(image)
    for number, column in enumerate(columns):
        x, y = pad + wide * number, pad + 0.5 * row
        for title, lines in column:
            draw.text((x, y), title, fill=TITLE, font=letters, anchor="lm")
            for left, right in lines:
                y += row
                draw.text((x, y), left, fill=KEY, font=letters, anchor="lm")
                draw.text((x + key, y), right, fill=INK, font=letters, anchor="lm")
            y += 2 * row
    return image


def shortened(text: str, fits: Callable[[str], bool]) -> str:
    """A text, or as much of its beginning and, twice as much, of its end as fits, with dots for its middle."""
    cut = text
    for kept in range(len(text) - 1, 1, -1):
        if fits(cut):
            break
        start = kept // 3
        cut = f"{text[:start]}...{text[len(text) - (kept - start) :]}"
    return cut
