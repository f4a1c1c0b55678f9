"""What no video saw is filled from what was seen: cloth round its limb, the rest with the color of its material.

Stripes, cuffs, hems and collars run round trunk, arms and legs: there seen texels of a piece are laid on a grid of
rings, lengths along the limb by angles about it, and each ring is closed between the seen places at both ends of a gap,
so that the outside of a sleeve that no video saw goes over from its front to its back. Where a limb has no direction
(neck and collar bones), an unseen texel shows the mean of the nearest seen places that face its way.

Elsewhere (head, hands, feet) seen texels are grouped by color into materials: skin, hair, each color of a cloth. A
material's color anywhere is as smooth on the surface as its seen texels allow:

    min over x of material m   sum_vertices w_m (x - c_m)^2  +  sum_edges k_ij (x_i - x_j)^2

c_m is the mean color of the material's seen texels round a vertex and w_m how much surface they cover there. An unseen
texel may be of any material that the nearest seen places of its own piece (skin under hair is none of the hair's) which
face its way are of, and is of one: the one whose color there lies nearest to what the field made of it, the more of
these places it has the sooner. What the field made of it stays as far as it lies within NEAR of that color: a grey
between two colors of a print is no color of the cloth. So skin beside skin becomes skin, and stripes stay stripes. In
the end one material goes over into another, and into what was seen, within some millimetres: places vote cell by cell,
and a hairline would be a saw. The rim of hair that ends on seen skin shows the mean of what was seen round it, of
either.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array
from scipy.cluster.vq import kmeans2
from scipy.ndimage import gaussian_filter1d, map_coordinates
from scipy.sparse import csr_matrix, diags
from scipy.spatial import KDTree

from avatar.rotation import unit_or_zero
from bake.texture.texture_solve import laplacian
from geometry.least_squares import factorised
from geometry.mesh import TriangleMesh, blended, half_edges

# groups that colors fall into at most, and how far apart two groups lie at least (root mean square over the channels)
MATERIALS, APART = 8, 0.07
# seen places, one in each cell of so many metres, that vote on an unseen texel's materials, the share of votes that a
# material needs, and how far apart normals may be (cosine)
VOTES, CELL, ENOUGH, FACING = 24, 0.0025, 0.15, 0.0
# a number for each cell within a kilometre and eighth of all directions
CELL_KEY = np.array([1 << 42, 1 << 23, 1 << 4, 1, 2, 4])
# seen places whose mean an unseen texel of no direction shows, metres at which a place counts half as much as one at
# the texel
ROUND, SOFT = 10, 0.002
# a ring of a limb: metres along it, cells round it, deviation in rings of what lies beside it and counts as well, cells
# that must be seen before it is closed by them
RING, TURN, BESIDE, KNOWN = 0.0025, 90, 1.0, 4
# how many times farther from the axis, or nearer, what a ring shows may be than a texel: up to the first it is of the
# same layer, from the second on of another, as a skirt is round a leg
LAYER = (1.2, 1.4)
# deviation in rings within which a limb is straight
STRAIGHT = 6.0
# how far from its materials' colors an unseen texel's may be
NEAR = 6 / 255
# metres over which one material goes over into another, the texels that this is asked of, and how much more than others
# those count that were seen
BLEND, BLENDED, SEEN = 0.003, 32, 4.0
# metres from seen skin within which hair ends on it
TOUCHING = 0.004
# stiffness of an edge against all the seen surface round a vertex
STIFF = 0.05


class TexelSurface(NamedTuple):
    """Texels on a mesh: where each lies and which way it faces."""

    mesh: TriangleMesh
    corners: Integer[Array, "texels 3"]  # vertices of each texel's triangle
    weight: Float[Array, "texels 3"]  # barycentric
    points: Float[Array, "texels 3"]
    normals: Float[Array, "texels 3"]
    area: Float[Array, "texels"]
    piece: Integer[Array, "texels"]  # the connected piece of the surface
    limbs: Integer[Array, "texels 2"]  # rows of `axes`: the limb that each is of, and the one that it goes over into
    over: Float[Array, "texels"]  # how much of it is the second's, [0, 1/2]
    axes: Float[Array, "limbs 3"]  # unit, along each limb; zero: none, NaN: no limb, it is filled by material


def filled_colors(
    surface: TexelSurface, color: Float[Array, "texels 3"], seen: Bool[Array, "texels"]
) -> Float[Array, "unseen 3"]:
    """Colors for the texels that were not `seen`, in their order. Where none was seen, their own colors."""
    unseen = np.flatnonzero(~seen)
    if len(unseen) == 0 or len(unseen) == len(seen):
        return color[unseen]
    of_limb = np.isfinite(surface.axes[surface.limbs[unseen, 0], 0])
    result = np.empty((len(unseen), 3), color.dtype)
    result[of_limb] = round_limbs(surface, color, seen, unseen[of_limb])
    result[~of_limb] = by_material(surface, color, seen, unseen[~of_limb])
    rims = rims_of_hair(surface, seen, unseen)
    result[rims] = beside(surface, color, np.flatnonzero(seen), unseen[rims])
    return result


def rims_of_hair(
    surface: TexelSurface, seen: Bool[Array, "texels"], unseen: Integer[Array, "unseen"]
) -> Bool[Array, "unseen"]:
    """Which unseen texels are of hair that ends on the seen skin: its edge is a saw of triangles, and shows if it has
    another color than what is painted there."""
    body = largest_piece(surface)
    on, rims = seen & (surface.piece == body), surface.piece[unseen] != body
    if not on.any() or not rims.any():
        return np.zeros(len(unseen), bool)
    tree = KDTree(surface.points[on])
    rims[rims] = tree.query(surface.points[unseen[rims]], distance_upper_bound=TOUCHING)[0] < TOUCHING
    return rims


def round_limbs(
    surface: TexelSurface, color: Float[Array, "texels 3"], seen: Bool[Array, "texels"], rows: Integer[Array, "rows"]
) -> Float[Array, "rows 3"]:
    """Colors for texels of limbs: what lies beside them round the limb, at a joint of both limbs."""
    result = np.zeros((len(rows), 3), color.dtype)
    limbs, over = surface.limbs[rows], surface.over[rows]
    for piece in np.unique(surface.piece[rows]):
        whole, given = surface.piece[rows] == piece, seen_places(surface, seen, int(piece))
        near = beside(surface, color, given, rows[whole])
        shown = given[surface.piece[given] == piece]
        for limb in np.unique(limbs[whole]):
            weight = ((1 - over) * (limbs[:, 0] == limb) + over * (limbs[:, 1] == limb))[whole]
            own, axis = weight > 0, surface.axes[limb]
            found, asked = near[own].copy(), rows[whole][own]
            same = np.flatnonzero((surface.piece == piece) & (surface.limbs[:, 0] == limb))
            if axis.any() and len(same) and len(asked):
                rings, of_limb = Rings.about(axis, surface.points[same]), shown[surface.limbs[shown, 0] == limb]
                # the inside of cloth is none of its outside
                inside_given, inside_asked = ~rings.faces_out(surface, of_limb), ~rings.faces_out(surface, asked)
                for inside in (False, True):
                    some = inside_asked == inside
                    places = of_limb[inside_given == inside]
                    found[some] = rings.closed(surface, color, places, asked[some], found[some])
            result[np.flatnonzero(whole)[own]] += weight[own, None] * found
    return result


def beside(
    surface: TexelSurface, color: Float[Array, "texels 3"], given: Integer[Array, "given"],
    asked: Integer[Array, "asked"],
) -> Float[Array, "asked 3"]:  # fmt: skip
    """The mean of the nearest seen places that face the way of each texel that is asked."""
    away, near = nearest_places(surface, given, asked, ROUND)
    facing = np.einsum("nkc,nc->nk", surface.normals[near], surface.normals[asked]) > FACING
    weight = (facing + 1e-3) / (np.square(away) + SOFT**2)
    return np.einsum("nk,nkc->nc", weight / weight.sum(1, keepdims=True), color[near])


class Rings(NamedTuple):
    """Cylinder coordinates about a limb, metres."""

    frame: Float[Array, "3 3"]  # rows: unit, along it and two across
    low: float  # along it, where the first ring begins
    middles: Float[Array, "rings 2"]  # across it

    @classmethod
    def about(cls, axis: Float[Array, "3"], points: Float[Array, "points 3"]) -> "Rings":
        """Of a limb's points, each ring about its own middle: a limb is no straight cylinder."""
        across = unit_or_zero(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]))
        frame = np.stack([axis, across, np.cross(axis, across)])
        along, *sides = (points @ frame.T).T
        low, count = float(along.min()), int(np.ptp(along) / RING) + 1
        ring = np.clip(((along - low) / RING).astype(int), 0, count - 1)
        sums = np.stack([np.bincount(ring, weight, count) for weight in (None, *sides)], -1)
        sums = gaussian_filter1d(sums, STRAIGHT, 0, mode="constant") + 1e-9 * sums.sum(0)
        return cls(frame, low, sums[:, 1:] / sums[:, :1])

    def cylinder(self, points: Float[Array, "points 3"]) -> tuple[Float[Array, "points"], Float[Array, "points 2"]]:
        """Ring, whole in its middle, and metres across from that ring's middle."""
        along, *sides = (points @ self.frame.T).T
        every = np.arange(len(self.middles))
        ring = np.clip((along - self.low) / RING - 0.5, 0, len(every) - 1)
        return ring, np.stack([x - np.interp(ring, every, own) for x, own in zip(sides, self.middles.T)], -1)

    def faces_out(self, surface: TexelSurface, rows: Integer[Array, "rows"]) -> Bool[Array, "rows"]:
        """Whether texels face away from the limb's middle."""
        outward = self.cylinder(surface.points[rows])[1]
        return ((surface.normals[rows] @ self.frame[1:].T) * outward).sum(1) > 0

    def cells(self, points: Float[Array, "points 3"]) -> tuple[Float[Array, "points"], ...]:
        """Ring and cell of it, with fractions: those of the first cell's middle are 0. And metres from the axis."""
        ring, (x, y) = (part.T for part in self.cylinder(points))
        return ring, (np.arctan2(y, x) / (2 * np.pi) * TURN - 0.5) % TURN, np.hypot(x, y)

    def closed(
        self, surface: TexelSurface, color: Float[Array, "texels 3"], given: Integer[Array, "given"],
        asked: Integer[Array, "asked"], otherwise: Float[Array, "asked 3"],
    ) -> Float[Array, "asked 3"]:  # fmt: skip
        """Colors round the limb for texels that are asked; `otherwise` where little of it was seen, or cloth."""
        ring, turn, reach = self.cells(surface.points[given])
        cell = np.round(ring).astype(int) * TURN + np.round(turn).astype(int) % TURN
        count = len(self.middles)
        sums = [np.bincount(cell, weight, count * TURN) for weight in (None, *color[given].T, reach)]
        sums = np.stack(sums, -1).reshape(count, TURN, 5).astype(np.float64)
        sums = gaussian_filter1d(sums, BESIDE, 0, mode="constant", truncate=2)
        sure = sums[..., 0] > 0.05
        whole = np.flatnonzero(sure.sum(1) >= KNOWN)
        if not len(whole):
            return otherwise
        # a cell more, which is the first again
        grid, every = np.empty((len(whole), TURN + 1, 4)), np.arange(TURN + 1)
        for row, number in enumerate(whole):
            there = np.flatnonzero(sure[number])
            shown = sums[number, there, 1:] / sums[number, there, :1]
            grid[row] = np.stack([np.interp(every, there, channel, period=TURN) for channel in shown.T], -1)
        ring, turn, reach = self.cells(surface.points[asked])
        # between the nearest of these rings on both sides
        at = np.interp(ring, whole, np.arange(len(whole)))
        low = np.floor(at)
        total, result = np.zeros(len(asked)), np.zeros((len(asked), 3))
        for row, weight in ((low, 1 - at + low), (np.minimum(low + 1, len(whole) - 1), at - low)):
            *found, shown = (map_coordinates(grid[..., k], (row, turn), order=1, mode="nearest") for k in range(4))
            off = np.maximum(shown / np.maximum(reach, 1e-9), reach / np.maximum(shown, 1e-9))
            share = weight * np.clip((LAYER[1] - off) / (LAYER[1] - LAYER[0]), 0, 1)
            total += share
            result += share[:, None] * np.stack(found, -1)
        return result + (1 - total[:, None]) * otherwise


