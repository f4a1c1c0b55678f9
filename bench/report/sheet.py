"""Sheets of pictures side by side under their titles."""

import io
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from files.whole import whole_file

WIDTH = 1600  # pixels of a sheet
# bytes of a sheet's PNG; a larger one is scaled down until it fits
LARGEST = 1_500_000
LABEL = 22  # pixels of a line of text
GROUND = (24, 24, 26)
INK = (225, 225, 225)


def sheet(rows: list[list[np.ndarray]], titles: list[list[str]], heading: str, *, columns: int) -> Image.Image:
    """Groups of tiles (each row of `rows`) laid out `columns` groups to a line, each tile under its title."""
    widest = max(len(row) for row in rows)
    gap = 4
    side = (WIDTH - gap * (columns * widest + columns)) // (columns * widest)
    lines = -(-len(rows) // columns)
    page = Image.new("RGB", (WIDTH, LABEL + lines * (side + LABEL + gap) + gap), GROUND)
    pen = ImageDraw.Draw(page)
    pen.text((8, 2), heading, INK, ImageFont.load_default(15))
    for number, (tiles, names) in enumerate(zip(rows, titles)):
        line, group = divmod(number, columns)
        top = LABEL + line * (side + LABEL + gap)
        for i, (tile, name) in enumerate(zip(tiles, names)):
            left = gap + group * (widest * (side + gap) + gap) + i * (side + gap)
            picture = Image.fromarray(tile)
            scale = side / max(picture.size)
            size = (max(1, round(picture.width * scale)), max(1, round(picture.height * scale)))
            picture = picture.resize(size, Image.Resampling.LANCZOS)
            page.paste(picture, (left + (side - size[0]) // 2, top + LABEL + (side - size[1]) // 2))
            pen.text((left + 2, top + 4), name, INK, fitting_font(name, side - 2))
    return page


def fitting_font(text: str, width: int) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    """The largest font, of 12 to 7 pixels, that sets a title within its tile's width."""
    fonts = [ImageFont.load_default(size) for size in range(12, 6, -1)]
    return next((font for font in fonts if font.getlength(text) <= width), fonts[-1])


def save_sheet(out: Path, page: Image.Image) -> None:
    """Write a PNG of at most LARGEST bytes."""
    while True:
        buffer = io.BytesIO()
        page.save(buffer, "PNG", optimize=True)
        if buffer.tell() <= LARGEST or page.width < 400:
            break
        shrink = max(0.7, 0.97 * (LARGEST / buffer.tell()) ** 0.5)
        page = page.resize((int(page.width * shrink), int(page.height * shrink)), Image.Resampling.LANCZOS)
    with whole_file(out) as file:
        file.write(buffer.getvalue())
