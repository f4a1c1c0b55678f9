"""Hair that hangs below the head as a surface of its own: two closed layers in place of one.

Training learns one signed distance s of everything. Where hair hangs down to neck and shoulders, one closed surface
joins what moves with the head to what does not, and skinning draws it out into sheets; at cheek, ear and forehead it
paints hair on a lid over the skin. So space is divided there:

    h(x) = max(g(z) - d(x), z(x))            h < 0: this place is hair's
    body = max(s, -h)                        skin goes on under the hair
    hair = max(s, g(z) - OVERLAP - d(x), z(x))
    g(z) = GAP (1 - min(-z / MARGIN, 1))     where d is as good as learned, beside hair, its noise is no hair

with d the signed distance of the skin (the template without its hair, moved to where s has the skin beside the hair
and harmonically in between under it), z the distance to the hair grown by MARGIN. Hair is what was carved and, joined
to it above the height where all skin follows the head alone (parts.py), what s has farther than THIN off the
skin. Hair follows the head's bone alone, the body has the weights of the skin.

Canonical frame, metres.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage

from avatar.skeleton import JOINTS, PARTS
from avatar.skinning import dense_weights
from capture.folder import CaptureSubject
from capture.template.grid import DistanceGrid, distance_grid
from capture.template.surface import sample_grid, surface_cloud
from geometry.cells import distance_to, pieces
from geometry.harmonic import fill_reached
from geometry.isosurface import PointFunction
from geometry.mesh import vertex_normals

BODY, HAIR = 0, 1
HEAD = JOINTS.index("head")

CELL = 0.006  # metres, the grids'
GAP = 0.002  # at the edge of the hair's zone the body ends so far off its skin, under hair on it
OVERLAP = 0.001  # hair begins so much deeper
MARGIN = 0.015  # learned hair lies so far beyond the carved one at most
KEPT = 0.003  # beside and under hair the body reaches to its skin less so much
SOLID = 0.008  # deeper under the outer surface all is solid
THIN = 0.006  # what stands less off the skin than this is no hair
# square metres: a smaller piece of hair is dropped
LEAST_HAIR = 0.001
# metres from the head: farther off the template is no skin
SKIN = 0.003
# cloth stands no farther off the template where its offset is measured
OFFSETS = np.linspace(-0.012, 0.03, 22)


@dataclass(frozen=True)
class HairLayers:
    """Where hair is a layer of its own."""

    skin: DistanceGrid  # d
    zone: DistanceGrid  # z
    depth: DistanceGrid  # under the outer surface of the whole, 0 outside of it

    def box(self) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
        """The corners of the box outside of which there is only the body's layer."""
        low = self.zone.low.astype(np.float64)
        return low, low + self.zone.cell * (np.array(self.zone.values.shape) - 1)

    def divide(
        self, points: Float[Array, "n 3"], distance: Float[Array, "n"]
    ) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
        """Signed distances of body and hair at points where the whole has `distance`; positive outside each."""
        body, hair = np.array(distance, np.float64), np.full(len(points), 1.0)
        low, high = self.box()
        near = np.flatnonzero(((points > low) & (points < high)).all(1))
        d, z, deep = (grid.at(points[near]).astype(np.float64) for grid in (self.skin, self.zone, self.depth))
        gap = GAP * (1 - np.clip(-z / MARGIN, 0, 1))
        own = np.maximum(gap - d, z)
        # skin under hair was never seen, deep inside there are sheets never trained: a division would open them
        whole = np.where(z < 0, np.minimum(distance[near], d + KEPT), distance[near])
        whole = np.where((deep > SOLID) | (d < -SOLID), np.minimum(whole, -0.5 * SOLID), whole)
        body[near] = np.maximum(whole, -own)
        hair[near] = np.maximum.reduce([whole, gap - OVERLAP - d, z])
        return body, hair

    def distance(self, layer: int, whole: PointFunction) -> PointFunction:
        """The signed distance of one layer, given that of the whole."""
        return lambda points: self.divide(points, whole(points))[layer]

    def normal(self, layer: int, whole: PointFunction, normal: PointFunction) -> PointFunction:
        """Unit normals of one layer: the whole's `normal`, and where layers divide that of the division."""
        divided = self.distance(layer, whole)

        def normals(points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
            """Unit normals at canonical points."""
            out = np.array(normal(points), np.float64)
            cut = np.flatnonzero(np.abs(divided(points) - whole(points)) > 1e-6)
            if len(cut):
                steps = 1e-3 * np.eye(3)
                slope = np.stack([divided(points[cut] + e) - divided(points[cut] - e) for e in steps], 1)
                length = np.linalg.norm(slope, axis=1, keepdims=True)
                out[cut] = np.where(length > 1e-9, slope / np.maximum(length, 1e-9), out[cut])
            return out

        return normals


def hair_layers(subject: CaptureSubject, distance: PointFunction) -> HairLayers | None:
    """Where the hair of a subject with carved hair is a layer of its own; None: nowhere.

    `distance` is the learned signed distance of the whole, canonical.
    """
    if len(subject.under_hair) == 0:
        return None
    skin = without_hair(subject)
    top = rigid_height(subject, skin.faces)
    carved = subject.vertices[slice(*subject.carved)]
    if not (carved[:, 1] < top).any():
        return None
    places = np.concatenate([carved, subject.vertices[subject.part == PARTS.index("head")]])
    low, high = places.min(0) - 0.06, places.max(0) + 0.06
    bare, drawn = (signed_grid(person, low, high) for person in (skin, subject))
    cells = low + CELL * np.argwhere(np.ones(bare.values.shape, bool))
    learned: Array = distance(cells).reshape(bare.values.shape)
    hair = hair_cells(bare, drawn, learned, low[1] + CELL * np.arange(learned.shape[1]) > top)
    if not hair.any():
        return None
    zone = (distance_to(hair) - distance_to(~hair)) * CELL - MARGIN
    zone = DistanceGrid(ndimage.gaussian_filter(zone, 0.7).astype(np.float32), bare.low, CELL)
    moved = replace(skin, vertices=skin_moved(skin, zone, low, high, distance))
    return HairLayers(signed_grid(moved, low, high), zone, outer_depth(learned, bare, zone))


def hair_cells(
    bare: DistanceGrid, drawn: DistanceGrid, learned: Float[Array, "x y z"], above: Bool[Array, "y"]
) -> Bool[Array, "x y z"]:
    """Cells of hair, given the template's distance without and with its hair, the learned one, and the rigid levels."""
    off = bare.values > THIN
    carved = np.asarray(ndimage.binary_opening(off & (drawn.values < 0.5 * CELL)), bool)
    # a cell thick, it is opened by nothing; nor does it hang together but at corners
    standing = off & (learned < 0.5 * CELL) & above[:, None]
    label = pieces(carved | standing, 3)
    joined = np.setdiff1d(np.unique(label[carved]), [0])
    return np.isin(label, joined)


def carved_faces(subject: CaptureSubject) -> Bool[Array, "faces"]:
    """Which faces of the template are carved hair."""
    first, last = subject.carved
    return np.asarray(((subject.faces >= first) & (subject.faces < last)).all(1), bool)


def outer_depth(learned: Float[Array, "x y z"], bare: DistanceGrid, zone: DistanceGrid) -> DistanceGrid:
    """How deep the cells of a grid lie under the outer surface of the whole: the air that is reached from outside
    skin and hair ends there."""
    values, air = bare.values, learned > 0
    # a pinhole leads nowhere
    wide = np.asarray(ndimage.binary_erosion(air, border_value=1), bool)
    label = pieces(wide)
    reached = np.unique(label[wide & (values > 0.01) & (zone.values > 0.5 * CELL)])
    outside = air & np.asarray(ndimage.binary_dilation(wide & np.isin(label, reached), iterations=2), bool)
    depth = distance_to(outside) * bare.cell
    return DistanceGrid(depth.astype(np.float32), bare.low, bare.cell)


def rigid_height(subject: CaptureSubject, skin_faces: Int[Array, "k 3"]) -> float:
    """The height above which all skin follows the head alone (capture/template/parts.py)."""
    used = np.unique(skin_faces)
    follows = dense_weights(subject.skin.of(used))[:, HEAD]
    near = np.abs(subject.vertices[used, 0] - subject.joints[HEAD, 0]) < 0.25
    loose = subject.vertices[used][near & (follows < 0.99)]
    return float(loose[:, 1].max()) + 0.005


def signed_grid(person: CaptureSubject, low: Float[Array, "3"], high: Float[Array, "3"]) -> DistanceGrid:
    """Signed distance of all faces of a template in a box that cuts it open.

    A flood fill would leak in through the cut: farther than four cells off the side of the nearest sample decides.
    """
    corners = person.vertices[person.faces]
    near = ((corners > low - 0.1) & (corners < high + 0.1)).all((1, 2))
    cloud = surface_cloud(person, PARTS.index("head"), np.asarray(near, bool), 0.004, 0.004)
    grid = distance_grid(cloud, low, high, CELL)
    values = grid.values.copy()
    # exactly four cells off is far: the distance there is that of cells
    far = np.argwhere(np.abs(values) > 3.99 * CELL)
    points = low + CELL * far
    row = sample_grid(cloud.points, low - 0.5 * CELL, high + 0.5 * CELL, CELL).nearest(points)
    side = ((points - cloud.points[row]) * cloud.normals[row]).sum(1)
    values[tuple(far.T)] = np.where(side < 0, -1, 1) * np.abs(values[tuple(far.T)])
    return DistanceGrid(values, grid.low, CELL)


def skin_moved(
    skin: CaptureSubject, zone: DistanceGrid, low: Float[Array, "3"], high: Float[Array, "3"], distance: PointFunction
) -> Float[Array, "vertices 3"]:
    """The template's skin where the learned surface has it beside the hair, and harmonically in between under it.

    Above the rigid height there is no cloth: what lies farther than SKIN off the template there is hair too thin to
    be separated from it, and the template counts.
    """
    used = np.zeros(len(skin.vertices), bool)
    used[np.unique(skin.faces)] = True
    used &= ((skin.vertices > low - 0.05) & (skin.vertices < high + 0.05)).all(1)
    index = np.flatnonzero(used)
    points, normals = skin.vertices[index], vertex_normals(skin.vertices, skin.faces)[index]
    away = zone.at(points)
    # as far again from hair: next to it the learned surface bends up to it
    open_ = np.flatnonzero(away > MARGIN)
    line = points[open_, None] + OFFSETS[:, None] * normals[open_, None]
    values = distance(line.reshape(-1, 3)).reshape(len(open_), -1)
    crosses = (values[:, :-1] < 0) & (values[:, 1:] >= 0)
    found = crosses.any(1)
    # the crossing nearest to the template
    step = np.where(crosses, np.abs(OFFSETS[:-1])[None], np.inf).argmin(1)
    a, b = values[np.arange(len(open_)), step], values[np.arange(len(open_)), step + 1]
    offset = OFFSETS[step] + (OFFSETS[1] - OFFSETS[0]) * np.clip(-a / np.maximum(b - a, 1e-9), 0, 1)
    above = points[open_, 1] > rigid_height(skin, skin.faces)
    found &= ~above | (np.abs(offset) < SKIN)
    known, offsets = ~used, np.zeros((len(used), 1))  # farther away nothing is asked
    known[index[open_[found]]] = True
    offsets[index[open_[found]], 0] = offset[found]
    out = skin.vertices.copy()
    out[index] += fill_reached(offsets, known, skin.faces)[index] * normals
    return out


def without_hair(subject: CaptureSubject) -> CaptureSubject:
    """The template without its carved hair, that the body's layer takes its weights from."""
    return replace(subject, faces=np.concatenate([subject.faces[~carved_faces(subject)], subject.under_hair]))
