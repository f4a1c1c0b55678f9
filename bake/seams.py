"""Chart edges that agree: the texels around them are solved together, so that no mip in use shows a seam."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer, UInt8
from scipy.sparse import csr_matrix, diags

from avatar.texture import mipmaps, sample_texture
from bake.texels import TexelMap, bytes_from_unit
from geometry.mesh import half_edges

# weight of keeping a texel as it was sampled: one that shows surface, one that only bilinear filtering reads
# beside it, and one of the gutter, which nothing but coarser mips reads
KEEP_INSIDE, KEEP_SKIRT, KEEP_GUTTER = 4.0, 0.1, 0.004
# weight of a point on a chart edge looking the same from both sides, at 1024; more where texels are few
AGREE = 4.0
GROW = (
    # as many times more in each coarser mip: fewer points lie along an edge there, and means resist more
    8.0
)
STEP = 1.5 / 255
# short rounds, each urging a little more: no further than the goal
FURTHER = 8 * (8,)
# most that one round makes a point count more
URGE, URGE_FURTHER = 3.0, 1.5
# between points farther apart two bilinear images can differ much more than at them
DENSE = 3


class ChartEdges(NamedTuple):
    """Edges of the mesh that lie on the border of a chart, as both charts see them."""

    left: Integer[np.ndarray, "edges 2"]  # atlas vertices at its two ends
    # the same two ends in the other chart
    right: Integer[np.ndarray, "edges 2"]


def chart_edges(
    uv: Float[np.ndarray, "corners 2"],
    faces: Integer[np.ndarray, "faces 3"],
    source: Integer[np.ndarray, "corners"],
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
    uv: Float[np.ndarray, "corners 2"],
    edges: ChartEdges,
    image: UInt8[np.ndarray, "height width channels"],
    *,
    samples: int = 5,
) -> Float[np.ndarray, "steps"]:
    """Step (bytes, worst channel) between the two sides of every chart edge, at points along it, in one mip."""
    if len(edges.left) == 0:
        return np.zeros(0)
    steps = []
    for t in (np.arange(samples) + 0.5) / samples:
        one, other = (sample_texture(image, (1 - t) * uv[side[:, 0]] + t * uv[side[:, 1]]) for side in edges)
        steps.append(np.abs(one - other).max(1))
    return np.concatenate(steps)


class _Mip(NamedTuple):
    """One mip: its texels that matter are those read here, and those above one that a finer mip reads."""

    texels: Integer[np.ndarray, "n"]  # row * size + column, ascending
    # points on edges x texels: left side minus right side
    agree: csr_matrix
    # texels x the finer mip's texels: mean of 2 x 2
    finer: csr_matrix | None
    # share of a texel in this mip that no finer mip reads
    rest: Float[np.ndarray, "n 1"]
    weight: float  # by which the rows of `agree` are multiplied


def equalised(
    image: Float[np.ndarray, "height width channels"],
    texels: TexelMap,
    uv: Float[np.ndarray, "corners 2"],
    edges: ChartEdges,
    levels: int,
    *,
    rounds: tuple[int, ...] = (25, 15, 15),
    goal: float | None = None,
) -> Float[np.ndarray, "height width channels"]:
    """The image with its chart edges closed in the first `levels` mips, values kept in [0, 1].

    Least squares over every texel that a point on a chart edge reads in any of these mips:

        min over x   sum_i keep_i (x_i - image_i)^2 + sum_mips agree GROW^mip sum_points (left(x) - right(x))^2

    by conjugate gradients, `rounds` of them; then what left [0, 1] is held at its bound, points that still differ
    by more than STEP count up to nine times, and the others are solved again. The mips are means of 2 x 2 texels, as
    the player makes them, so a coarse mip is closed mostly by what lies in the gutters, which the finest never shows.
    Texels that only a coarse mip reads enter through their mean alone: they are one unknown, and its change goes to
    each by 1 / keep.

    With a `goal` (bytes) the rounds of FURTHER follow while the 99th percentile of the steps lies above it in any mip,
    and what a point that differs counts grows from round to round.
    """
    if len(edges.left) == 0:
        return image
    size, channels = texels.size, image.shape[-1]
    chain = _chain(uv, edges, size, levels)
    owner = _owners(chain, size)
    owned = np.flatnonzero(owner >= 0)
    owner = owner[owned]
    loose = 1 / _keep(texels)[owned]
    unknowns = sum(len(mip.texels) for mip in chain)
    slack = np.maximum(np.bincount(owner, loose, unknowns), 1e-20)
    many = np.bincount(owner, minlength=unknowns)
    # the least cost of changing the mean of n texels by d is d^2 n^2 / sum(1 / keep)
    keep = np.where(many > 0, many**2 / slack, 1.0).astype(np.float32)[:, None]
    each = (loose * (many / slack)[owner])[:, None]  # a texel's change, of its unknown's

    before = image.reshape(-1, channels)[owned]
    after = before
    result = image.reshape(-1, channels).copy()
    held = np.zeros((unknowns, channels), bool)
    urges = [np.ones(len(mip.agree.indptr) - 1, np.float32) for mip in chain]
    for passed, count in enumerate([*rounds, *FURTHER]):
        shown = result.reshape(size, size, channels)
        if passed >= len(rounds) and (goal is None or _largest(uv, edges, shown, levels) <= goal):
            break
        done = np.zeros((unknowns, channels), np.float32)
        if passed:
            for channel in range(channels):
                done[:, channel] = np.bincount(owner, (after - before)[:, channel], unknowns)
            done /= np.maximum(many, 1)[:, None]
        shown = shown.astype(np.float32)
        if passed:
            further = passed >= len(rounds)
            fresh = _urges(chain, shown, URGE_FURTHER if further else URGE)
            urges = [old * new if further else new for old, new in zip(urges, fresh, strict=True)]
        change = _solved(_urged(chain, urges), shown, keep, done, held, count)
        wanted = after + each * change[owner]
        after = np.clip(wanted, 0, 1)
        result[owned] = after
        out = np.zeros_like(held)
        for channel in range(channels):
            out[owner[wanted[:, channel] != after[:, channel]], channel] = True
        held |= out
    return result.reshape(image.shape)


def _solved(
    chain: list[_Mip],
    image: Float[np.ndarray, "height width channels"],
    keep: Float[np.ndarray, "unknowns 1"],
    done: Float[np.ndarray, "unknowns channels"],
    held: Bool[np.ndarray, "unknowns channels"],
    rounds: int,
) -> Float[np.ndarray, "unknowns channels"]:
    """Change of the unknowns that closes the edges of `image`, which has moved by `done` already; 0 where held."""
    free = (~held).astype(np.float32)
    differences = _differences(chain, image)
    residual = free * -(_spread_back(chain, differences) + keep * done)
    diagonal = keep + _diagonal(chain)
    change = np.zeros_like(residual)
    goal = 1e-9 * _dot(residual, residual)
    step = residual / diagonal
    score = _dot(residual, step)
    for _ in range(rounds):
        if (_dot(residual, residual) <= goal).all():
            break
        moved = keep * step + _spread_back(chain, [m.agree @ v for m, v in _means(chain, step)])
        moved *= free
        length = score / np.maximum(_dot(step, moved), 1e-30)
        change += length * step
        residual = residual - length * moved
        better = residual / diagonal
        fresh = _dot(residual, better)
        step = better + fresh / np.maximum(score, 1e-30) * step
        score = fresh
    return change


def _differences(
    chain: list[_Mip], image: Float[np.ndarray, "height width channels"]
) -> list[Float[np.ndarray, "_ channels"]]:
    """Left side minus right side of the points on edges, weighted, in each mip of an image."""
    result = []
    for mip in chain:
        result.append(mip.agree @ image.reshape(-1, image.shape[-1])[mip.texels])
        image = _halved(image)
    return result


def _urges(
    chain: list[_Mip], image: Float[np.ndarray, "height width channels"], most: float
) -> list[Float[np.ndarray, "_"]]:
    """For the points of each mip how much more they count: those that differ by more than STEP up to `most` times, as
    least squares leaves a few large steps."""
    return [
        np.clip(np.abs(found).max(1) / mip.weight / STEP, 1, most).astype(np.float32)
        for mip, found in zip(chain, _differences(chain, image), strict=True)
    ]


def _urged(chain: list[_Mip], urges: list[Float[np.ndarray, "_"]]) -> list[_Mip]:
    """The mips with their points weighted up."""
    return [mip._replace(agree=csr_matrix(diags(urge) @ mip.agree)) for mip, urge in zip(chain, urges, strict=True)]


def _largest(
    uv: Float[np.ndarray, "corners 2"],
    edges: ChartEdges,
    image: Float[np.ndarray, "height width channels"],
    levels: int,
) -> float:
    """The largest of the mips' 99th percentiles of steps, in bytes."""
    chain = mipmaps(bytes_from_unit(image), levels)
    return max(float(np.quantile(seam_steps(uv, edges, mip), 0.99)) for mip in chain)


