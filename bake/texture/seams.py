"""Chart edges that agree: the texels around them are solved together, so that no mip in use shows a seam."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer, UInt8
from numpy import ndarray as Array
from scipy.sparse import csr_matrix

from avatar.texture import sample_texture
from bake.texture.texels import TexelMap, bilinear
from geometry.mesh import half_edges

# weight of keeping a texel as it was sampled: one that shows surface, one that only bilinear filtering reads
# beside it, and one of the gutter, which nothing but coarser mips reads
KEEP_INSIDE, KEEP_SKIRT, KEEP_GUTTER = 20.0, 0.1, 0.004
# a texel inside a chart that no edge reads in the finest mip moves no further than this for the coarser ones
FAR_FROM_EDGE = 6 / 255
# weight of a point on a chart edge looking the same from both sides, at 1024; more where texels are few
AGREE = 4.0
# as many times more in each coarser mip: fewer points lie along an edge there, and means resist more
GROW = 3.0
# steps of descent
DESCENT = 60
# points for each texel of an edge: between points farther apart two bilinear images can differ much more than at them
DENSE = 3


class ChartEdges(NamedTuple):
    """Edges of the mesh that lie on the border of a chart, as both charts see them."""

    left: Integer[Array, "edges 2"]  # atlas vertices at its two ends
    # the same two ends in the other chart
    right: Integer[Array, "edges 2"]

    def places(self, uv: Float[Array, "corners 2"], t: float | Array) -> list[Float[Array, "edges 2"]]:
        """Texture coordinates of a point so far along each edge, in both charts."""
        return [(1 - t) * uv[side[:, 0]] + t * uv[side[:, 1]] for side in self]


def chart_edges(
    uv: Float[Array, "corners 2"], faces: Integer[Array, "faces 3"], source: Integer[Array, "corners"]
) -> ChartEdges:
    """Every edge whose two triangles lie in different charts, or in one chart at different places.

    A triangle without area has no texels of its own (its corners share one texture coordinate): not counted.
    """
    directed = half_edges(faces)
    ends = source[directed]
    pair = np.sort(ends, axis=1)
    key = pair[:, 0].astype(np.int64) * (int(source.max()) + 1) + pair[:, 1]
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    left, right = directed[order[same]], directed[order[same + 1]]
    # put both in the same direction along the edge
    swap = source[left[:, 0]] != source[right[:, 0]]
    right = np.where(swap[:, None], right[:, ::-1], right)
    wide = (uv[left[:, 0]] != uv[left[:, 1]]).any(1) & (uv[right[:, 0]] != uv[right[:, 1]]).any(1)
    seam = (left != right).any(1) & wide
    return ChartEdges(left[seam], right[seam])


def seam_steps(
    uv: Float[Array, "corners 2"], edges: ChartEdges, image: UInt8[Array, "height width channels"], *, samples: int = 5
) -> Float[Array, "steps"]:
    """Step (bytes, worst channel) between the two sides of every chart edge, at points along it, in one mip."""
    steps = []
    for t in (np.arange(samples) + 0.5) / samples:
        one, other = (sample_texture(image, place) for place in edges.places(uv, t))
        steps.append(np.abs(one - other).max(1))
    return np.concatenate(steps)


def inward(
    uv: Float[Array, "corners 2"], faces: Integer[Array, "faces 3"], side: Integer[Array, "edges 2"]
) -> Float[Array, "edges 2"]:
    """Unit direction in the atlas from each chart edge into its chart, square to the edge."""
    key = lambda ends: ends.min(1).astype(np.int64) * len(uv) + ends.max(1)
    keys, apex = key(half_edges(faces)), faces[:, [2, 0, 1]].T.ravel()
    order = np.argsort(keys, kind="stable")
    third = apex[order[np.searchsorted(keys[order], key(side))]]
    along, into = uv[side[:, 1]] - uv[side[:, 0]], uv[third] - uv[side[:, 0]]
    into -= (into * along).sum(1, keepdims=True) / (along * along).sum(1, keepdims=True) * along
    return into / np.maximum(np.linalg.norm(into, axis=1, keepdims=True), 1e-12)


def seen_steps(
    uv: Float[Array, "corners 2"], faces: Integer[Array, "faces 3"], edges: ChartEdges,
    image: UInt8[Array, "height width channels"], picture: UInt8[Array, "_size _size channels"],
) -> Float[Array, "steps"]:  # fmt: skip
    """What is seen of the steps of `seam_steps` in a mip: how far (bytes, worst channel) they exceed the steps of the
    finest `picture`, as it was before closing, between places half a texel of the mip or one inside of the two charts.

    Where print or a fold crosses a chart edge a picture without charts steps there as well, and no line shows.
    """
    inwards, seen = [inward(uv, faces, side) / len(image) for side in edges], []
    for t in (np.arange(5) + 0.5) / 5:
        places = edges.places(uv, t)
        one, other = (sample_texture(image, place) for place in places)
        own = np.zeros_like(one)
        for away in (0.5, 1.0):
            left, right = (sample_texture(picture, place + away * into) for place, into in zip(places, inwards))
            own = np.maximum(own, np.abs(left - right))
        seen.append((np.abs(one - other) - own).max(1))
    return np.maximum(np.concatenate(seen), 0)


class _Mip(NamedTuple):
    """One mip: its texels that matter are those read here, and those above one that a finer mip reads."""

    texels: Integer[Array, "n"]  # row * size + column, ascending
    # points on edges x texels: left side minus right side, times the root of what the mip's agreement weighs
    reads: csr_matrix
    # texels x the finer mip's texels: mean of 2 x 2
    finer: csr_matrix | None
    # share of a texel in this mip that no finer mip reads
    rest: Float[Array, "n 1"]


class _Unknowns(NamedTuple):
    """What is solved for: the mean of each group of texels that move together, within its bounds."""

    texel: Integer[Array, "t"]  # row * size + column
    owner: Integer[Array, "t"]  # the unknown that moves it
    texel_low: Float[Array, "t channels"]
    texel_high: Float[Array, "t channels"]
    low: Float[Array, "unknowns channels"]
    given: Float[Array, "unknowns channels"]
    high: Float[Array, "unknowns channels"]
    keep: Float[Array, "unknowns 1"]

    def texels_at(
        self, values: Float[Array, "unknowns channels"], given: Float[Array, "t channels"]
    ) -> Float[Array, "t channels"]:
        """The texels when the unknowns have these values: each the same share of its way to its bound."""
        up = values > self.given
        way = np.where(up, self.high, self.low) - self.given
        share = np.clip((values - self.given) / np.where(way == 0, 1, way), 0, 1)[self.owner]
        return given + share * (np.where(up[self.owner], self.texel_high, self.texel_low) - given)


def solve_seams(
    image: Float[Array, "height width channels"], texels: TexelMap, uv: Float[Array, "corners 2"], edges: ChartEdges,
    levels: int,
) -> Float[Array, "height width channels"]:  # fmt: skip
    """The image with its chart edges closed in the first `levels` mips, no texel beyond the colors of the two sides.

    Least squares within bounds over every texel that a point on a chart edge reads in any of these mips:

        min over low <= x <= high   sum_i keep_i (x_i - image_i)^2
                                    + sum_mips agree GROW^mip sum_points (left(x) - right(x))^2

    low and high are, channel by channel, the range of what the points that read a texel read in the given image on
    both sides of the edge, so nothing overshoots, whatever the contrast. Texels that only a coarse mip reads enter
    through their mean alone: they are one unknown, and each goes the same share of its way to its bound. The mips are
    means of 2 x 2 texels, as the player makes them, so a coarse mip is closed mostly by what lies in the gutters, which
    the finest never shows.
    """
    if len(edges.left) == 0:
        return image
    chain = _chain(uv, edges, texels.size, levels)
    unknowns = _unknowns(chain, texels, image)
    differences = [mip.reads @ values for mip, values in zip(chain, _values(chain, image), strict=True)]
    solved = _descended(chain, unknowns, differences)
    result = image.copy()
    moved = result.reshape(-1, image.shape[-1])
    moved[unknowns.texel] = unknowns.texels_at(solved, moved[unknowns.texel])
    return result


def _descended(
    chain: list[_Mip], unknowns: _Unknowns, differences: list[Float[Array, "_ channels"]]
) -> Float[Array, "unknowns channels"]:
    """The unknowns after DESCENT steps from the given image; `differences` are what it reads left less right of edges.

    Accelerated projected gradients (Nesterov 1983), scaled by the diagonal and restarted where they turn uphill
    (O'Donoghue and Candes 2015): every step ends within the bounds.
    """
    low, given, high, keep = unknowns.low, unknowns.given, unknowns.high, unknowns.keep
    diagonal = keep + _diagonal(chain)
    length = 1 / (_largest_eigenvalue(chain, keep, diagonal) * diagonal)
    values, ahead, momentum = given, given, 1.0
    for _ in range(DESCENT):
        change = ahead - given
        apart = [there + mip.reads @ v for there, (mip, v) in zip(differences, _means(chain, change), strict=True)]
        gradient = keep * change + _spread_back(chain, apart)
        found = np.clip(ahead - length * gradient, low, high)
        if np.vdot(gradient, found - values) > 0:
            momentum = 1.0
        following = 0.5 * (1 + np.sqrt(1 + 4 * momentum * momentum))
        ahead = found + np.float32((momentum - 1) / following) * (found - values)
        values, momentum = found, following
    return values


def _largest_eigenvalue(
    chain: list[_Mip], keep: Float[Array, "unknowns 1"], diagonal: Float[Array, "unknowns 1"]
) -> float:
    """The normal matrix's, scaled by its diagonal; by powers, and a tenth more to be safe."""
    vector = np.random.default_rng(0).normal(size=diagonal.shape).astype(np.float32)
    value = 1.0
    for _ in range(12):
        vector /= np.linalg.norm(np.sqrt(diagonal) * vector)
        vector = (keep * vector + _spread_back(chain, [mip.reads @ v for mip, v in _means(chain, vector)])) / diagonal
        value = float(np.linalg.norm(np.sqrt(diagonal) * vector))
    return 1.1 * value


def _values(
    chain: list[_Mip],
    image: Float[Array, "height width channels"],
    one_of: Callable[[Array, Array], Array] = lambda a, b: 0.5 * (a + b),
) -> list[Float[Array, "_ channels"]]:
    """The texels of each mip in an image; `one_of` two texels becomes one of the next mip, their mean."""
    result = []
    image = image.astype(np.float32)
    for mip in chain:
        result.append(image.reshape(-1, image.shape[-1])[mip.texels])
        rows = one_of(image[::2], image[1::2])
        image = one_of(rows[:, ::2], rows[:, 1::2])
    return result


def _unknowns(chain: list[_Mip], texels: TexelMap, image: Float[Array, "height width channels"]) -> _Unknowns:
    """The texels that move, each with its unknown and its bounds, and what moving an unknown costs.

    A texel that the finest mip reads is an unknown of its own; else it belongs to the first mip's texel above it
    that is read. There those of the gutter alone move, where there are any.
    """
    size, channels = texels.size, image.shape[-1]
    owner = _owners(chain, size)
    texel = np.flatnonzero(owner >= 0)
    owner = owner[texel]
    count = sum(len(mip.texels) for mip in chain)
    weight = np.full(size * size, KEEP_GUTTER)
    weight[texels.index] = np.where(texels.inside, KEEP_INSIDE, KEEP_SKIRT)
    weight = weight[texel]
    soft = weight < KEEP_INSIDE
    # the unknowns of the finest mip come first
    far = owner >= len(chain[0].texels)
    extremes = (_values(chain, image, pick) for pick in (np.minimum, np.maximum))
    ranges = [_range(mip, *values) for mip, *values in zip(chain, *extremes, strict=True)]
    low, high = (np.concatenate([one[side] for one in ranges])[owner] for side in (0, 1))
    given = image.reshape(-1, channels)[texel]
    # a texel inside a chart gives way to coarse mips only a little, and not at all beside gutter
    stays = far & ~soft
    near = FAR_FROM_EDGE * ~(np.bincount(owner, soft, count) > 0)[owner]
    low = np.where(stays[:, None], np.maximum(low, given - near[:, None]), low)
    high = np.where(stays[:, None], np.minimum(high, given + near[:, None]), high)
    low, high = np.minimum(low, given), np.maximum(high, given)
    many = np.bincount(owner, minlength=count)
    low_mean, mean, high_mean = (
        np.stack([np.bincount(owner, channel, count) for channel in values.T], 1) / np.maximum(many, 1)[:, None]
        for values in (low, given, high)
    )
    # the least cost of changing the mean of n texels by d is d^2 n^2 / sum(1 / keep)
    keep = np.where(many > 0, many**2 / np.maximum(np.bincount(owner, 1 / weight, count), 1e-20), 1.0)[:, None]
    means = (values.astype(np.float32) for values in (low_mean, mean, high_mean, keep))
    return _Unknowns(texel, owner, low, high, *means)


def _range(mip: _Mip, least: Float[Array, "n channels"], most: Float[Array, "n channels"]) -> tuple[Array, Array]:
    """For each texel of a mip the least and the largest value that the points which read it read, on both sides."""
    readers = mip.reads.T.tocsr()
    read = np.flatnonzero(np.diff(readers.indptr))
    result = []
    for extreme, values in ((np.minimum, least), (np.maximum, most)):
        at_texel = values.copy()
        for _ in range(1 if mip.finer is None else 2):
            at_point = extreme.reduceat(at_texel[mip.reads.indices], mip.reads.indptr[:-1], axis=0)
            at_texel[read] = extreme.reduceat(at_point[readers.indices], readers.indptr[read], axis=0)
        result.append(at_texel)
    return result[0], result[1]


def _chain(uv: Float[Array, "corners 2"], edges: ChartEdges, size: int, levels: int) -> list[_Mip]:
    """The mips in use, finest first."""
    chain: list[_Mip] = []
    for number in range(levels):
        wide = size >> number
        points = edge_reads(uv, edges, wide)
        texels, place = np.unique(points.indices, return_inverse=True)
        finer, rest = None, np.ones((len(texels), 1), np.float32)
        if chain:
            below = chain[-1].texels
            above = (below // (2 * wide) // 2) * wide + below % (2 * wide) // 2
            read, texels = texels, np.union1d(texels, above)
            place = np.searchsorted(texels, read)[place]
            parent = np.searchsorted(texels, above)
            shape = (len(texels), len(below))
            finer = csr_matrix((np.full(len(below), 0.25, np.float32), (parent, np.arange(len(below)))), shape)
            rest = (1 - 0.25 * np.bincount(parent, minlength=len(texels))).astype(np.float32)[:, None]
        values = np.float32(np.sqrt(AGREE * 1024 / size * GROW**number)) * points.data.astype(np.float32)
        reads = csr_matrix((values, place, points.indptr), (len(points.indptr) - 1, len(texels)))
        reads.sum_duplicates()
        chain.append(_Mip(texels, reads, finer, rest))
    return chain


def _owners(chain: list[_Mip], size: int) -> Integer[Array, "all"]:
    """For each texel of the image the unknown that moves it, or -1: itself where the finest mip reads it, else
    the unread rest of the first mip's texel above it that is in the chain."""
    owner = np.full((1, 1), -1)
    first = sum(len(mip.texels) for mip in chain)
    for number, mip in reversed(list(enumerate(chain))):
        wide = size >> number
        owner = np.repeat(np.repeat(owner, wide // len(owner), 0), wide // len(owner), 1)
        first -= len(mip.texels)
        owner.reshape(-1)[mip.texels] = first + np.arange(len(mip.texels))
    return owner.reshape(-1)


def edge_reads(uv: Float[Array, "corners 2"], edges: ChartEdges, size: int) -> csr_matrix:
    """Bilinear reads of points along the edges in a mip: points x texels, duplicates not summed yet.

    DENSE points a texel, ends included, on the longer of the two sides; the right side counts negative.
    """
    lengths = [np.linalg.norm(uv[side[:, 1]] - uv[side[:, 0]], axis=1) * size for side in edges]
    counts = np.ceil(DENSE * np.maximum(*lengths)).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(counts)), counts)
    along = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    t = (along / np.maximum(counts - 1, 1)[edge])[:, None]
    places = ChartEdges(edges.left[edge], edges.right[edge]).places(uv, t)
    (left, left_weight), (right, right_weight) = (bilinear(place, size) for place in places)
    weight, texel = np.concatenate([left_weight, -right_weight], 1), np.concatenate([left, right], 1)
    return csr_matrix((weight.ravel(), texel.ravel(), 8 * np.arange(len(edge) + 1)), (len(edge), size * size))


def _means(chain: list[_Mip], x: Float[Array, "unknowns channels"]) -> list[tuple[_Mip, Float[Array, "_ channels"]]]:
    result: list[tuple[_Mip, Array]] = []
    first = 0
    for mip in chain:
        value = mip.rest * x[first : first + len(mip.texels)]
        first += len(mip.texels)
        if mip.finer is not None:
            value = value + mip.finer @ result[-1][1]
        result.append((mip, value))
    return result


def _spread_back(chain: list[_Mip], points: list[Float[Array, "_ channels"]]) -> Float[Array, "unknowns channels"]:
    """Transpose of reading the edges' points in every mip."""
    parts: list[Array] = []
    above: Array | None = None
    for mip, value in zip(reversed(chain), reversed(points), strict=True):
        here = mip.reads.T @ value
        if above is not None:
            here = here + above
        parts.append(mip.rest * here)
        above = None if mip.finer is None else mip.finer.T @ here
    return np.concatenate(parts[::-1])


def _diagonal(chain: list[_Mip]) -> Float[Array, "unknowns 1"]:
    """Diagonal of the normal matrix, the cross terms between mips left out."""
    squared = [
        _Mip(mip.texels, mip.reads.power(2), None if mip.finer is None else mip.finer.power(2), mip.rest**2)
        for mip in chain
    ]
    return _spread_back(squared, [np.ones((mip.reads.indptr.size - 1, 1), np.float32) for mip in chain])