def seen_places(surface: TexelSurface, seen: Bool[Array, "texels"], piece: int) -> Integer[Array, "places"]:
    """Seen texels of a piece, one in each CELL; of all pieces where none was seen of it."""
    own = seen & (surface.piece == piece)
    return one_of_each_cell(surface, np.flatnonzero(own if own.any() else seen))


def one_of_each_cell(surface: TexelSurface, rows: Integer[Array, "rows"]) -> Integer[Array, "places"]:
    """One texel of all that lie in a cell and face the same way."""
    return rows[np.unique(cells(surface, rows), return_index=True)[1]]


def largest_piece(surface: TexelSurface) -> int:
    """The piece of most texels: the body, whose hair hangs."""
    return int(np.bincount(surface.piece).argmax())


def cells(surface: TexelSurface, rows: Integer[Array, "rows"]) -> Integer[Array, "rows"]:
    """A number for the cell in which each texel lies together with the eighth of all directions that it faces."""
    cell = np.concatenate([np.floor(surface.points[rows] / CELL), surface.normals[rows] > 0], 1)
    return cell.astype(np.int64) @ CELL_KEY


def by_material(
    surface: TexelSurface, color: Float[Array, "texels 3"], seen: Bool[Array, "texels"], unseen: Integer[Array, "rows"]
) -> Float[Array, "rows 3"]:
    """Colors for texels of what they are made of."""
    centres = material_centres(color[seen])
    material = np.argmin([np.square(color - centre).sum(1) for centre in centres], axis=0)
    share = material_shares(surface, material, seen, unseen, len(centres))
    least, nearest = np.full(len(unseen), np.inf), color[unseen].copy()
    stiffness = _stiffness(surface.mesh)
    for number in np.flatnonzero((share >= ENOUGH).any(0)):
        chosen = np.flatnonzero(share[:, number] >= ENOUGH)
        at_vertex = _spread_on_mesh(surface, color, np.flatnonzero(seen & (material == number)), stiffness)
        own = unseen[chosen]
        found = blended(at_vertex, surface.corners[own], surface.weight[own])
        cost = (np.square(color[own] - found).sum(1) + NEAR**2) / share[chosen, number]
        better = cost < least[chosen]
        least[chosen[better]], nearest[chosen[better]] = cost[better], found[better]
    found = color.copy()
    found[unseen] = np.clip(np.clip(color[unseen], nearest - NEAR, nearest + NEAR), 0, 1)
    return blurred(surface, found, seen, unseen)


