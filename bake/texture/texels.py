"""Texels <-> surface: which triangle and which canonical point a texel shows, and its base color."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array

from geometry.cells import nearest_marked

# where in a texel the color is sampled: its centre, then three places around it
JITTER = np.array([[0.0, 0.0], [-0.1, -0.37], [0.37, 0.1], [-0.27, 0.27]])

# texels this far outside their chart are still given the surface that lies there: bilinear filtering reads
# them at a chart's edge, and both sides of the edge then see the same surface
SKIRT = 1.5
# texels outside of its triangle up to which a sample keeps its barycentric coordinates
BEYOND = 2.5
# a texel's centre differs from its neighbours by so little that more samples would not change its byte by one
CONTRAST = 4 / 255


class TexelMap(NamedTuple):
    """The texels of an atlas that show surface, in row-major order."""

    # row * size + column; row 0 is v = 0
    index: Integer[Array, "texels"]
    face: Integer[Array, "texels"]
    # centre inside its triangle; others are the charts' skirt
    inside: Bool[Array, "texels"]
    size: int

    def rows(self, chosen: Integer[Array, "rows"]) -> "TexelMap":
        return TexelMap(self.index[chosen], self.face[chosen], self.inside[chosen], self.size)

    def row_of(self) -> Integer[Array, "size size"]:
        """The row of each texel of the atlas; -1 where it shows no surface."""
        row = np.full((self.size, self.size), -1, np.int32)
        row.reshape(-1)[self.index] = np.arange(len(self.index), dtype=np.int32)
        return row

    def nearest_row(self) -> Integer[Array, "size size"]:
        """The row that stands for each texel of the atlas: its own or the nearest."""
        row = self.row_of()
        return row[nearest_marked(row >= 0)]


def neighbour_pairs(texels: TexelMap) -> Integer[Array, "pairs 2"]:
    """Rows of texels that lie side by side in the atlas, each pair once."""
    row = texels.row_of()
    across = np.stack([row[:, :-1].ravel(), row[:, 1:].ravel()], 1)
    down = np.stack([row[:-1].ravel(), row[1:].ravel()], 1)
    pairs = np.concatenate([across, down])
    return pairs[(pairs >= 0).all(1)]


def bilinear(uv: Float[Array, "*n 2"], size: int) -> tuple[Integer[Array, "*n 4"], Float[Array, "*n 4"]]:
    """The texels (row * size + column) that a bilinear filter reads at texture coordinates, and their weights."""
    place = np.clip(uv * size - 0.5, 0, size - 1)
    low = np.minimum(np.floor(place).astype(np.int32), size - 2)
    share = (place - low).astype(uv.dtype)
    first, x, y = low[..., 1] * size + low[..., 0], share[..., 0], share[..., 1]
    texels = np.stack([first, first + 1, first + size, first + size + 1], -1)
    return texels, np.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], -1)


def rasterise_charts(
    uv: Float[Array, "corners 2"], faces: Integer[Array, "faces 3"], size: int, *, skirt: float = SKIRT
) -> TexelMap:
    """Triangle of every texel whose centre lies in one, or within `skirt` texels of one.

    A texel takes the triangle it is deepest inside, so that a skirt never covers a chart, and a chart thinner
    than a texel still owns the texels it passes through.
    """
    corners = uv[faces] * size
    low = np.clip(np.floor(corners.min(1) - skirt - 0.5).astype(np.int64) + 1, 0, size - 1)
    high = np.clip(np.ceil(corners.max(1) + skirt - 0.5).astype(np.int64) - 1, 0, size - 1)
    extent = np.maximum(high - low + 1, 0)
    lines = _lines(corners)
    # a triangle without area in the atlas owns no texel: it borrows one from a neighbour (atlas.place_degenerate_faces)
    owns = atlas_areas(corners) > 0.5e-6
    counts = extent[:, 0] * extent[:, 1] * owns
    depth = np.full(size * size, -np.inf, np.float32)
    owner = np.full(size * size, -1, np.int64)
    bounds = np.searchsorted(np.cumsum(counts), np.arange(0, counts.sum() + 4_000_000, 4_000_000))
    bounds = np.unique(np.append(bounds, len(faces)))
    for first, last in zip(bounds[:-1], bounds[1:], strict=True):
        own = np.arange(first, last)
        face = np.repeat(own, counts[own])
        if len(face) == 0:
            continue
        local = np.arange(len(face)) - np.repeat(np.cumsum(counts[own]) - counts[own], counts[own])
        column = low[face, 0] + local % extent[face, 0]
        row = low[face, 1] + local // extent[face, 0]
        centre = np.stack([column + 0.5, row + 0.5], 1)
        inset = _depth(lines, face, centre)
        # nothing farther from a line is nearer to its triangle
        close = inset > -skirt
        texel, face, centre, inset = (row * size + column)[close], face[close], centre[close], inset[close]
        outside = np.flatnonzero(inset < 0)
        inset[outside] = -_away(corners, face[outside], centre[outside])
        close = inset > -skirt
        texel, face, inset = texel[close], face[close], inset[close].astype(np.float32)
        # deepest last; ties go to the lower face
        order = np.lexsort((-face, inset))
        texel, face, inset = texel[order], face[order], inset[order]
        deeper = inset > depth[texel]
        texel, face, inset = texel[deeper], face[deeper], inset[deeper]
        # NumPy keeps the last of repeated indices, which the order makes the deepest
        depth[texel], owner[texel] = inset, face
    index = np.flatnonzero(owner >= 0)
    return TexelMap(index, owner[index], depth[index] >= 0, size)


def atlas_areas(corners: Float[Array, "faces 3 2"]) -> Float[Array, "faces"]:
    """Area of each triangle of an atlas, in the square of the unit of its corners."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def _lines(corners: Float[Array, "faces 3 2"]) -> Float[Array, "faces 3 3"]:
    """Each side of each triangle as (a, b, c): a x + b y + c is the depth inside of it, texels."""
    ahead = np.roll(corners, -1, axis=1) - corners
    area = ahead[:, 0, 0] * ahead[:, 1, 1] - ahead[:, 0, 1] * ahead[:, 1, 0]
    scale = np.where(area < 0, -1.0, 1.0)[:, None] / np.maximum(np.hypot(ahead[..., 0], ahead[..., 1]), 1e-6)
    a, b = -ahead[..., 1] * scale, ahead[..., 0] * scale
    return np.stack([a, b, -(a * corners[..., 0] + b * corners[..., 1])], -1)


