"""Where the eyes are in the pictures of the head's video.

A detector's points at the eyes are some millimetres off, each by its own, and an opening between lids is eight
millimetres high: a ball behind lids drawn by such points gets the color of lids. So the opening keeps the free body's
form, and where it lies is asked of the pixels. How deep: the frames that look at the face agree on a plane through the
eyes at the right depth alone (plane sweep, Collins 1996); 3 mm off, an eye slides by as much from cheek to cheek, and a
texture of all frames is blurred. Upper lashes stand some millimetres before the ball: the eyes' lower halves are asked.
Where in that plane: a drawing of skin, lashes, white and iris, blurred as the pictures are, each of the color that fits
best, explains most of a picture's variance where the template's opening lies on the eye's.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve

from avatar.camera import Camera, project
from capture.fit.footage import Estimate
from capture.fit.pixels import bilinear
from capture.raw.scan import RawVideo
from capture.template.eyes import body_sockets
from geometry.closest import beyond_loop

# cosine between where the face looks and its camera, at least, for their depth and for the rest; frames that are used,
# at most and at least
FACING, STRAIGHT, MOST, FEWEST = 0.8, 0.9, 24, 5
# metres: depths that are tried, half the width and height of what is compared there, and how far up over the opening's
# middle; most variance between frames, as a share of that within their mean
DEPTHS, EYE, LOWER, AGREED = np.linspace(-0.008, 0.008, 17), (0.014, 0.009), 0.001, 0.6
# metres: a pixel of the picture in the plane of the lids, and half its width and height
PIXEL, HALF = 0.0004, (0.030, 0.022)
# pixels of a frame that an iris of 12 mm is wide, at least
IRIS_PIXELS = 6.0
# metres: radii of an iris, and by how much nearer to the nose its middle may lie than the opening's (.002 on the free
# body); heights of the opening beside the template's
RADII, ASIDE, HEIGHTS = (0.0055, 0.0062, 0.007), (0.0, 0.001, 0.002), (1.0, 1.25, 1.5)
# metres to either side of the opening's middle whose lids say how deep it is: its corners lie behind
LIDS = 0.004
# metres over the upper lid to which thin and thick lashes reach, and round the opening as far as skin is drawn; the
# pictures' blur, a standard deviation, in their pixels
LASHES, SKIN, BLUR = (0.0012, 0.0026), 0.005, 0.45
# metres: how far an eye is sought up and aside; standard deviations of that, of its depth, and of one eye's height from
# the other's
REACH, EXPECTED, DEEP, LEVEL = (0.008, 0.009), 0.0025, 0.003, 0.002
# standard deviation of an opening's height beside the template's: lashes and shadow would do for more of it
HEIGHT = 0.35
# weight of a standard deviation's square beside the share of the variance that is explained, of which both eyes' mean
# is at least so much; a color's variance that noise has
PRIOR, EXPLAINED, NOISE = 0.05, 0.2, 4e-4
# [0, 1]: by how much the white is brighter than the iris; how much more colorful than skin it may be (least over
# largest channel), for it lies in the lids' shade
WHITER, COLORFUL = 0.02, 0.05
# places looked at for each size, best first
BEST = 150
# metres: skin nearer to an eye goes with it, what is farther stays
STILL, APART = 0.016, 0.006


class Size(NamedTuple):
    """An eye's opening beside the template's, and its iris."""

    radius: float  # metres
    aside: float
    height: float


SIZES = [Size(*values) for values in product(RADII, ASIDE, HEIGHTS)]


class FoundEyes(NamedTuple):
    """Left and right eye."""

    size: Size
    moves: Float[Array, "2 3"]  # metres, of the openings' middles
    explained: float  # share of the pictures' variance, mean of both


def with_eyes_of_pictures(
    estimate: Estimate, cameras: Sequence[Camera], video: RawVideo, usable: Bool[Array, "frames"]
) -> Estimate:  # fmt: skip
    """The estimate with lids and sockets where the head's video shows them; unchanged where it does not.

    `cameras` are round the head, one a frame.
    """
    vertices = estimate.person.vertices(estimate.g)
    found = find_eyes(vertices, cameras, video, usable)
    if found is None:
        return estimate
    person = estimate.person
    return replace(estimate, person=replace(person, offsets=person.offsets + eye_offsets(vertices, found)))


def find_eyes(
    vertices: Float[Array, "vertices 3"], cameras: Sequence[Camera], video: RawVideo, usable: Bool[Array, "frames"]
) -> FoundEyes | None:
    """Both eyes near those of a free body in pose 0; None where too few frames show them, or nothing is explained."""
    sockets = body_sockets()
    middles = np.stack([opening_middle(vertices, socket.rim) for socket in sockets])
    frames, straight = frames_of_eyes(cameras, middles.mean(0), usable)
    if straight < FEWEST:
        return None
    views = [(video.picture(int(f)), cameras[f]) for f in frames]
    # both alike: a sweep sees little of one of them where the head turns away
    depth = depth_of_eyes(middles, views)
    blur = BLUR * float(np.median([np.linalg.norm(c.eye - middles.mean(0)) / c.K[0, 0] for _, c in views[:straight]]))
    maps = []
    for socket, middle, outwards in zip(sockets, middles, (1, -1)):
        picture = np.median(planes(middle + [0, 0, depth], views[:straight], HALF), 0)
        loop = in_order(vertices[socket.rim, :2] - middle[:2])
        maps.append(np.stack([explained(picture, *drawn(loop, size, outwards, blur)) for size in SIZES]))
    found = best_pair(np.stack(maps, 1), middles[:, 1])
    return None if found is None else found._replace(moves=found.moves + [0, 0, depth])


def opening_middle(vertices: Float[Array, "vertices 3"], rim: Int[Array, "n"]) -> Float[Array, "3"]:
    """The middle of the box round the edges of the lids, as deep as the lids are there."""
    edges = vertices[rim]
    middle = 0.5 * (edges.min(0) + edges.max(0))
    middle[2] = edges[np.abs(edges[:, 0] - middle[0]) < LIDS, 2].mean()
    return middle


def frames_of_eyes(
    cameras: Sequence[Camera], at: Float[Array, "3"], usable: Bool[Array, "frames"]
) -> tuple[Int[Array, "n"], int]:
    """Frames that look at the face and show an iris large enough, straightest first; how many of them are STRAIGHT."""
    ahead = np.array([(c.eye - at)[2] / np.linalg.norm(c.eye - at) for c in cameras])
    wide = np.array([0.012 * c.K[0, 0] / np.linalg.norm(c.eye - at) for c in cameras])
    good = np.flatnonzero(usable & (ahead > FACING) & (wide > IRIS_PIXELS))
    chosen = good[np.argsort(-ahead[good], kind="stable")][:MOST]
    return chosen, int((ahead[chosen] > STRAIGHT).sum())


def grid(half: tuple[float, float]) -> tuple[Float[Array, "height width"], Float[Array, "height width"]]:
    """x and y of the pixels' middles round the origin, y upwards."""
    columns, rows = (int(size / PIXEL) for size in half)
    v, u = np.mgrid[rows : -rows - 1 : -1, -columns : columns + 1] * PIXEL
    return u, v