def _dot(a: np.ndarray, b: np.ndarray) -> Float[np.ndarray, "channels"]:
    return np.einsum("nc,nc->c", a, b)


def _halved(image: Float[np.ndarray, "height width channels"]) -> Float[np.ndarray, "h w channels"]:
    rows = image[::2] + image[1::2]
    return 0.25 * (rows[:, ::2] + rows[:, 1::2])


def _keep(texels: TexelMap) -> Float[np.ndarray, "all"]:
    weight = np.full(texels.size * texels.size, KEEP_GUTTER)
    weight[texels.index] = np.where(texels.inside, KEEP_INSIDE, KEEP_SKIRT)
    return weight


def _chain(uv: Float[np.ndarray, "corners 2"], edges: ChartEdges, size: int, levels: int) -> list[_Mip]:
    """The mips in use, finest first."""
    chain: list[_Mip] = []
    for number in range(levels):
        wide = size >> number
        rows, columns, values, count = _edge_reads(uv, edges, wide)
        texels, place = np.unique(columns, return_inverse=True)
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
        weight = float(np.sqrt(AGREE * 1024 / size * GROW**number))
        values = (weight * values).astype(np.float32)
        agree = csr_matrix((values, (rows, place)), shape=(count, len(texels)))
        chain.append(_Mip(texels, agree, finer, rest, weight))
    return chain


