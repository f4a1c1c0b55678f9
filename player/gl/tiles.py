"""The part of the image that avatars can reach, as few rectangles: a filter of the picture runs there only.

In software a filter costs what it covers: on these tiles FXAA is about half as dear as on the whole image.
"""

import numpy as np
from jaxtyping import Bool, Float, Int, UInt16
from numpy import ndarray as Array

from avatar.baked_avatar import Level
from avatar.camera import Camera

TILE = 16  # pixels a side
LARGEST = 0.10  # metres; patches of the surface are split until they fit a ball of this radius


class Patches:
    """Pieces of one avatar's surface, each in a ball, with the bones that move it.

    A blend of rigid motions moves the ball's centre c to a point of the hull of {B_k c} and nothing of the piece
    farther from it than the radius: so the balls about all B_k c hold the piece in between, in every pose.
    """

    def __init__(self, level: Level):
        heaviest = level.skin.heaviest
        centers, radii, joints, first = [], [], [], []
        waiting = [np.flatnonzero(heaviest == joint) for joint in np.unique(heaviest)]
        while waiting:
            piece = waiting.pop()
            points = level.positions[piece].astype(np.float64)
            low, high = points.min(0), points.max(0)
            center = 0.5 * (low + high)
            radius = float(np.linalg.norm(points - center, axis=1).max())
            if radius > LARGEST:
                upper = points[:, (high - low).argmax()] > center[(high - low).argmax()]
                waiting += [piece[upper], piece[~upper]]
                continue
            moved_by = np.unique(level.joints[piece][level.weights[piece] > 0])
            first.append(len(joints))
            joints += moved_by.tolist()
            centers += [[*center, 1.0]] * len(moved_by)
            radii += [radius] * len(moved_by)
        self.centers, self.radii = np.array(centers), np.array(radii)
        self.joints, self.first = np.array(joints, np.intp), np.array(first, np.intp)

    def balls(
        self, view_from_canonical: Float[Array, "bones 4 4"], *, dual: bool, reach: float = 0.0
    ) -> tuple[Float[Array, "balls 3"], Float[Array, "balls"]]:
        """Middle in view space and radius of the balls that hold the surface, metres.

        dual: the blend of screws bulges out of the hull by at most half of what the bones disagree. reach: of loose
        parts, metres off where they are skinned to.
        """
        points = np.einsum("nij,nj->ni", view_from_canonical[self.joints, :3], self.centers)
        if not dual:
            return points, self.radii + reach if reach else self.radii
        spread = np.maximum.reduceat(points, self.first) - np.minimum.reduceat(points, self.first)
        counts = np.diff(self.first, append=len(self.joints))
        return points, self.radii + reach + np.repeat(0.5 * np.linalg.norm(spread, axis=1), counts)

    def boxes(
        self, view_from_canonical: Float[Array, "bones 4 4"], camera: Camera, *, dual: bool, reach: float = 0.0
    ) -> Float[Array, "patches 4"]:
        """Left, top, right, bottom of each patch, pixels; infinite where a ball reaches behind the eye."""
        boxes = ball_boxes(*self.balls(view_from_canonical, dual=dual, reach=reach), camera)
        lower = np.minimum.reduceat(boxes[:, :2], self.first)
        return np.concatenate([lower, np.maximum.reduceat(boxes[:, 2:], self.first)], 1)


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
    tiles = np.zeros((-(-size[1] // TILE), -(-size[0] // TILE)), bool)
    rows, columns = tiles.shape
    ends = np.clip(boxes + np.array([-margin, -margin, margin, margin]), -TILE, TILE * (max(rows, columns) + 1))
    cells = np.floor(ends / TILE).astype(int)
    for left, top, right, bottom in cells.tolist():
        tiles[max(top, 0) : max(bottom + 1, 0), max(left, 0) : max(right + 1, 0)] = True
    return tiles


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