def planes(
    middle: Float[Array, "3"], views: list[tuple[UInt8[Array, "h w 3"], Camera]], half: tuple[float, float]
) -> Float[Array, "frames height width 3"]:
    """What frames show in the plane through a place that faces forwards, [0, 1] sRGB."""
    u, v = grid(half)
    places = middle + np.stack([u, v, np.zeros_like(u)], -1).reshape(-1, 3)
    shown = [bilinear(picture, project(camera, places)[0]) / 255 for picture, camera in views]
    return np.stack(shown).reshape(len(views), *u.shape, 3)


def depth_of_eyes(middles: Float[Array, "2 3"], views: list[tuple[UInt8[Array, "h w 3"], Camera]]) -> float:
    """How far before the template's the eyes lie, metres; 0 where frames agree nowhere in reach.

    The light may change between frames: each one's mean color is taken off.
    """
    lower, left = grid(EYE)[1] < LOWER, np.zeros(len(DEPTHS))
    for k, depth in enumerate(DEPTHS):
        for middle in middles:
            shown = planes(middle + [0, 0, depth], views, EYE)[:, lower]
            shown = shown - shown.mean(1, keepdims=True)
            left[k] += shown.var(0).mean() / max(float(shown.mean(0).var(0).mean()), 1e-9) / len(middles)
    cost = left + PRIOR * (DEPTHS / DEEP) ** 2
    k = int(np.argmin(cost))
    if k in (0, len(left) - 1) or left[k] > AGREED:
        return 0.0
    a, b, c = cost[k - 1 : k + 2]
    return float(DEPTHS[k] + 0.5 * (a - c) / (a - 2 * b + c) * (DEPTHS[1] - DEPTHS[0]))


