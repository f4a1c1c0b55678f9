"""Frames moved onto the texture that all of them agree on, where poses were estimated.

A pose that is a degree off shows print some millimetres beside its place, another way in each frame, and the solved
atlas is their blur. Each frame is compared with the atlas drawn in its own pose, and smooth shifts of its pixels that
make the two meet are found by Lucas and Kanade's least squares (1981) over Gaussian windows, from coarse to fine. That
is done several times, with narrower windows each time: first limbs move as a whole, in the end an eye by itself, which
a surface some millimetres off in depth shows elsewhere in every frame.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array
from scipy.ndimage import map_coordinates

from bake.texture.texture_solve import Equations
from command.workers import on_all_cores

# metres: standard deviations of the windows that move as one, time after time, but so many pixels at least; farthest
# shift, which is no farther than two windows
WINDOWS, NARROWEST, FARTHEST = (0.025, 0.012, 0.005), 4.0, 0.02
# share of the window's own pixels, that a shift of none counts as much as: where there is no print nothing is moved
STAY = 1e-4
# blur of both pictures in turn, pixels at least and shares of the window: what is farther off than that is not found;
# steps at each
BLURS, STEPS = ((3.0, 0.25), (1.0, 0.08)), 2
# pixels of a blur that are one of the picture it is done in
COARSE = 1.5
# where a Gaussian's tails are cut, in standard deviations
TAIL = 2.5


class ShiftWindow(NamedTuple):
    """What moves as one, in pixels of a picture that may be k x k of the video's."""

    wide: float  # standard deviation
    farthest: float
    blur: float
    stay: float  # STAY, times k x k


class ShownVideo(NamedTuple):
    """Where the rows of a video's equations come from."""

    frames: list[Integer[Array, "pixels"]]  # each frame's pixels, whose rows follow each other
    width: int  # pixels of its pictures
    pixel: float  # metres on the person


def aligned_frames(
    equations: Equations, video: ShownVideo, given: Float[Array, "texels 3"], change: Float[Array, "texels 3"],
    window: float,
) -> tuple[Equations, float]:  # fmt: skip
    """What the pixels show, moved onto the atlas `given + change` as each frame sees it, `window` (metres) as one; the
    shifts' mean length, metres."""
    wide = max(window / video.pixel, NARROWEST)
    wanted = equations.wanted.copy()
    root = np.asarray(equations.matrix.sum(1)).ravel()
    ends = np.cumsum([0, *map(len, video.frames)])

    def moved(frame: int) -> float:
        """What one frame shows, moved; the sum of its shifts, pixels."""
        pixels, rows = video.frames[frame], slice(ends[frame], ends[frame + 1])
        if not len(pixels):
            return 0.0
        matrix, weight = equations.matrix[rows], root[rows, None]
        before = (matrix @ given) / weight
        # the part of the picture that holds them
        row, column = np.divmod(pixels, video.width)
        row, column = row - row.min(), column - column.min()
        known = np.zeros((row.max() + 1, column.max() + 1), bool)
        known[row, column] = True
        drawn, shown = np.zeros((2, *known.shape, 3), np.float32)
        drawn[row, column] = before + (matrix @ change) / weight
        shown[row, column] = before + equations.wanted[rows] / weight
        shift = frame_shift(drawn, shown, known, wide, min(FARTHEST / video.pixel, 2 * wide))
        there, whole = moved_colors(shown, known, shift)
        colors = np.where(whole[..., None], there, shown)[row, column]
        wanted[rows] = (colors - before) * weight
        return float(np.hypot(*shift[known].T).sum(dtype=np.float64))

    total = sum(on_all_cores(moved, range(len(video.frames))))
    return equations._replace(wanted=wanted), video.pixel * total / max(int(ends[-1]), 1)


def frame_shift(
    drawn: Float[Array, "height width 3"], frame: Float[Array, "height width 3"], known: Bool[Array, "height width"],
    window: float, farthest: float,
) -> Float[Array, "height width 2"]:  # fmt: skip
    """How far beside each pixel (rows, columns) the frame shows what the texture shows there.

    `drawn` and `frame` hold colors, [0, 1], where `known`; `window` moves as one, by `farthest` at most, pixels.
    """
    shift = np.zeros((*known.shape, 2), np.float32)
    for least, share in BLURS:
        blur = max(least, share * window)
        k = max(int(blur / COARSE), 1)
        part = shrunk(known[..., None].astype(np.float32), k)
        model, ours = (shrunk(np.where(known[..., None], one, 0), k) / np.maximum(part, 1e-6) for one in (drawn, frame))
        fewer = ShiftWindow(window / k, farthest / k, blur / k, STAY * k**2)
        shift = k * grown(shifted(model, ours, part[..., 0] > 0.5, shrunk(shift, k) / k, fewer), k, known.shape)
    return shift


