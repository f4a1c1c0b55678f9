"""What the texture of an eye has lost, where the videos show it in a few pixels.

An iris that is ten pixels wide in a phone's picture comes out of the texture grey: pupil, iris and white are averaged
into each other. What an eye is made of is known: a pupil in a disc in a white. So the colors, the place and the size of
these are sought with which a drawing B looks like the texture between the lids when it is blurred by a Gaussian G, and
what the blur has taken is added to the ball's picture:

    picture + B - G * B

Where the texture is sharp, G does nothing, and neither does this.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy import ndimage

from avatar.baked_avatar import Level
from bake.face.features import PIXEL, FrontPicture, front_picture
from geometry.closest import beyond_loop

# metres beside the lids' edge that blur mixes with them, and beyond the opening up to which is drawn
LIDS, BESIDE = 0.001, 0.004
# metres: deviations of Gaussians that are tried, radii of an iris, and how far its middle lies from the ball's
BLURS, RADII, ASIDE = (0.0002, 0.0004, 0.0006, 0.0008, 0.001, 0.0013), (0.0054, 0.006, 0.0066), 0.002
# steps of that, first and then round what was best
STEPS = (0.001, 0.0005)
# the pupil's share of an iris' radius in a room; sRGB of a pupil, and what iris and white are before anything was seen
PUPIL, BLACK = 0.4, 0.04
EXPECTED = np.array([[0.22, 0.15, 0.11], [0.70, 0.66, 0.64]])
# share of the pixels that this counts as; of their variance a drawing explains at least so much, and its white is so
# much brighter than its iris
PRIOR, EXPLAINED, WHITER = 0.03, 0.3, 0.08


class EyeDrawing(NamedTuple):
    """What a drawing adds to the picture of a ball, and where its iris is."""

    added: Float[Array, "height width 3"]  # row 0 on top, pixels of `picture`
    picture: FrontPicture
    aside: Float[Array, "2"]  # how far the iris' middle lies to the left of the ball's and above it, metres

    def axis(self, radius: float) -> Float[Array, "3"]:
        """Where an eye looks at rest whose ball has that radius (metres)."""
        across = self.aside / radius
        return np.append(across, np.sqrt(1 - (across**2).sum()))

    def at(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """What is added at canonical places; nothing beyond the picture."""
        where = np.stack([self.picture.row(points[:, 1]), self.picture.column(points[:, 0])])
        return np.stack([ndimage.map_coordinates(self.added[..., c], where, order=1) for c in range(3)], 1)


class _FilmedEye(NamedTuple):
    """An eye of a level; distances are metres from the ball's middle."""

    picture: FrontPicture
    x: Float[Array, "width"]
    y: Float[Array, "height 1"]
    counts: Int[Array, "n"]  # pixels that are to look alike


class _Drawn(NamedTuple):
    left: float  # share of the picture's variance
    aside: Float[Array, "2"]
    colors: Float[Array, "2 3"]  # iris and white
    added: Float[Array, "height width 3"]


def draw_eyes(
    level: Level, loops: Sequence[Float[Array, "_ 3"]], centers: Float[Array, "2 3"]
) -> list[EyeDrawing] | None:
    """The drawings that look like both eyes of a level whose balls are not yet cut away, alike in size and blur; None:
    none do.

    `loops` go along the edges of the lids, `centers` are the balls'.
    """
    eyes = [_seen(level, loop, center) for loop, center in zip(loops, centers)]
    if min(len(eye.counts) for eye in eyes) == 0:
        return None
    around = np.arange(-ASIDE, ASIDE + 1e-9, STEPS[0])
    near = np.array([-STEPS[1], 0, STEPS[1]])
    best = lambda some: min(some, key=lambda one: one.left)
    places = [best(_drawn(eye, BLURS[2], RADII[1], at) for at in product(around, around)).aside for eye in eyes]
    pairs = [
        [best(_drawn(eye, blur, radius, at + step) for step in product(near, near)) for eye, at in zip(eyes, places)]
        for blur, radius in product(BLURS, RADII)
    ]
    found = min(pairs, key=lambda pair: pair[0].left + pair[1].left)
    for one in found:
        iris, white = one.colors.mean(1)
        if one.left > 1 - EXPLAINED or white < iris + WHITER:
            return None
    return [EyeDrawing(one.added, eye.picture, one.aside) for one, eye in zip(found, eyes)]


def _seen(level: Level, loop: Float[Array, "n 3"], center: Float[Array, "3"]) -> _FilmedEye:
    low, high = loop.min(0) - BESIDE, loop.max(0) + BESIDE
    picture = front_picture(level, low, high)
    height, width = picture.light.shape
    x = low[0] + PIXEL * np.arange(width) - center[0]
    y = low[1] + PIXEL * np.arange(height)[::-1, None] - center[1]
    places = np.stack(np.broadcast_arrays(x, y), -1).reshape(-1, 2) + center[:2]
    between = beyond_loop(places, loop[:, :2]) < -LIDS
    return _FilmedEye(picture, x, y, np.flatnonzero(between & ~np.isnan(picture.light.ravel())))


def _drawn(eye: _FilmedEye, blur: float, radius: float, aside: Sequence[float] | Array) -> _Drawn:
    """The drawing in the colors that look most like an eye."""
    away = np.hypot(eye.x - aside[0], eye.y - aside[1])
    disc, pupil = (np.clip(0.5 - (away - edge) / PIXEL, 0, 1) for edge in (radius, PUPIL * radius))
    parts = np.stack([disc - pupil, 1 - disc, BLACK * pupil], -1)
    blurred = ndimage.gaussian_filter(parts, (blur / PIXEL, blur / PIXEL, 0), mode="nearest")
    shown = blurred.reshape(-1, 3)[eye.counts]
    seen = eye.picture.colors.reshape(-1, 3)[eye.counts]
    prior = np.sqrt(PRIOR * len(seen)) * np.eye(2)
    system = np.concatenate([shown[:, :2], prior])
    wanted = np.concatenate([seen - shown[:, 2:], prior @ EXPECTED])
    colors = np.linalg.lstsq(system, wanted, rcond=None)[0].clip(0, 1)
    left = ((system @ colors - wanted) ** 2).sum() / ((seen - seen.mean(0)) ** 2).sum()
    taken = parts - blurred
    return _Drawn(float(left), np.array(aside), colors, taken[..., :2] @ colors + taken[..., 2:])