def in_order(points: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    """Points round the origin, by their angle."""
    return points[np.argsort(np.arctan2(points[:, 1], points[:, 0]), kind="stable")]


def drawn(
    loop: Float[Array, "n 2"], size: Size, outwards: int, blur: float
) -> tuple[Float[Array, "5 height width"], Float[Array, "height width"]]:
    """How much of iris, white, skin, lashes and thicker lashes pixels show round an opening amid a window, blurred by
    `blur` (metres); and which count. `outwards`: the side of the temple, 1 or -1."""
    u, v = grid((0.0185, 0.0185))
    lids = beyond_loop(np.stack([u.ravel(), v.ravel()], 1), loop * [1, size.height]).reshape(u.shape)
    within = lambda distance: np.clip(0.5 - distance / PIXEL, 0, 1)
    open_ = within(lids)
    thin, thick = ((v > 0) * (within(lids - reach) - open_) for reach in LASHES)
    iris = open_ * within(np.hypot(u + outwards * size.aside, v) - size.radius)
    parts = np.stack([iris, open_ - iris, 1 - open_ - thick, thin, thick - thin])
    return gaussian_filter(parts, (0, blur / PIXEL, blur / PIXEL), mode="nearest"), within(lids - SKIN)


def explained(
    picture: Float[Array, "height width 3"], parts: Float[Array, "5 h w"], counts: Float[Array, "h w"]
) -> Float[Array, "height width"]:
    """The share of a picture's variance that parts explain, each in its best color, with the window's middle at each
    pixel; -1 where the white would be no brighter than the iris, or more colorful than skin."""
    over = lambda values, weight: fftconvolve(values, weight[::-1, ::-1], mode="same")
    mean = np.stack([over(picture[..., c], counts) for c in range(3)]) / counts.sum()
    seen = np.stack([[over(picture[..., c], counts * part) for c in range(3)] for part in parts])
    seen -= (counts * parts).sum((1, 2))[:, None, None, None] * mean
    # a part that blur has all but taken has no color of its own
    normal = np.einsum("ihw,jhw,hw->ij", parts, parts, counts) + 1e-3 * counts.sum() * np.eye(len(parts))
    color = np.einsum("ij,jchw->ichw", np.linalg.inv(normal), seen)
    total = over((picture**2).sum(-1), counts) - counts.sum() * (mean**2).sum(0)
    share = (color * seen).sum((0, 1)) / (total + NOISE * counts.sum())
    iris, white, skin, *_ = (color + mean).clip(1e-3, 1)
    grey = lambda part: part.min(0) / part.max(0)
    return np.where((white.mean(0) > iris.mean(0) + WHITER) & (grey(white) > grey(skin) - COLORFUL), share, -1.0)


def best_pair(maps: Float[Array, "sizes 2 height width"], heights: Float[Array, "2"]) -> FoundEyes | None:
    """The size and the places of two eyes alike in size and level that are explained best; `heights` of the maps'
    middles, metres."""
    u, v = grid(HALF)
    inside = (np.abs(v) < REACH[0]) & (np.abs(u) < REACH[1])
    x, y = u[inside], v[inside]
    score = maps[:, :, inside] - PRIOR * (x**2 + y**2) / EXPECTED**2
    first = np.argsort(-score, -1)[..., :BEST]
    best, found = -np.inf, None
    for k, size in enumerate(SIZES):
        left, right = first[k]
        level = (heights[0] + y[left])[:, None] - (heights[1] + y[right])
        taller = (size.height - 1) / HEIGHT
        both = score[k, 0, left][:, None] + score[k, 1, right] - PRIOR * (taller**2 + (level / LEVEL) ** 2)
        i, j = np.unravel_index(both.argmax(), both.shape)
        if both[i, j] > best:
            at = np.array([left[i], right[j]])
            best = float(both[i, j])
            moves = np.stack([x[at], y[at], np.zeros(2)], 1)
            found = FoundEyes(size, moves, float(maps[k][:, inside][[0, 1], at].mean()))
    return found if found is not None and found.explained > EXPLAINED else None


def eye_offsets(vertices: Float[Array, "vertices 3"], found: FoundEyes) -> Float[Array, "vertices 3"]:
    """What moves lids and sockets there; the skin between follows as smoothly as it can (Duchon 1977)."""
    offsets, at, moves = np.zeros_like(vertices), [], []
    sockets = body_sockets()
    for socket, move in zip(sockets, found.moves):
        rim = vertices[socket.rim]
        at.append(rim)
        moves.append(move + [0, found.size.height - 1, 0] * (rim - opening_middle(vertices, socket.rim)))
    rims = np.concatenate(at)
    apart = np.linalg.norm(vertices[:, None] - rims[:: len(rims) // 12], axis=2).min(1)
    inside = np.concatenate([socket.inside for socket in sockets])
    near = np.setdiff1d(np.flatnonzero(apart < 3 * STILL), inside)
    far = vertices[near[apart[near] > STILL]]
    _, one = np.unique((far / APART).round().astype(np.int64), axis=0, return_index=True)
    still = far[one]
    field = RBFInterpolator(np.concatenate([rims, still]), np.concatenate([*moves, np.zeros_like(still)]),
                            kernel="linear")  # fmt: skip
    skin = near[apart[near] <= STILL]
    offsets[skin] = field(vertices[skin])
    for socket, move in zip(sockets, moves):
        own = np.setdiff1d(socket.inside, socket.rim)
        offsets[own] = np.mean(move, 0)
        offsets[socket.rim] = move
    return offsets
