"""Hollows that no silhouette shows, carved from a hull of hair by the colors of the head's video.

Between a curtain of hair and the neck every view's mask is full: the hull fills the hollow. Its front cells would be
hair that shows the neck's colors. Space carving (Kutulakos and Seitz 2000) with the registered template as what lies
behind: a cell on the hull's surface is empty when the views that see it show what the template shows behind it, and
no worse than they agree among themselves. Cells are tried from outside inwards until none is left to carve.

    agreement   e_hair  = mean over views of |I_f(x) - median over views of I(x)|
    behind      e_empty = mean over views of |I_f(x) - c(y_f)|,  y_f the template's point behind x in view f

c(y) is the median of what views show that see y with no hull before it. Where that is not known nothing is carved:
skin that was never seen says nothing.

Where shoulders are not where the template has them, the hull holds cloth, and shine moves over hair with the eye. With
colors that are surely hair's and such that are surely not, a cell is empty too when half of the views that see it show
rather the others, and hair, whatever views agree on, when enough of them show rather hair's.
"""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array
from scipy import ndimage
from scipy.spatial import KDTree

from avatar.camera import Camera, project
from capture.folder import CaptureSubject
from capture.videos import even
from command.workers import on_all_cores
from geometry.rasterise import rasterise

# pixels of a view, at most, along the longer side: a cell of 6 mm is about 4 pixels of 256
SMALL = 128
FRAMES = 40
# out of 1: colors that lie nearer are the same
SAME = 0.05
# out of 1, mean distance from the median: so far apart are no colors of one place; of cells of hair 5 % exceed .034, of
# cells in hollows half exceed .14 (two people)
DISAGREE = 0.08
# the same where poses and cameras were estimated: the body's and the head's video do not meet on a strand
ESTIMATED = 0.11
# share of the views that see a cell: so many must know what lies behind it
KNOWN = 0.5
# views at least that see a cell
SEEN_BY = 3
# cells: a cell is hidden by what lies nearer by more
TOLERANCE = 1.5
ROUNDS = 24
# a distance of colors in [0, 1] that no hair has; colors of either kind to which one is compared, and steps of each
# channel in the table of the answers
UNLIKE, ALIKE, STEPS = 0.06, 8, 32
# the same of one in so many of hair's, where some are others'; how dark shade makes a color
USUAL, SHADES = 100, (1.0, 0.8, 0.65, 0.5, 0.4)
# views that show hair's colors, out of 1, from which a cell is hair: behind the face, and beside it, where cells of a
# cheek are seen before hair
BEHIND, BESIDE = 0.5, 0.75
# metres: behind a cell nearer to the template than this lies the template
TOUCHING = 0.012


class ColorView(NamedTuple):
    """A picture in [0, 1] with its mask, small, and its camera, which takes canonical metres."""

    image: Float[Array, "height width 3"]
    mask: Bool[Array, "height width"]
    camera: Camera


