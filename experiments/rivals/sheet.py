"""One sheet of pictures: truth, ours, the rivals; face, left hand and the whole person in a new pose, 512 px each."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from experiments.rivals.page import TITLES
from files.picture import read_picture
from files.whole import whole_file

SIDE, LABEL, GROUND, INK = 512, 34, 24, (235, 235, 235)
VIEWS = ("head", "hand_left", "body")
COLORS = 256


def write_sheet(folder: Path, out: Path) -> None:
    """The pictures that judging left in a folder of rows: a column a system, a row a view."""
    systems = [name for name in TITLES if (folder / f"{name}_body.png").exists()]
    if not systems:
        return
    columns = ["truth", *systems]
    page = Image.new("RGB", (len(columns) * SIDE, LABEL + len(VIEWS) * SIDE), (GROUND,) * 3)
    pen = ImageDraw.Draw(page)
    for column, name in enumerate(columns):
        pen.text((column * SIDE + 10, 6), TITLES.get(name, name), INK, ImageFont.load_default(20))
        for row, view in enumerate(VIEWS):
            file = f"{systems[0]}_{view}_truth.png" if name == "truth" else f"{name}_{view}.png"
            tile = Image.fromarray(np.asarray(read_picture(folder / file)))
            page.paste(tile, (column * SIDE, LABEL + row * SIDE))
    with whole_file(out) as file:
        page.quantize(COLORS).save(file, "PNG", optimize=True)
