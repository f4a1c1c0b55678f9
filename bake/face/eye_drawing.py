"""What the texture of an eye has lost, where the videos show it in a few pixels.

An iris that is ten pixels wide in a phone's picture comes out of the texture grey: pupil, iris, white and lids are
averaged into each other. What an eye is made of is known: a pupil in a disc in a white, between two lids and under
lashes. So the colors, places and sizes of these are sought with which a drawing B of both eyes, alike but for left and
right, looks like the texture when it is blurred by a Gaussian G, and between its lids what the blur has taken is added
to the ball's picture:

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
from bake.face.blink import edges_of_lids
from bake.face.features import PIXEL, FrontPicture, front_picture
from bake.face.lips import by_x
from geometry.closest import beyond_loop

# metres beside the lids' edge: up to there blur mixes the ball with them, and pixels are to look alike; beyond the
# opening up to which is drawn; height of lashes; by which an opening is cut larger, or lids would have white edges
LIDS, ALIKE, BESIDE, LASHES, LARGER = 0.001, 0.0015, 0.004, 0.0015, 0.0004
# sRGB of a pupil, and what iris and white are before anything was seen; lashes are so much darker than skin
BLACK, EXPECTED, DARK = 0.04, np.array([[0.28, 0.23, 0.20], [0.70, 0.66, 0.64]]), 0.3
# share of the pixels that this counts as; of their variance between the lids a drawing explains so much of each eye at
# least, and its white is so much brighter than its iris
PRIOR, EXPLAINED, WHITER = 0.01, 0.3, 0.08
# nothing that is drawn exceeds its white by more than this factor
BRIGHTEST = 1.05
# metres by which places are tried, and how often all that is tried is gone through
STEP, ROUNDS = 0.0005, 3


class EyeDrawing(NamedTuple):
    """What a drawing adds to the picture of a ball, where its iris is, and where its lids end."""

    added: Float[Array, "height width 3"]  # row 0 on top, pixels of `picture`
    picture: FrontPicture
    aside: Float[Array, "2"]  # how far the iris' middle lies to the left of the ball's and above it, metres
    opening: Float[Array, "n 2"]  # round it, canonical, metres

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
    upper: Float[Array, "width"]  # where the template's lids end
    lower: Float[Array, "width"]
    counts: Int[Array, "n"]  # pixels that are to look alike
    between: Int[Array, "m"]  # those of them between the template's lids
    outwards: float  # 1 where the eye's outer corner is on its left


class _Shape(NamedTuple):
    """What both drawings have in common, in metres but for the pupil's share of the iris' radius."""

    apart: float = 0.0  # irises' middles outwards from the balls', and both to their left
    aside: float = 0.0
    over: float = 0.0  # over the middle of the opening
    upper: float = 0.0  # pictured lids above the template's
    lower: float = 0.0
    radius: float = 0.006
    pupil: float = 0.4
    blur: float = 0.001


LIDS_OFF, IRIS_OFF = np.arange(-2, 6) * STEP, np.arange(-4, 5) * STEP
# fields of a shape and what is tried for them, one line after the other, ROUNDS times
TRIED: tuple[tuple[tuple[str, ...], tuple[Sequence[float] | Array, ...]], ...] = (
    (("upper", "lower"), (LIDS_OFF, LIDS_OFF)),
    (("apart", "over"), (IRIS_OFF, (-STEP, 0.0, STEP, 2 * STEP))),
    (("aside",), (IRIS_OFF,)),
    (("radius", "pupil"), ((0.0054, 0.006, 0.0066), (0.3, 0.4, 0.5))),
    (("blur",), ((0.0002, 0.0004, 0.0006, 0.0008, 0.001, 0.0013, 0.0016),)),
)


class _Parts(NamedTuple):
    """The share that each part of an eye has in each pixel."""

    shown: Float[Array, "height width 5"]  # between lids: iris, white; skin above, skin below, lashes
    black: Float[Array, "height width"]  # what the pupil shows between lids, sRGB
    ball: Float[Array, "height width 2"]  # iris and white as they are without lids
    pupil: Float[Array, "height width"]

    @property
    def opening(self) -> Float[Array, "height width"]:
        return 1 - self.shown[..., 2:].sum(-1)


class _Drawn(NamedTuple):
    left: float  # sum of squares
    colors: Float[Array, "5 3"]  # sRGB, in the order of _Parts.shown
    parts: list[_Parts]
    blurred: list[Float[Array, "height width 3"]]  # what each drawing looks like


def draw_eyes(
    level: Level, loops: Sequence[Float[Array, "_ 3"]], centers: Float[Array, "2 3"]
) -> list[EyeDrawing] | None:
    """The drawings that look like both eyes of a level whose balls are not yet cut away; None: none do,
    or lids are shut.

    `loops` go along the edges of the template's lids, `centers` are the balls'.
    """
    eyes = [_seen(level, loop, center) for loop, center in zip(loops, centers)]
    if min(len(eye.between) for eye in eyes) == 0:
        return None
    shape = _Shape()
    for _ in range(ROUNDS):
        for names, values in TRIED:
            tried = [shape._replace(**dict(zip(names, some))) for some in product(*values)]
            shape = min(tried, key=lambda one: _drawn(eyes, one).left)
    drawn = _drawn(eyes, shape)
    iris, white = drawn.colors[:2].mean(1)
    if min(parts.opening.max() for parts in drawn.parts) < 1:
        return None
    if white < iris + WHITER or min(map(_explained, eyes, drawn.blurred)) < EXPLAINED:
        return None
    out = []
    for eye, center, parts, blurred in zip(eyes, centers, drawn.parts, drawn.blurred):
        ball = parts.ball @ drawn.colors[:2] + BLACK * parts.pupil[..., None]
        seen = np.nan_to_num(eye.picture.colors)
        added = np.minimum(ball - blurred, np.maximum(BRIGHTEST * drawn.colors[1] - seen, 0))
        opening = center[:2] + _opening(eye, shape)
        out.append(EyeDrawing(parts.opening[..., None] * added, eye.picture, _middle(eye, shape), opening))
    return out


def _seen(level: Level, loop: Float[Array, "n 3"], center: Float[Array, "3"]) -> _FilmedEye:
    low, high = loop.min(0) - BESIDE, loop.max(0) + BESIDE
    picture = front_picture(level, low, high)
    height, width = picture.light.shape
    x = low[0] + PIXEL * np.arange(width) - center[0]
    y = low[1] + PIXEL * np.arange(height)[::-1, None] - center[1]
    edge, of_upper = loop - center, edges_of_lids(loop)
    upper, lower = (np.interp(x, *by_x(edge[some])[:, :2].T) for some in (of_upper, ~of_upper))
    places = np.stack(np.broadcast_arrays(x, y), -1).reshape(-1, 2)
    beyond = np.where(np.isnan(picture.light.ravel()), np.inf, beyond_loop(places, edge[:, :2]))
    counts, between = np.flatnonzero(beyond < ALIKE), np.flatnonzero(beyond < -LIDS)
    return _FilmedEye(picture, x, y, np.maximum(upper, lower), lower, counts, between, float(np.sign(center[0])))


def _middle(eye: _FilmedEye, shape: _Shape) -> Float[Array, "2"]:
    """Where the iris' middle is, from the ball's to the left and upwards, metres."""
    middle = 0.5 * (eye.upper.max() + shape.upper + eye.lower.min() + shape.lower)
    return np.array([eye.outwards * shape.apart + shape.aside, middle + shape.over])


def _opening(eye: _FilmedEye, shape: _Shape) -> Float[Array, "n 2"]:
    """Round what lies between the pictured lids."""
    upper, lower = eye.upper + shape.upper + LARGER, eye.lower + shape.lower - LARGER
    between = upper > lower
    return np.concatenate([np.c_[eye.x, upper][between], np.c_[eye.x, lower][between][::-1]])


def _parts(eye: _FilmedEye, shape: _Shape) -> _Parts:
    beyond = lambda away: np.clip(0.5 + away / PIXEL, 0, 1)
    x, y = _middle(eye, shape)
    away = np.hypot(eye.x - x, eye.y - y)
    pupil = beyond(shape.pupil * shape.radius - away)
    iris = beyond(shape.radius - away) - pupil
    ball = np.stack([iris, 1 - iris - pupil], -1)
    upper = eye.upper + shape.upper
    above, below = beyond(eye.y - upper), beyond(np.minimum(eye.lower + shape.lower, upper) - eye.y)
    lashes = above * beyond(upper + LASHES - eye.y)
    opening = np.clip(1 - above - below, 0, 1)
    skin = np.stack([above - lashes, 1 - above - opening, lashes], -1)
    return _Parts(np.concatenate([opening[..., None] * ball, skin], -1), BLACK * opening * pupil, ball, pupil)


def _drawn(eyes: Sequence[_FilmedEye], shape: _Shape) -> _Drawn:
    """The drawings in the colors that look most like the eyes."""
    sigma, every = shape.blur / PIXEL, [_parts(eye, shape) for eye in eyes]
    shown = [ndimage.gaussian_filter(parts.shown, (sigma, sigma, 0), mode="nearest") for parts in every]
    black = [ndimage.gaussian_filter(parts.black, sigma, mode="nearest")[..., None] for parts in every]
    rows = lambda images: np.concatenate(
        [image.reshape(-1, image.shape[-1])[eye.counts] for image, eye in zip(images, eyes)]
    )
    seen = rows([eye.picture.colors for eye in eyes])
    skin = np.median(seen, 0)
    prior = np.sqrt(PRIOR * len(seen)) * np.eye(5)
    system = np.concatenate([rows(shown), prior])
    wanted = np.concatenate([seen - rows(black), prior @ np.stack([*EXPECTED, skin, skin, DARK * skin])])
    colors = np.linalg.solve(system.T @ system, system.T @ wanted).clip(0, 1)
    left = float(np.square(system @ colors - wanted).sum())
    return _Drawn(left, colors, every, [some @ colors + dark for some, dark in zip(shown, black)])


def _explained(eye: _FilmedEye, blurred: Float[Array, "height width 3"]) -> float:
    """Share of the variance between the lids that is the drawing's."""
    seen, drawn = (image.reshape(-1, 3)[eye.between] for image in (eye.picture.colors, blurred))
    return float(1 - np.square(seen - drawn).sum() / max(np.square(seen - seen.mean(0)).sum(), 1e-9))
