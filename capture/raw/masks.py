"""The person separated from the room behind: a soft mask for every frame.

Where the plate (the room without anybody) is known, a pixel is the person's as far as it differs from it, exposure and
shadows allowed for. What that leaves open, a random walk that does not like to cross edges of color decides
(Grady 2006). At the rim a pixel is a mixture of the person beside it and of the plate, and its share follows from
the three colors (Smith and Blinn, Blue Screen Matting, 1996):

    I = a F + (1 - a) B      a = (I - B).(F - B) / |F - B|^2
"""

import warnings

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array
from scipy import ndimage
from skimage.segmentation import random_walker

from capture.keypoints.record import SIDES, Keypoints
from capture.raw.glance import SURE
from capture.raw.grab_cut import INSTALL, can_cut, grab_cut
from capture.raw.limbs import bones, hull, lines, near_bones
from capture.raw.plate import Plate, smoothed
from geometry.cells import distance_to, nearest_marked, pieces

# pixels: height of the pictures that the walk goes through
WALKED = 300
# deviations at which a pixel is as likely the person's as not, and how sharply that turns
EVEN, SHARP = 4.0, 1.0
# grey levels: an encoder is off by a share of the room's edges as strong as this, and by little more at stronger ones
STRONG = 20.0
# probabilities beyond which a pixel needs no walk, and up to which it shows the room as lit as in the plate
CERTAIN, LIT = 0.96, 0.1
# the darkest shadow that the floor may get, and the walls, as a share of their light
DARKEST, WALL_DARKEST = 0.5, 0.92
# beta of the random walk: how little it likes to cross edges of color, at the picture's deviation
CONTRAST = 130.0
# pixels of 1080 on either side of the edge in which pixels are mixtures
RIM = 3.5
# deviations between person and room from which the mixture can be read off
APART = 7.0
# shares of the person's area: smaller pieces are none of it, smaller holes are none
PIECE, HOLE = 0.01, 0.0006


def soft_mask(
    picture: UInt8[Array, "height width 3"], plate: Plate, keypoints: Keypoints, frame: int
) -> UInt8[Array, "height width"]:
    """Share of every pixel that is the person, 0 to 255."""
    image = picture.astype(np.float32)
    core = lines(keypoints, frame, image.shape[:2])
    gain = _gain(image, plate, keypoints, frame)
    room = plate.color * gain
    floor = _floor(keypoints, frame, image.shape[0])
    person, unlit = _differs(image, plate, gain, floor)
    known, clear = plate.known, np.zeros(image.shape[:2], bool)
    rim = max(3.0, RIM * min(image.shape[:2]) / 1080)
    if known.all():
        clear = _clear(unlit, near_bones(keypoints, frame, known.shape))
        inside = _whole((_walked(image, person, core, known) > 0.5) & ~clear, keypoints, frame)
    else:
        may, thin = (find(keypoints, frame, image.shape[:2]) for find in (hull, bones))
        if may.all() or not thin.any() or not can_cut():
            person = np.where(known, person, _by_color(image, core, may, room, known))
            person[~may] = 0
            inside = _whole(_walked(image, person, core, known) > 0.5, keypoints, frame)
        else:
            # where the room is known and seen it is no person
            may &= ~known | (person > 1 - CERTAIN) | thin
            begun = np.where(known, person > CERTAIN, near_bones(keypoints, frame, image.shape[:2]))
            inside = _whole(grab_cut(image, thin, begun, may) > 0.5, keypoints, frame)
            room, known = _filled(image, room, known, inside, rim)
    out = np.zeros(inside.shape, np.uint8)
    # the person and some pixels round it
    for rows, columns in ndimage.find_objects(inside.astype(int)):
        margin = round(8 * rim)
        window = tuple(slice(max(0, s.start - margin), s.stop + margin) for s in (rows, columns))
        out[window] = _rim(
            *(x[window] for x in (image, room, known, inside, clear)), rim=rim, apart=APART * plate.noise
        )
    return out


def masked_by(empty: Bool[Array, "frames"]) -> str:
    """What `soft_mask` goes by in a film, in words."""
    if empty.any():
        return "from the empty room"
    if can_cut():
        return "from the room as far as it is seen beside the person, the rest by GrabCut from keypoints"
    return f"from the room as far as it is seen beside the person; GrabCut is far better: {INSTALL}"


