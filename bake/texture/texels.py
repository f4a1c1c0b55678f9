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
    uv: Float[Array, "corners 2"],
    faces: Integer[Array, "faces 3"],
    texels: TexelMap,
    jitter: Float[Array, "2"],
    *,
    reach: float = 2.5,
) -> Float[Array, "texels 3"]:
    """Barycentric coordinates of each texel's sample in its triangle; they leave [0, 1] on the skirt.

    At most `reach` texels outside: in a triangle thinner than a texel the coordinates would run away, so they
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
    wild = outside[(beyond > reach) | (np.abs(result[outside]).max(1) > 50)]
    clipped = np.clip(result[wild], 0, None)
    result[wild] = clipped / clipped.sum(1, keepdims=True)
    return result


def spread(values: Float[Array, "texels channels"], texels: TexelMap, rest: float = 0.0) -> Array:
    """Image (size, size, channels) with every uncovered texel set to the nearest covered one's value."""
    image = np.full((texels.size * texels.size, values.shape[1]), rest)
    image[texels.index] = values
    image = image.reshape(texels.size, texels.size, -1)
    covered = np.zeros(texels.size * texels.size, bool)
    covered[texels.index] = True
    if not covered.any():
        return image
    covered = covered.reshape(texels.size, texels.size)
    return image[nearest_marked(covered)]


def sample_texels(
    color: Callable[[Integer[Array, "rows"], Array], Float[Array, "rows 3"]],
    texels: TexelMap,
    *,
    contrast: float = 4 / 255,
    samples: int = len(JITTER),
) -> Float[Array, "texels 3"]:
    """Mean color of each texel: its centre, and up to `samples` in all where neighbours differ.

    color(rows, jitter) returns the color of those rows of `texels` at their centres moved by jitter (texels);
    the centres of all rows are asked first. Where a centre differs from its neighbours by no more than
    `contrast`, more samples would not change its byte by one.
    """
    first = color(np.arange(len(texels.index)), JITTER[0])
    grid = np.full((texels.size * texels.size, 3), np.nan, np.float32)
    grid[texels.index] = first
    grid = grid.reshape(texels.size, texels.size, 3)
    busy = np.zeros((texels.size, texels.size), bool)
    across = np.abs(np.diff(grid, axis=1)).max(-1) > contrast  # NaN compares False
    down = np.abs(np.diff(grid, axis=0)).max(-1) > contrast
    busy[1:] |= down
    busy[:-1] |= down
    busy[:, 1:] |= across
    busy[:, :-1] |= across
    rows = np.flatnonzero(busy.reshape(-1)[texels.index])
    if len(rows) == 0:
        return first
    result = first.copy()
    for jitter in JITTER[1:samples]:
        result[rows] += color(rows, jitter)
    result[rows] /= samples
    return result
