"""Contact sheets: truth | field | baked of one person in novel poses with close-ups.

python -m bench.report.contact RUN AVATAR CAPTURE -o contact.png
"""

import argparse
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from avatar.texture import bytes_of
from bench.field.drawer import Drawer
from bench.score.metrics import rectangle
from capture.folder import read_capture_facts
from capture.held_out import HeldOutView, read_held_out
from files.whole import whole_file

WIDTH = 1600  # pixels of a sheet
# bytes of a sheet's PNG; a larger one is scaled down until it fits
LARGEST = 1_500_000
LABEL = 22  # pixels of a line of text
GROUND = (24, 24, 26)
INK = (225, 225, 225)
VIEW_TITLE = {"body": "", "head": "face", "hand_left": "left hand", "hand_right": "right hand"}
# pictures of field and avatar take 2 x 2 samples a pixel: the truth is smoothed as well
SAMPLES = 2


def spread_poses(views: Sequence[HeldOutView], view: str, count: int) -> list[HeldOutView]:
    """`count` pictures of one kind, evenly spread over the set."""
    those = [v for v in views if v.view == view]
    chosen = np.unique(np.linspace(0, len(those) - 1, count).round().astype(int)) if those else []
    return [those[i] for i in chosen]


def contact_sheet(run: Path | None, avatar: Path | None, capture: Path, out: Path) -> None:
    """Write the sheet of one person: rows of two poses, each truth | field | baked; bodies, face, both hands."""
    sources = {"field": Drawer(run) if run else None, "baked": Drawer(avatar) if avatar else None}
    drawers = {name: drawer for name, drawer in sources.items() if drawer is not None}
    try:
        facts = read_capture_facts(capture)
        views = read_held_out(capture, "novel_pose")
        rows, titles = [], []
        for kind, count in (("body", 4), ("head", 4), ("hand_left", 2), ("hand_right", 2)):
            for view in spread_poses(views, kind, count):
                tiles = [view.image()]
                tiles += [d.draw(view.axis_angle, view.root, view.camera, SAMPLES).color for d in drawers.values()]
                where = square_about(view)
                rows.append([bytes_of(tile[where]) for tile in tiles])
                names = ["truth", *drawers]
                titles.append([f"{VIEW_TITLE[kind]} {name}, pose {view.pose_index}".strip() for name in names])
        heading = f"{facts.get('subject', capture.name)}, {facts.get('light', '?')} light, novel poses"
        save_sheet(out, sheet(rows, titles, heading, columns=2))
    finally:
        for drawer in drawers.values():
            drawer.release()


def square_about(view: HeldOutView) -> tuple[slice, slice]:
    """The whole close-up; of a body view the square round the person, a little wider."""
    width, height = view.camera.size
    where = rectangle(view.mask()) if view.view == "body" else None
    if where is None:
        return slice(0, height), slice(0, width)
    (top, bottom), (left, right) = ((side.start, side.stop - 1) for side in where)
    side = min(int(1.06 * max(bottom - top, right - left)) + 4, height, width)
    top = int(np.clip((top + bottom - side) // 2, 0, height - side))
    left = int(np.clip((left + right - side) // 2, 0, width - side))
    return slice(top, top + side), slice(left, left + side)


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


def main(argv: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.report.contact", description="Contact sheet of a person.")
    parser.add_argument("run", type=Path)
    parser.add_argument("avatar", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("-o", dest="out", type=Path, required=True, metavar="SHEET.png")
    options = parser.parse_args(argv)
    contact_sheet(options.run, options.avatar, options.capture, options.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
