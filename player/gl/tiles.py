"""The part of the image that avatars can reach, as few rectangles: a filter of the picture runs there only.

In software a filter costs what it covers.
"""

import numpy as np
from jaxtyping import Bool, Float, Int, UInt16
from numpy import ndarray as Array

from avatar.baked_avatar import Level
from avatar.camera import Camera
from avatar.skinning import SkinWeights

TILE = 8  # pixels a side
LARGEST = 0.07  # metres; a patch of the surface fits a ball of this radius


class Patches:
    """Pieces of one avatar's surface, each in a ball, with the bones that move it.

    A blend of rigid motions moves a piece's centre c to sum w_k B_k c and nothing of the piece farther from it than the
    radius. With w_k at most w_k,max on the piece, the centre stays on each axis between the heaviest bone's place of it
    and that plus what the other bones, each with its largest weight, pull it aside: in every pose.
    """

    def __init__(self, level: Level):
        all_joints, weights = level.drawn_skin
        heaviest = SkinWeights(all_joints, weights).heaviest
        # a piece is what one bone moves most of the surface in one cell, whose corner is LARGEST from its middle
        cells = np.floor(level.positions * (np.sqrt(3) / (2 * LARGEST))).astype(np.int64)
        cells -= cells.min(0)
        place = np.ravel_multi_index(cells.T, cells.max(0) + 1) * level.bones + heaviest
        _, piece_of = np.unique(place, return_inverse=True)
        order = np.argsort(piece_of, kind="stable")
        starts = np.flatnonzero(np.diff(piece_of[order], prepend=-1))
        points = level.positions[order].astype(np.float64)
        low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
        middles, pieces = 0.5 * (low + high), np.arange(len(starts))
        aside = np.linalg.norm(points - middles[piece_of[order]], axis=1)
        self.centers = np.pad(middles, ((0, 0), (0, 1)), constant_values=1.0)
        self.radii = np.maximum.reduceat(aside, starts)
        largest = np.zeros((len(starts), level.bones))
        np.maximum.at(largest, (piece_of[:, None], all_joints), weights / 255.0)
        # the heaviest bone of each piece first, then the others with their largest weight
        largest[pieces, heaviest[order[starts]]] = 2.0
        self.piece, self.joints = np.nonzero(largest)
        by_weight = np.lexsort((-largest[self.piece, self.joints], self.piece))
        self.piece, self.joints = self.piece[by_weight], self.joints[by_weight]
        self.shares = largest[self.piece, self.joints][:, None]
        self.first = np.flatnonzero(np.diff(self.piece, prepend=-1))

    def balls(
        self, view_from_canonical: Float[Array, "bones 4 4"], *, dual: bool, reach: float = 0.0
    ) -> tuple[Float[Array, "pieces 3"], Float[Array, "pieces"]]:
        """Middle in view space and radius of the balls that hold the surface, metres.

        dual: the blend of screws is bound by no weight and bulges out of the hull by at most half of what the bones
        disagree. reach: of loose parts, metres off where they are skinned to.
        """
        places = np.einsum("nij,nj->ni", view_from_canonical[self.joints, :3], self.centers[self.piece])
        middle = places[self.first]
        aside = places - middle[self.piece]
        if dual:
            low, high = np.minimum.reduceat(aside, self.first), np.maximum.reduceat(aside, self.first)
        else:
            aside *= self.shares
            low = np.add.reduceat(np.minimum(aside, 0), self.first)
            high = np.add.reduceat(np.maximum(aside, 0), self.first)
        half = 0.5 * np.linalg.norm(high - low, axis=1)
        return middle + 0.5 * (low + high), self.radii + reach + (2 * half if dual else half)

    def boxes(
        self, view_from_canonical: Float[Array, "bones 4 4"], camera: Camera, *, dual: bool, reach: float = 0.0
    ) -> Float[Array, "pieces 4"]:
        """Left, top, right, bottom of each piece, pixels; infinite where a ball reaches behind the eye."""
        return ball_boxes(*self.balls(view_from_canonical, dual=dual, reach=reach), camera)


def ball_boxes(
    centers: Float[Array, "balls 3"], radii: Float[Array, "balls"], camera: Camera
) -> Float[Array, "balls 4"]:
    """Left, top, right, bottom of balls in view space, pixels; infinite where one reaches behind the eye.

    A ball's image lies between the slopes (c -+ r) / depth taken at its nearer or farther end.
    """
    # x right and y down, then depth at the nearer and the farther end
    flat, ends = centers[:, :2].T * [[1.0], [-1.0]], np.empty((2, len(radii)))
    ends[0], ends[1] = -centers[:, 2] - radii, radii - centers[:, 2]
    behind = ends[0] <= 1e-6
    if behind.any():
        ends[:, behind] = 1.0
    low, high = ((flat - radii)[:, None] / ends).min(1), ((flat + radii)[:, None] / ends).max(1)
    (fx, skew, cx), (_, fy, cy), _ = camera.K.tolist()
    slant = np.sort(skew * np.stack([low[1], high[1]]), axis=0) if skew else (0.0, 0.0)
    boxes = np.empty((len(radii), 4))
    boxes[:, 0], boxes[:, 1] = fx * low[0] + cx + slant[0], fy * low[1] + cy
    boxes[:, 2], boxes[:, 3] = fx * high[0] + cx + slant[1], fy * high[1] + cy
    boxes[behind] = [-np.inf, -np.inf, np.inf, np.inf]
    return boxes


def covered(boxes: Float[Array, "boxes 4"], size: tuple[int, int], margin: int) -> Bool[Array, "rows columns"]:
    """Tiles that boxes, grown by `margin` pixels, touch."""
    rows, columns = -(-size[1] // TILE), -(-size[0] // TILE)
    ends = np.clip(boxes + np.array([-margin, -margin, margin, margin]), -TILE, TILE * (max(rows, columns) + 1))
    left, top, right, bottom = np.floor(ends / TILE).astype(int).T
    left, right = np.clip([left, right + 1], 0, columns)
    top, bottom = np.clip([top, bottom + 1], 0, rows)
    # how many boxes hold a tile: summed from their corners
    corners = np.zeros((rows + 1, columns + 1), int)
    for row, column, step in ((top, left, 1), (top, right, -1), (bottom, left, -1), (bottom, right, 1)):
        np.add.at(corners, (row, column), step)
    return corners.cumsum(0).cumsum(1)[:-1, :-1] > 0


def rectangles(
    tiles: Bool[Array, "rows columns"], size: tuple[int, int], *, flipped: bool
) -> UInt16[Array, "rectangles 4"]:
    """Runs of tiles in each row, as left, first row, right, end row in pixels, no pixel twice.

    Rows count as GL counts them: from the top where the picture is drawn upside down (flipped), else from below.
    """
    edges = np.diff(np.pad(tiles, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, left = np.nonzero(edges > 0)
    _, right = np.nonzero(edges < 0)
    out: Int[Array, "rectangles 4"] = TILE * np.stack([left, row, right, row + 1], 1)
    np.minimum(out, [*size, *size], out=out)
    if not flipped:
        out[:, [1, 3]] = size[1] - out[:, [3, 1]]
    return out.astype(np.uint16)