def _owners(chain: list[_Mip], size: int) -> Integer[np.ndarray, "all"]:
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


def _edge_reads(
    uv: Float[np.ndarray, "corners 2"], edges: ChartEdges, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Bilinear reads of points along the edges in a mip: rows (points), texels, weights, and how many points.

    DENSE points a texel, ends included, on the longer of the two sides; the right side counts negative.
    """
    lengths = [np.linalg.norm(uv[side[:, 1]] - uv[side[:, 0]], axis=1) * size for side in edges]
    counts = np.ceil(DENSE * np.maximum(*lengths)).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(counts)), counts)
    along = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    t = (along / np.maximum(counts - 1, 1)[edge])[:, None]
    columns, values = [], []
    for side, sign in zip(edges, (1.0, -1.0), strict=True):
        place = ((1 - t) * uv[side[edge, 0]] + t * uv[side[edge, 1]]) * size - 0.5
        place = np.clip(place, 0, size - 1)
        low = np.minimum(np.floor(place).astype(np.int64), size - 2)
        share = place - low
        for right in (0, 1):
            for down in (0, 1):
                columns.append((low[:, 1] + down) * size + low[:, 0] + right)
                x = share[:, 0] if right else 1 - share[:, 0]
                y = share[:, 1] if down else 1 - share[:, 1]
                values.append(sign * x * y)
    return np.tile(np.arange(len(edge)), 8), np.concatenate(columns), np.concatenate(values), len(edge)


def _means(
    chain: list[_Mip], x: Float[np.ndarray, "unknowns channels"]
) -> list[tuple[_Mip, Float[np.ndarray, "_ channels"]]]:
    """Each mip with its texels' values."""
    result: list[tuple[_Mip, np.ndarray]] = []
    first = 0
    for mip in chain:
        value = mip.rest * x[first : first + len(mip.texels)]
        first += len(mip.texels)
        if mip.finer is not None:
            value = value + mip.finer @ result[-1][1]
        result.append((mip, value))
    return result


def _spread_back(
    chain: list[_Mip], points: list[Float[np.ndarray, "_ channels"]]
) -> Float[np.ndarray, "unknowns channels"]:
    """Transpose of reading the edges' points in every mip."""
    parts: list[np.ndarray] = []
    above: np.ndarray | None = None
    for mip, value in zip(reversed(chain), reversed(points), strict=True):
        here = mip.agree.T @ value
        if above is not None:
            here = here + above
        parts.append(mip.rest * here)
        above = None if mip.finer is None else mip.finer.T @ here
    return np.concatenate(parts[::-1])


def _diagonal(chain: list[_Mip]) -> Float[np.ndarray, "unknowns 1"]:
    """Diagonal of the normal matrix, the cross terms between mips left out."""
    parts: list[np.ndarray] = []
    above: np.ndarray | None = None
    for mip in reversed(chain):
        here = np.asarray(mip.agree.multiply(mip.agree).sum(0)).reshape(-1, 1)
        if above is not None:
            here = here + above
        parts.append(mip.rest**2 * here)
        above = None if mip.finer is None else 0.25 * (mip.finer.T @ here)
    return np.concatenate(parts[::-1]).astype(np.float32)