def _floor(keypoints: Keypoints, frame: int, height: int) -> int:
    """The row from which on the floor may show the person's shadow: of the higher knee; where none is seen the film's
    median; none where no frame shows one."""
    knees = np.stack([keypoints.seen(f"{side}_knee") for side in SIDES])
    rows = np.where(knees[..., 2] > SURE, knees[..., 1], np.inf).min(0)
    seen = rows[np.isfinite(rows)]
    row = rows[frame] if np.isfinite(rows[frame]) else np.median(seen) if len(seen) else height
    return int(np.clip(row, 0, height))


def _filled(
    image: Float[Array, "height width 3"],
    room: Float[Array, "height width 3"],
    known: Bool[Array, "height width"],
    inside: Bool[Array, "height width"],
    rim: float,
) -> tuple[Float[Array, "height width 3"], Bool[Array, "height width"]]:
    """The room with the mean of what lies beside the person where it is not known, and where it then is."""
    free = ~np.asarray(ndimage.binary_dilation(inside, iterations=round(rim)), bool)
    beside, weight = _mean_of(image, free, 2 * rim)
    return np.where(known[..., None], room, beside), known | (weight > 0.02)


def _mean_of(
    image: Float[Array, "height width 3"], marked: Bool[Array, "height width"], sigma: float
) -> tuple[Float[Array, "height width 3"], Float[Array, "height width"]]:
    """The mean color of the marked pixels round each pixel (Gaussian, pixels), and their share."""
    share = ndimage.gaussian_filter(marked.astype(np.float32), sigma)
    total = ndimage.gaussian_filter(image * marked[..., None], (sigma, sigma, 0))
    return total / np.maximum(share, 1e-3)[..., None], share