def blurred(
    surface: TexelSurface, color: Float[Array, "texels 3"], seen: Bool[Array, "texels"], unseen: Integer[Array, "rows"]
) -> Float[Array, "rows 3"]:
    """Colors of texels, each the mean of its piece's within BLEND that face its way; what was seen counts more."""
    result, filled = color[unseen], np.zeros(len(seen), bool)
    filled[unseen] = True
    for piece in np.unique(surface.piece[unseen]):
        own = surface.piece[unseen] == piece
        given = np.flatnonzero((seen | filled) & (surface.piece == piece))
        away, near = nearest_places(surface, given, unseen[own], BLENDED)
        facing = np.einsum("nkc,nc->nk", surface.normals[near], surface.normals[unseen[own]]) > FACING
        weight = np.exp(-0.5 * np.square(away / BLEND)) * facing * np.where(seen[near], SEEN, 1)
        # a texel faces its own way, whatever its normal is
        weight[:, 0] = np.maximum(weight[:, 0], 1e-6)
        result[own] = np.einsum("nk,nkc->nc", weight / weight.sum(1, keepdims=True), color[near])
    return result


def material_centres(color: Float[Array, "n 3"]) -> Float[Array, "materials 3"]:
    """Colors of the groups: by k-means from seeds that lie far apart, groups nearer than APART joined."""
    rng = np.random.default_rng(0)
    some = color[rng.choice(len(color), min(len(color), 6000), replace=False)].astype(np.float64)
    seeds = [np.median(some, axis=0)]
    while len(seeds) < MATERIALS:
        away = np.min([np.square(some - seed).mean(1) for seed in seeds], axis=0)
        # not the farthest, which may be one stray texel: the middle of the farthest hundredth
        far = some[np.argsort(away)[-max(len(some) // 100, 1) :]]
        candidate = far[np.argmin(np.abs(far - np.median(far, axis=0)).sum(1))]
        if np.sqrt(np.min([np.square(candidate - seed).mean() for seed in seeds])) < APART:
            break
        seeds.append(candidate)
    centres, _ = kmeans2(some, np.array(seeds), minit="matrix", missing="warn")
    kept: list[Array] = []
    for centre in centres:
        if all(np.sqrt(np.square(centre - other).mean()) > APART for other in kept):
            kept.append(centre)
    return np.array(kept)


def material_shares(
    surface: TexelSurface, material: Integer[Array, "texels"], seen: Bool[Array, "texels"],
    unseen: Integer[Array, "unseen"], count: int,
) -> Float[Array, "unseen materials"]:  # fmt: skip
    """Of each unseen texel, how the nearest seen places of its piece that face its way are divided among the materials;
    the largest share is made 1, so that one is always enough. Pieces without a seen place are asked of all."""
    share = np.zeros((len(unseen), count))
    apart = surface.piece[unseen]
    for piece in np.unique(apart):
        given, asked = seen_places(surface, seen, int(piece)), unseen[apart == piece]
        # one for all texels of a cell
        _, first, same = np.unique(cells(surface, asked), return_index=True, return_inverse=True)
        asked, rows = asked[first], np.arange(len(first))
        total = np.zeros((len(asked), count))
        for near in nearest_places(surface, given, asked, VOTES)[1].T:
            cosine = (surface.normals[near] * surface.normals[asked]).sum(1)
            total[rows, material[near]] += (cosine > FACING) + 1e-3
        total /= total.sum(1, keepdims=True)
        total[rows, total.argmax(1)] = 1.0
        share[apart == piece] = total[same]
    return share


def nearest_places(
    surface: TexelSurface, given: Integer[Array, "given"], asked: Integer[Array, "asked"], most: int
) -> tuple[Float[Array, "asked near"], Integer[Array, "asked near"]]:
    """Of the `given` texels the nearest to each that is asked, and how far they are."""
    count = min(most, len(given))
    found = KDTree(surface.points[given]).query(surface.points[asked], count, workers=-1)
    away, near = (values.reshape(len(asked), count) for values in found)
    return away, given[near]


def _spread_on_mesh(
    surface: TexelSurface, color: Float[Array, "texels 3"], own: Integer[Array, "own"], stiffness: csr_matrix
) -> Float[Array, "vertices 3"]:
    """The color of one material at every vertex, from its seen texels `own`."""
    count = len(surface.mesh.vertices)
    weight = surface.weight[own] * surface.area[own, None]
    corners = surface.corners[own].ravel()
    covered = np.bincount(corners, weight.ravel(), count)
    sums = np.stack([np.bincount(corners, (weight * color[own, k, None]).ravel(), count) for k in range(3)], 1)
    scale = covered[covered > 0].mean()
    middle = sums.sum(0) / covered.sum()
    # the last term holds pieces of the mesh on which the material was nowhere seen
    system = diags(covered / scale + 1e-6) + STIFF * stiffness
    return factorised(system).solve(sums / scale + 1e-6 * middle)


def _stiffness(mesh: TriangleMesh) -> csr_matrix:
    """Graph Laplacian with edges as stiff as they are short, the mean one 1."""
    ends = np.sort(half_edges(mesh.faces), axis=1)
    pairs = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0)
    length = np.linalg.norm(mesh.vertices[pairs[:, 0]] - mesh.vertices[pairs[:, 1]], axis=1)
    stiff = np.clip(np.median(length) / np.maximum(length, 1e-9), 0.1, 10)
    return laplacian(pairs, stiff, len(mesh.vertices))
