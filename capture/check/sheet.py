"""Contact sheet: the outline of the posed template over frames of each video, to be looked at."""

import numpy as np
from jaxtyping import Bool, Int, UInt8
from numpy import ndarray as Array
from PIL import Image, ImageDraw, ImageOps

from avatar.skeleton import PARTS
from geometry.cells import rim_of

TEMPLATE = np.array([[255, 210, 0], [0, 220, 255], [80, 255, 80], [255, 90, 255]], np.uint8)  # one per part
MASK = np.array([255, 40, 40], np.uint8)


def overlay(
    image: UInt8[Array, "height width 3"], mask: Bool[Array, "height width"], parts: Int[Array, "y x"], step: int
) -> UInt8[Array, "y x 3"]:
    """One frame, darkened outside the mask, with the mask's outline in red and the template's parts edged.

    `parts` holds the part at every `step`-th pixel, -1 where there is none; the picture is of that size.
    """
    begin = step // 2
    picture, mask = (a[begin::step, begin::step][: parts.shape[0], : parts.shape[1]] for a in (image, mask))
    picture = np.where(mask[..., None], picture, picture // 2)
    picture[rim_of(mask)] = MASK
    for part in range(len(PARTS)):
        picture[rim_of(parts == part)] = TEMPLATE[part]
    return picture


def contact_sheet(rows: list[list[tuple[str, UInt8[Array, "height width 3"]]]], side: int = 320) -> Image.Image:
    """Pictures in rows, each with its caption above."""
    line = 16
    fitted = [
        [(caption, ImageOps.contain(Image.fromarray(picture), (side, side))) for caption, picture in row]
        for row in rows
    ]
    heights = [line + max(image.height for _, image in row) for row in fitted]
    sheet = Image.new("RGB", (max(map(len, rows)) * side, sum(heights)))
    draw = ImageDraw.Draw(sheet)
    for row, top in zip(fitted, np.cumsum([0, *heights[:-1]]).tolist()):
        for c, (caption, image) in enumerate(row):
            sheet.paste(image, (c * side, top + line))
            draw.text((c * side + 3, top + 2), caption, fill=(255, 255, 255))
    return sheet