def _gain(image: Float[Array, "height width 3"], plate: Plate, keypoints: Keypoints, frame: int) -> Float[Array, "3"]:
    """How much brighter each channel is than in the plate, by the pixels that agree with most."""
    step = max(1, min(image.shape[:2]) // 200)
    a, b = image[::step, ::step], plate.color[::step, ::step]
    good = plate.known[::step, ::step] & (b.min(-1) > 25) & (b.max(-1) < 245) & (a.max(-1) < 250)
    sure = keypoints.confidence[frame] > SURE
    if sure.any():
        low, high = (f(keypoints.pixels[frame][sure], axis=0) / step for f in (np.min, np.max))
        (left, top), (right, bottom) = np.clip(low - 3, 0, None).astype(int), np.clip(high + 3, 0, None).astype(int)
        outside = good.copy()
        outside[top:bottom, left:right] = False
        good = outside if outside.sum() > 500 else good
    if good.sum() < 100:
        return np.ones(3, np.float32)
    ratio = a[good] / b[good]
    middle = np.median(ratio, axis=0)
    for width in (0.08, 0.04):
        near = (np.abs(ratio - middle) < width).all(1)
        middle = np.median(ratio[near], axis=0) if near.sum() > 50 else middle
    return middle.astype(np.float32)


def _differs(
    image: Float[Array, "height width 3"], plate: Plate, gain: Float[Array, "3"], floor: int
) -> tuple[Float[Array, "height width"], Float[Array, "height width"]]:
    """Probability that a pixel shows neither the room lit nor in shadow, and that it does not show the room lit."""
    shown, behind = smoothed(image), plate.smooth * gain
    # where the room has edges more difference means nothing, however strong they are
    bright = _dot(behind, np.ones_like(behind)) / 3
    edges = plate.detail / np.hypot(1, plate.detail / STRONG)
    deviation = np.sqrt((0.8 * plate.noise) ** 2 + (0.012 * bright) ** 2 + (0.6 * edges) ** 2)
    off = shown - behind
    apart = np.sqrt(_dot(off, off) / 3) / deviation
    # the room in shadow: the same color, darker
    ratio = _dot(shown, behind) / np.maximum(_dot(behind, behind), 1)
    darkest = np.full((len(image), 1), WALL_DARKEST, np.float32)
    darkest[floor:] = DARKEST
    rest = shown - np.clip(ratio, darkest, 1.0)[..., None] * behind
    shaded = np.sqrt(_dot(rest, rest) / 3) / (deviation + 0.05 * (1 - np.clip(ratio, 0, 1)) * bright)
    either = np.where((ratio < 1) & (ratio > darkest), np.minimum(apart, 1.6 * shaded), apart)
    person, unlit = (1 / (1 + np.exp(-np.clip((x - EVEN) / SHARP, -30, 30))) for x in (either, apart))
    return person, unlit


def _clear(unlit: Float[Array, "height width"], near: Bool[Array, "height width"]) -> Bool[Array, "height width"]:
    """Where the room is surely seen, between legs or behind a ponytail too: lit as in the plate over more than
    specks, off the lines of limbs. The walk loses such gaps: small ones hold no seeds."""
    clear = np.asarray(ndimage.binary_opening((unlit < LIT) & ~near), bool)
    labels = pieces(clear)
    return clear & (np.bincount(labels.ravel()) >= HOLE * (unlit > 1 - LIT).sum())[labels]


def _dot(a: Float[Array, "height width 3"], b: Float[Array, "height width 3"]) -> Float[Array, "height width"]:
    return np.einsum("yxc,yxc->yx", a, b)


def _by_color(
    image: Float[Array, "height width 3"],
    core: Bool[Array, "height width"],
    may: Bool[Array, "height width"],
    room: Float[Array, "height width 3"],
    known: Bool[Array, "height width"],
) -> Float[Array, "height width"]:
    """Probability by color alone: those on the lines of limbs against those of the room."""
    bins = 16

    def histogram(colors: Float[Array, "n 3"]) -> Float[Array, "16 16 16"]:
        index = np.clip(colors / (256 / bins), 0, bins - 1).astype(int)
        counts = np.bincount(np.ravel_multi_index(index.T, (bins,) * 3), minlength=bins**3).astype(float)
        smooth = ndimage.gaussian_filter(counts.reshape(bins, bins, bins), 0.7)
        return smooth / max(smooth.sum(), 1e-9) + 1e-6

    person = histogram(image[core])
    beside = histogram(np.concatenate([image[~may][::7], room[known][::7]]))
    at = tuple(np.clip(image / (256 / bins), 0, bins - 1).astype(int).transpose(2, 0, 1))
    return np.clip(person[at] / (person[at] + beside[at]), 0.1, 0.9)


def _walked(
    image: Float[Array, "height width 3"],
    person: Float[Array, "height width"],
    core: Bool[Array, "height width"],
    known: Bool[Array, "height width"],
) -> Float[Array, "height width"]:
    """Share of the person at every pixel; a walk through smaller pictures decides what is open."""
    scale = min(1.0, WALKED / image.shape[0])

    def shrink(values: Float[Array, "height width"]) -> Array:
        return np.asarray(ndimage.zoom(ndimage.uniform_filter(values, round(1 / scale)), scale, order=1))

    small = shrink(person)
    colors = np.dstack([shrink(image[..., c]) for c in range(3)]) / 255
    line = shrink(core.astype(np.float32)) > 0.5
    given = shrink(known.astype(np.float32)) > 0.5
    surely = np.where(given, small > CERTAIN, small > 0.88) | (line & (small > 0.3))
    beside = np.where(given, small < 1 - CERTAIN, small <= 0.0) & ~line
    # lone pixels in a shirt of the wall's color are no room
    beside = np.asarray(ndimage.binary_opening(beside, iterations=2), bool) & ~line
    labels = np.where(surely, 1, np.where(beside, 2, 0))
    if not surely.any() or not beside.any():
        return person
    walked = walk(colors, labels, CONTRAST / max(float(colors.std()) / 0.2, 1e-3))[0]
    zoom = (image.shape[0] / walked.shape[0], image.shape[1] / walked.shape[1])
    wide = np.clip(np.asarray(ndimage.zoom(walked.astype(np.float32), zoom, order=1)), 0, 1)
    # near the edge the full picture knows better, where it knows at all
    near = ndimage.gaussian_filter(np.abs(wide - 0.5), 1) < 0.48
    sharp = near & known & ((person > CERTAIN) | (person < 1 - CERTAIN))
    return np.where(sharp, person, wide)


def walk(
    colors: Float[Array, "height width 3"], labels: Int[Array, "height width"], beta: float
) -> Float[Array, "2 height width"]:
    """Probability of the labels 1 and 2 at every pixel, those labelled 0 being open; none where no seed reaches.

    `beta` counts at the deviation of all colors.
    """
    out = np.stack([labels == seed for seed in (1, 2)]).astype(float)
    near = np.asarray(ndimage.binary_dilation(labels == 0, iterations=2), bool)  # farther seeds decide nothing
    for window in ndimage.find_objects(near.astype(int)):
        part, seeds = colors[window], np.where(near, labels, -1)[window]
        present = [seed for seed in (1, 2) if (seeds == seed).any()]
        probability = np.ones((1, *seeds.shape))
        if len(present) == 2:
            # what is walked on is scaled by the deviation of its colors
            beta *= part.std() / max(colors.std(), 1e-6)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                probability = np.asarray(random_walker(part, seeds, beta=beta, mode="cg_j", tol=1e-3,
                                                       return_full_prob=True, channel_axis=-1))  # fmt: skip
        for row, seed in enumerate(present):
            out[seed - 1][window][near[window]] = probability[row][near[window]]
    return out


def _whole(inside: Bool[Array, "height width"], keypoints: Keypoints, frame: int) -> Bool[Array, "height width"]:
    """Without specks in the room and pinholes in the person; pieces with sure points stay."""
    labels = pieces(inside)
    if not inside.any():
        return inside
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    keep = sizes >= PIECE * sizes.max()
    x, y = keypoints.pixels[frame][keypoints.confidence[frame] > 0.5].T
    ok = (x >= 0) & (y >= 0) & (x < inside.shape[1]) & (y < inside.shape[0])
    points = labels[y[ok].astype(int), x[ok].astype(int)]
    keep |= (np.bincount(points, minlength=len(sizes)) >= 2) & (sizes > 0)
    keep[0] = False
    inside = keep[labels]
    holes = pieces(~inside)
    sizes = np.bincount(holes.ravel())
    sizes[0] = inside.size
    return inside | (sizes < HOLE * inside.sum())[holes]


def _rim(
    image: Float[Array, "height width 3"],
    room: Float[Array, "height width 3"],
    known: Bool[Array, "height width"],
    inside: Bool[Array, "height width"],
    clear: Bool[Array, "height width"],
    rim: float,
    apart: float,
) -> UInt8[Array, "height width"]:
    """Mixtures along the edge, read off the colors on either side where those are more than `apart` grey levels apart;
    the edge itself moves to where they are even."""
    out = np.where(inside, 255, 0).astype(np.uint8)
    if inside.all() or not inside.any():
        return out
    to_edge = np.where(inside, distance_to(~inside) - 0.5, 0.5 - distance_to(inside))
    person = to_edge > rim
    if not person.any():
        return out
    away, nearest = distance_to(person), nearest_marked(person)
    # the person's color beside the rim, a little averaged
    front, _ = _mean_of(image, person, 1.0)
    # thin limbs have no inside of their own: they stay as they are
    band = (np.abs(to_edge) <= rim) & (away < 3 * rim)
    y, x = np.nonzero(band)
    F = front[nearest[0][y, x], nearest[1][y, x]]
    # the room beside it, with the person's shadow
    free = (to_edge < -rim) & known
    ratio = np.where(free, image.mean(-1) / np.maximum(room.mean(-1), 1), 0)
    sigma = 2.5 * rim
    beside = np.maximum(ndimage.gaussian_filter(free.astype(np.float32), sigma), 1e-3)
    shade = ndimage.gaussian_filter(ratio, sigma) / beside
    B = room[y, x] * np.clip(shade[y, x], DARKEST, 1.1)[:, None]
    between = F - B
    length = (between**2).sum(1)
    share = np.clip(((image[y, x] - B) * between).sum(1) / np.maximum(length, 1e-6), 0, 1)
    legible = known[y, x] & (np.sqrt(length / 3) > apart)
    # where colors say nothing the edge stays where it is, half a pixel soft
    mixed = inside.astype(np.float32)
    mixed[y, x] = np.where(legible, share, np.clip(to_edge[y, x] / 1.5 + 0.5, 0, 1))
    # a stripe of the wall's color inside the rim is no room, nor a speck beside it the person
    hard = mixed > 0.5
    lone = (~hard & ~_joined(~hard, ~inside & (clear | ~band))) | (hard & ~_joined(hard, person | (inside & ~band)))
    mixed[lone] = ~hard[lone]
    return np.round(255 * mixed).astype(np.uint8)


def _joined(pixels: Bool[Array, "height width"], seeds: Bool[Array, "height width"]) -> Bool[Array, "height width"]:
    """Those of the pixels that are connected with one of the seeds."""
    labels = pieces(pixels)
    return pixels & np.isin(labels, labels[seeds & pixels])