def _depth(
    lines: Float[Array, "faces 3 3"], face: Integer[Array, "n"], points: Float[Array, "n 2"]
) -> Float[Array, "n"]:
    """Depth of points behind the nearest side's line, texels; outside minus the distance to the farthest line."""
    x, y = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
    result = np.full(len(points), np.inf)
    for side in range(3):
        a, b, c = (np.ascontiguousarray(lines[:, side, k])[face] for k in range(3))
        np.minimum(result, a * x + b * y + c, out=result)
    return result


def _away(
    corners: Float[Array, "faces 3 2"], face: Integer[Array, "n"], points: Float[Array, "n 2"]
) -> Float[Array, "n"]:
    """Distance of points from the border of their triangles, texels."""
    triangle = corners[face]
    result = np.full(len(points), np.inf)
    for side in range(3):
        start = triangle[:, side]
        ahead = triangle[:, (side + 1) % 3] - start
        x, y = (points - start).T
        square = np.maximum(ahead[:, 0] ** 2 + ahead[:, 1] ** 2, 1e-12)
        along = np.clip((x * ahead[:, 0] + y * ahead[:, 1]) / square, 0, 1)
        np.minimum(result, (x - along * ahead[:, 0]) ** 2 + (y - along * ahead[:, 1]) ** 2, out=result)
    return np.sqrt(result)


def barycentric(
    uv: Float[Array, "corners 2"], faces: Integer[Array, "faces 3"], texels: TexelMap, jitter: Float[Array, "2"]
) -> Float[Array, "texels 3"]:
    """Barycentric coordinates of each texel's sample in its triangle; they leave [0, 1] on the skirt.

    At most BEYOND texels outside: in a triangle thinner than a texel the coordinates would run away, so they
    are clamped to the triangle there.
    """
    corners = uv[faces[texels.face]] * texels.size
    column, row = texels.index % texels.size, texels.index // texels.size
    p = np.stack([column, row], 1) + 0.5 + jitter - corners[:, 0]
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    determinant = e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]
    one, other = (e1**2).sum(1), (e2**2).sum(1)
    longest, first = np.maximum(one, other), one >= other
    flat = np.abs(determinant) < 1e-3 * longest + 1e-9
    safe = np.where(flat, 1.0, determinant)
    b = (p[:, 0] * e2[:, 1] - p[:, 1] * e2[:, 0]) / safe
    c = (e1[:, 0] * p[:, 1] - e1[:, 1] * p[:, 0]) / safe
    result = np.stack([1 - b - c, b, c], 1)
    # a degenerate triangle: along its longer side
    side = np.where(first[:, None], e1, e2)
    along = np.clip((p * side).sum(1) / np.maximum((side**2).sum(1), 1e-12), 0, 1)
    line = np.stack([1 - along, np.where(first, along, 0), np.where(first, 0, along)], 1)
    result[flat] = line[flat]
    outside = np.flatnonzero((result[:, 0] < 0) | (result[:, 1] < 0) | (result[:, 2] < 0))
    beyond = _away(uv[faces] * texels.size, texels.face[outside], p[outside] + corners[outside, 0])
    wild = outside[(beyond > BEYOND) | (np.abs(result[outside]).max(1) > 50)]
    clipped = np.clip(result[wild], 0, None)
    result[wild] = clipped / clipped.sum(1, keepdims=True)
    return result


def spread(values: Float[Array, "texels channels"], texels: TexelMap) -> Float[Array, "size size channels"]:
    """The image with every uncovered texel set to the nearest covered one's value; black where none is covered."""
    if not len(values):
        return np.zeros((texels.size, texels.size, values.shape[1]))
    return values[texels.nearest_row()]


def sample_texels(
    color: Callable[[Integer[Array, "rows"], Array], Float[Array, "rows 3"]], texels: TexelMap, *,
    samples: int = len(JITTER),
) -> Float[Array, "texels 3"]:  # fmt: skip
    """Mean color of each texel: its centre, and up to `samples` in all where neighbours differ.

    color(rows, jitter) returns the color of those rows of `texels` at their centres moved by jitter (texels);
    the centres of all rows are asked first.
    """
    first = color(np.arange(len(texels.index)), JITTER[0])
    pairs, shown = neighbour_pairs(texels), first.astype(np.float32)
    rows = np.unique(pairs[np.abs(shown[pairs[:, 0]] - shown[pairs[:, 1]]).max(1) > CONTRAST])
    if len(rows) == 0:
        return first
    result = first.copy()
    for jitter in JITTER[1:samples]:
        result[rows] += color(rows, jitter)
    result[rows] /= samples
    return result