def shifted(
    drawn: Float[Array, "height width 3"], frame: Float[Array, "height width 3"], known: Bool[Array, "height width"],
    shift: Float[Array, "height width 2"], window: ShiftWindow,
) -> Float[Array, "height width 2"]:  # fmt: skip
    """`frame_shift` from a first guess, of both pictures blurred; the guess where they are a single row or column,
    whose slope across it is unknown."""
    if min(known.shape) < 2:
        return shift
    blur = window.blur
    model, inside = _blurred(drawn, known, blur), _gaussian(known.astype(np.float32), blur)
    ours = _blurred(frame, known, blur)
    sure = (inside > 0.9) & known
    read = np.concatenate([ours, *np.gradient(ours, axis=(0, 1)), sure[..., None]], -1)
    # the rest of the picture counts nothing
    where = np.nonzero(sure)
    wanted, places, sums = model[where], np.stack(where, -1).astype(np.float32), np.zeros((*known.shape, 5), np.float32)
    for _ in range(STEPS):
        there = _read(read, places + shift[where])
        left, gy, gx, weight = wanted - there[:, :3], there[:, 3:6], there[:, 6:9], there[:, 9]
        pairs = ((gy, gy), (gy, gx), (gx, gx), (gy, left), (gx, left))
        sums[where] = np.stack([np.einsum("nc,nc->n", a, b) * weight for a, b in pairs], -1)
        yy, yx, xx, yl, xl = np.moveaxis(_gaussian(sums, window.wide), -1, 0)
        yy, xx = yy + window.stay, xx + window.stay
        determinant = yy * xx - yx * yx
        shift = shift + np.stack([(xx * yl - yx * xl) / determinant, (yy * xl - yx * yl) / determinant], -1)
        length = np.hypot(shift[..., :1], shift[..., 1:])
        shift *= np.minimum(1, window.farthest / np.maximum(length, 1e-9))
    return shift


def moved_colors(
    frame: Float[Array, "height width 3"], known: Bool[Array, "height width"], shift: Float[Array, "height width 2"]
) -> tuple[Float[Array, "height width 3"], Bool[Array, "height width"]]:
    """The frame's colors beside each pixel, and where all of what they are read from is known."""
    where = np.nonzero(known)
    read = np.concatenate([frame, known[..., None]], -1, dtype=np.float32)
    found, colors, whole = _read(read, np.stack(where, -1) + shift[where]), np.zeros_like(frame), np.zeros_like(known)
    colors[where], whole[where] = found[:, :3], found[:, 3] > 0.999
    return colors, whole


def shrunk(image: Float[Array, "height width channels"], k: int) -> Float[Array, "rows columns channels"]:
    """The mean of each k x k pixels, at the ends of those that are left."""
    if k == 1:
        return image
    for axis in range(2):
        starts = np.arange(0, image.shape[axis], k)
        count = np.minimum(image.shape[axis] - starts, k).reshape([-1 if i == axis else 1 for i in range(3)])
        image = np.add.reduceat(image, starts, axis) / count
    return image


def grown(image: Float[Array, "rows columns channels"], k: int, shape: tuple[int, ...]) -> Array:
    """Pixels of k x k read bilinearly for each of `shape` rows and columns."""
    if k == 1:
        return image
    places = np.stack(np.meshgrid(*((np.arange(n) + 0.5) / k - 0.5 for n in shape), indexing="ij"), -1)
    at = np.moveaxis(places, -1, 0)
    return np.stack([map_coordinates(image[..., c], at, order=1, mode="nearest") for c in range(image.shape[-1])], -1)


def _blurred(
    image: Float[Array, "height width 3"], known: Bool[Array, "height width"], blur: float
) -> Float[Array, "height width 3"]:
    share = np.maximum(_gaussian(known.astype(np.float32), blur), 1e-6)
    return _gaussian(np.where(known[..., None], image, 0).astype(np.float32), blur) / share[..., None]


def _gaussian(image: Float[Array, "height width *channels"], deviation: float) -> Array:
    """Blurred; beyond its edges the picture goes on as in a mirror."""
    size = 2 * int(TAIL * deviation + 0.5) + 1
    return cv2.GaussianBlur(image, (size, size), deviation, borderType=cv2.BORDER_REFLECT)


def _read(
    image: Float[Array, "height width channels"], places: Float[Array, "places 2"]
) -> Float[Array, "places channels"]:
    """Bilinear reads at (row, column); 0 outside."""
    last = np.array(image.shape[:2]) - 1
    first = np.clip(np.floor(places), 0, np.maximum(last - 1, 0)).astype(np.intp)
    down, across = (places - first).astype(np.float32).T[..., None]
    at, flat = first @ [image.shape[1], 1], image.reshape(-1, image.shape[-1])
    right, below = np.minimum(last[::-1], 1) * [1, image.shape[1]]

    def along(row: Integer[Array, "places"]) -> Float[Array, "places channels"]:
        left = flat.take(row, 0)
        return left + across * (flat.take(row + right, 0) - left)

    top = along(at)
    top += down * (along(at + below) - top)
    top[((places < 0) | (places > last)).any(1)] = 0
    return top
