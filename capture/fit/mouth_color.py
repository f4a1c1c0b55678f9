"""What color teeth, gums and tongue have in the frames of a film in which the mouth is open, beside the skin's.

Between the lips is what is dark, what is red and what is white. The latter two are divided by blue over red, where
their distribution has two sides (Otsu 1979), whatever the light's color. Of each the lighter half counts: the rest is
in the shade of the lips, or a mixture.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array
from PIL import Image, ImageDraw

from capture.fit.face_film import USED

# numbers of the points round the opening between the lips, in order; of a lower lid and the corner of the mouth below
# it, between which is a cheek, and the radius of a disc there as a share of that way
OPENING, CHEEKS, DISC = (60, 61, 62, 63, 64, 65, 66, 67), ((41, 48), (46, 54)), 0.15
# the opening is drawn together by so much: lips are no inside
WITHIN = 0.8
# brightness beside the skin's below which it is dark; how much bluer teeth are than what is red; the fewest pixels
DARK, BLUER, FEWEST = 0.3, 1.2, 30


def mouth_colors(
    shots: Iterable[tuple[UInt8[Array, "height width 3"], Float[Array, "points 2"]]],
) -> tuple[Float[Array, "3"] | None, Float[Array, "3"] | None]:
    """Colors of teeth and of what is red over the color of the cheeks, sRGB, of pictures with the pixels of USED; None
    where too little of it is seen."""
    inside, skin = [], []
    for picture, pixels in shots:
        at = lambda numbers: pixels[[USED.index(number) for number in numbers]]
        loop = at(OPENING)
        loop = loop.mean(0) + WITHIN * (loop - loop.mean(0))
        inside.append(picture[_within(picture, loop)])
        for ends in map(at, CHEEKS):
            angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
            disc = DISC * np.linalg.norm(ends[0] - ends[1]) * np.stack([np.cos(angle), np.sin(angle)], 1)
            skin.append(picture[_within(picture, ends.mean(0) + disc)])
    if not sum(map(len, skin)):
        return None, None
    beside = np.concatenate(inside) / np.maximum(np.median(np.concatenate(skin), 0), 1.0)
    beside = beside[beside.mean(1) > DARK]
    if len(beside) < FEWEST:
        return None, None
    blue = np.log(np.maximum(beside[:, 2], 1e-3) / np.maximum(beside[:, 0], 1e-3))
    white = blue > _divide(blue)
    if white.all() or not white.any() or np.median(blue[white]) - np.median(blue[~white]) < np.log(BLUER):
        return None, _lighter(beside)
    return _lighter(beside[white]), _lighter(beside[~white])


def _within(picture: UInt8[Array, "height width 3"], loop: Float[Array, "n 2"]) -> Bool[Array, "height width"]:
    mask = Image.new("L", picture.shape[1::-1])
    ImageDraw.Draw(mask).polygon([(x, y) for x, y in loop.tolist()], fill=1)
    return np.asarray(mask) > 0


def _lighter(colors: Float[Array, "n 3"]) -> Float[Array, "3"] | None:
    """The color of the lighter half; None: there are too few."""
    light = colors.mean(1)
    return np.median(colors[light >= np.median(light)], 0) if len(colors) >= FEWEST else None


def _divide(values: Float[Array, "n"]) -> float:
    """The value between two classes with the most variance between them (Otsu 1979)."""
    rising, count = np.sort(values), np.arange(1, len(values))
    below = np.cumsum(rising)[:-1]
    apart = below / count - (rising.sum() - below) / (len(rising) - count)
    k = int((count * (len(rising) - count) * apart**2).argmax())
    return float(0.5 * (rising[k] + rising[k + 1]))