def color_views(
    images: UInt8[Array, "frames height width 3"],
    masks: Bool[Array, "frames height width"],
    cameras: Sequence[Camera],
    box: tuple[Float[Array, "3"], Float[Array, "3"]] | None = None,
) -> list[ColorView]:
    """At most FRAMES of a video's pictures, or what they show of a `box` (low and high corner), each averaged down to
    SMALL pixels; cameras take canonical metres."""
    views = []
    for i in even(len(images), FRAMES):
        low, high = np.zeros(2, int), np.array(cameras[i].size)
        if box is not None:
            pixels, depth = project(cameras[i], np.array(list(product(*zip(*box)))))
            if depth.min() <= 0:
                continue
            low = np.floor(pixels.min(0)).clip(low, high).astype(int)
            high = np.ceil(pixels.max(0)).clip(low, high).astype(int)
        (left, top), (width, height) = low.tolist(), (high - low).tolist()
        by = max(1, int(np.ceil(max(height, width) / SMALL)))
        height, width = height // by * by, width // by * by
        if height * width == 0:
            continue
        window = np.s_[top : top + height, left : left + width]
        mean = lambda a: a[window].reshape(height // by, by, width // by, by, -1).mean((1, 3))
        mask = mean(masks[i][..., None].astype(np.float64))[..., 0] > 0.99
        cut = cameras[i].cropped(left, top, (width, height))
        views.append(ColorView(mean(images[i] / 255.0), mask, cut.resized((width // by, height // by))))
    return views


def carve_hollows(
    solid: Bool[Array, "x y z"], hair: Bool[Array, "x y z"], low: Float[Array, "3"], cell: float,
    subject: CaptureSubject, views: Sequence[ColorView], sure: "Sure | None" = None,
) -> Bool[Array, "x y z"]:  # fmt: skip
    """The cells of `hair` that are empty; `solid` holds them and the template's inside. With `sure` what is no hair by
    its color is empty too."""
    solid, hair = solid.copy(), hair.copy()
    carved = np.zeros_like(hair)
    behind = list(on_all_cores(lambda view: rasterise(subject.vertices, subject.faces, view.camera), views))
    kinds = None
    for _ in range(ROUNDS):
        outer = solid & ~np.asarray(ndimage.binary_erosion(solid), bool)
        surface = np.argwhere(outer)
        is_hair = hair[tuple(surface.T)]
        if not is_hair.any():
            break
        looks = list(on_all_cores(lambda view: _looks(low + cell * surface, view, cell), views))
        colors = _template_colors(subject, views, behind, looks, cell)
        shown, expected = _shown_behind(views, behind, looks, colors, is_hair, subject)
        empty = _empty(shown, expected, DISAGREE if sure is None else ESTIMATED)
        if sure is not None:
            at = tuple(surface[is_hair].T)
            grows = sure.hair[at]
            kinds = ColorKinds.between(shown[:, grows], colors[sure.other]) if kinds is None else kinds
            empty &= kinds.share(kinds.hair, shown) < np.where(sure.behind[at], BEHIND, BESIDE)
            empty |= ~grows & (kinds.share(kinds.other, shown) >= 0.5)
        gone = surface[is_hair][empty]
        if len(gone) == 0:
            break
        for cells in (solid, hair):
            cells[tuple(gone.T)] = False
        carved[tuple(gone.T)] = True
    return carved


class Sure(NamedTuple):
    """What is known of an estimated person before any color is."""

    hair: Bool[Array, "x y z"]  # cells that are hair, where the hull holds them
    behind: Bool[Array, "x y z"]  # cells behind the face, at any height
    other: Bool[Array, "vertices"]  # the template's skin and clothes that no hair covers


class ColorKinds(NamedTuple):
    """Of all colors, STEPS of each channel, those that are rather hair's, and those that are rather others'."""

    hair: Bool[Array, "r g b"]
    other: Bool[Array, "r g b"]

    @classmethod
    def between(cls, hair: Float[Array, "*n 3"], others: Float[Array, "m 3"]) -> "ColorKinds":
        """By colors known of both; NaN is no color. Where too few are known, none is either."""
        hair, others = (some.reshape(-1, 3)[np.isfinite(some).all(-1).ravel()] for some in (hair, others))
        shape = (STEPS,) * 3
        if min(len(hair), len(others)) < ALIKE:
            return cls(np.zeros(shape, bool), np.zeros(shape, bool))
        every = (np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 3) + 0.5) / STEPS
        away = lambda some, k=ALIKE: KDTree(some).query(every, k)[0].mean(1).reshape(shape)
        from_hair, from_others = away(hair), away(others)
        near = from_hair < UNLIKE
        # a neck lies in the shade of hair, and some of hair's cells show it
        few = hair[:: -(-len(hair) // 3000)]
        usual, shaded = away(few, max(2, len(few) // USUAL)), away(np.concatenate([x * others for x in SHADES]))
        other = ~near & (from_hair > 1.5 * from_others) | (usual > UNLIKE) & (usual > 1.5 * shaded)
        return cls(near & (1.5 * from_hair < from_others), other)

    def share(self, kind: Bool[Array, "r g b"], shown: Float[Array, "views k 3"]) -> Float[Array, "k"]:
        """Of the views that see each cell those that show a color of one kind; 0 where fewer than SEEN_BY do."""
        seen = np.isfinite(shown).all(2)
        red, green, blue = ((STEPS * np.nan_to_num(shown[..., c])).astype(int).clip(0, STEPS - 1) for c in range(3))
        number = seen.sum(0)
        return np.where(number < SEEN_BY, 0, (kind[red, green, blue] & seen).sum(0) / np.maximum(number, 1))


def pixels_of(
    camera: Camera, points: Float[Array, "n 3"]
) -> tuple[Int[Array, "n"], Int[Array, "n"], Float[Array, "n"], Bool[Array, "n"]]:
    """Row and column of the pixels that points fall on, their depth, and which the picture holds."""
    pixels, depth = project(camera, points)
    width, height = camera.size
    column, row = np.floor(np.nan_to_num(pixels, nan=-1.0)).clip(-1, 1 << 20).astype(int).T
    return row, column, depth, (depth > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)


class _Looks(NamedTuple):
    """How one view sees the cells of the surface."""

    row: Int[Array, "n"]
    column: Int[Array, "n"]
    depth: Float[Array, "n"]
    seen: Bool[Array, "n"]
    nearest: Float[Array, "height width"]  # depth of the nearest cell, inf where none


def _looks(points: Float[Array, "n 3"], view: ColorView, cell: float) -> _Looks:
    """Each cell's pixel, and whether no other cell hides it: a depth image of cells as large as they appear."""
    row, column, depth, inside = pixels_of(view.camera, points)
    row, column = np.where(inside, row, 0), np.where(inside, column, 0)
    nearest = np.full(view.mask.shape, np.inf)
    np.minimum.at(nearest, (row[inside], column[inside]), depth[inside])
    # a cell covers this many pixels to each side
    reach = max(1, int(np.ceil(0.6 * cell * view.camera.K[0, 0] / max(float(np.median(depth)), 1e-6))))
    nearest = np.asarray(ndimage.minimum_filter(nearest, size=2 * reach + 1, mode="nearest"), np.float64)
    seen = inside & (depth < nearest[row, column] + TOLERANCE * cell) & view.mask[row, column]
    return _Looks(row, column, depth, seen, nearest)


def _template_colors(
    subject: CaptureSubject, views: Sequence[ColorView], behind: Sequence, looks: Sequence[_Looks], cell: float
) -> Float[Array, "vertices 3"]:
    """Median color of each template vertex over the pixels that show it with no hull before it; NaN: none."""
    vertex, color = [], []
    for view, drawn, look in zip(views, behind, looks):
        free = (drawn.face >= 0) & view.mask & (drawn.depth < look.nearest + 2 * TOLERANCE * cell)
        corners = subject.faces[drawn.face[free]]
        vertex.append(corners.ravel())
        color.append(np.repeat(view.image[free], 3, axis=0))
    at, values = np.concatenate(vertex), np.concatenate(color)

    def mean(at: Int[Array, "n"], values: Float[Array, "n 3"]) -> Float[Array, "vertices 3"]:
        total = np.stack([np.bincount(at, values[:, c], len(subject.vertices)) for c in range(3)], 1)
        count = np.bincount(at, minlength=len(subject.vertices))[:, None]
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    # once more without what is far from the mean: a strand, an edge
    near = np.abs(values - mean(at, values)[at]).max(1) < 2 * SAME
    return mean(at[near], values[near])


def _shown_behind(
    views: Sequence[ColorView], behind: Sequence, looks: Sequence[_Looks], colors: Float[Array, "vertices 3"],
    is_hair: Bool[Array, "n"], subject: CaptureSubject,
) -> tuple[Float[Array, "views k 3"], Float[Array, "views k 3"]]:  # fmt: skip
    """What views show at the surface's cells that are hair, and what the template would show there; NaN: unknown."""
    k = int(is_hair.sum())
    shown = np.full((len(views), k, 3), np.nan)
    expected = np.full((len(views), k, 3), np.nan)
    for i, (view, drawn, look) in enumerate(zip(views, behind, looks)):
        seen = look.seen[is_hair]
        row, column = look.row[is_hair][seen], look.column[is_hair][seen]
        shown[i, seen] = view.image[row, column]
        face = drawn.face[row, column]
        known = (face >= 0) & (drawn.depth[row, column] > look.depth[is_hair][seen] - TOUCHING)
        color = colors[subject.faces[np.where(known, face, 0)]].mean(1)
        expected[i, seen] = np.where(known[:, None], color, np.nan)
    return shown, expected


def _empty(shown: Float[Array, "views k 3"], expected: Float[Array, "views k 3"], disagree: float) -> Bool[Array, "k"]:
    """Which cells show what lies behind them, or in no two views the same, by more than `disagree`."""
    k = shown.shape[1]
    seen = np.isfinite(shown).all(2)
    known = np.isfinite(expected).all(2)
    with np.errstate(invalid="ignore"):
        number = seen.sum(0)
        middle = np.zeros((k, 3))
        some = number > 0
        middle[some] = np.nanmedian(shown[:, some], axis=0)
        apart = np.where(seen, np.abs(shown - middle).mean(2), 0).sum(0) / np.maximum(number, 1)
        off = np.where(known, np.abs(shown - expected).mean(2), 0).sum(0) / np.maximum(known.sum(0), 1)
    matches = (
        (number >= SEEN_BY) & (known.sum(0) >= np.maximum(KNOWN * number, 2)) & (off < SAME) & (off < apart + SAME)
    )
    return ((number >= 2) & (apart > disagree)) | matches
