"""Where the picture of a face has what its template has elsewhere: the line between the lips, the irises, the brows.

Registration follows surface, and outlines say nothing of a mouth: a template's lips are some millimetres off those in
the picture, its eyes as well where they were not measured. The line between closed lips is the darkest way across the
mouth; an iris is a dark disc with white to both sides; a brow is a dark band over an eye. The template is moved to
them, as a whole near each.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy import ndimage
from scipy.spatial.distance import cdist

from avatar.baked_avatar import Level
from avatar.camera import Camera
from avatar.texture import sample_texture
from bake.face.lips import lip_line
from bake.face.template import FaceRefused, PersonFace
from capture.fit.points import body_points
from capture.template.eyes import EyeSpheres
from geometry.mesh import blended
from geometry.rasterise import rasterise

# metres of a pixel, and to the camera, which is as good as parallel
PIXEL, FAR = 0.0005, 20.0
# metres up and down in which the lips' line is sought, and over which what is above and below it counts
LIPS, ROUND = 0.018, 0.0025
# the same of brows, and metres of their own width; what is less dark beside its surroundings, or lies lower over the
# middle of the eye, is no brow; nor is what runs along that limit, within ALONG
BROWS, BROW_ROUND, BROW_WIDE, FAINT, LOWEST, ALONG = 0.010, 0.007, 0.0015, 0.012, 0.0105, 0.0008
# metres over an eye's middle up to which lids do not move with a brow; beyond it at which nothing does, up and aside
LID, OVER_BROW, BESIDE_BROW = 0.007, 0.03, 0.012
# metres to all sides in which an iris is sought, and its radius
EYES, IRIS = 0.016, 0.0058
# metres round mouth and eyes that the picture shows; within which they take their surroundings with them
BOX, SPREAD = np.array([0.03, 0.025, 0.03]), 0.012
# metres off the ball within which vertices are on it, and how many of them before its middle make it a surface's own
BALL, SEEN = 0.0003, 8
# metres that a ball lies under a surface on which it is painted
UNDER = 0.0004
# metres by which one eye may be off otherwise than the other; brightness by which an iris is darker than the white
ALIKE, LEAST = 0.005, 0.03
# weight of a pixel's distance from the template's line, and of its steps, beside brightness in [0, 1]
STRAY, BEND = 0.0006, 0.01


def aligned(person: PersonFace, level: Level) -> PersonFace:
    """The face with its lips on those of the picture; and with its eyes there, where the surface has no eyeballs.

    Raises:
        FaceRefused: the picture shows no eyes near the template's.
    """
    line, eyes = lip_line(person), person.eyes
    brows = [person.vertices[rows] for rows in brow_vertices()]
    every = np.concatenate([np.stack(line, 1), eyes.centres, *brows])
    picture = front_picture(level, every.min(0) - BOX, every.max(0) + BOX)
    up = darkest_off(picture, line.x, line.y, LIPS, (PIXEL, ROUND))[0]
    places = np.stack(line, 1)[:: len(up) // 10]
    moves = np.stack([np.zeros(len(up)), up, np.zeros(len(up))], 1)[:: len(up) // 10]
    filmed = all(shows_ball(level, center, float(radius)) for center, radius in zip(*eyes))
    if not filmed:
        irises = irises_at(picture, eyes.centres)
        middles = irises - [0, 0, 1] * (eyes.radii[:, None] + UNDER)
        moves = np.concatenate([moves, np.repeat(middles - eyes.centres, 5, 0)])
        places = np.concatenate([places, np.repeat(eyes.centres, 5, 0)])
        eyes = EyeSpheres(middles, eyes.radii)

    def moved(points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        near = np.exp(-0.5 * np.square(cdist(points, places) / SPREAD))
        return points + near @ moves / (near.sum(1, keepdims=True) + 0.05)

    vertices = moved(person.vertices)
    off = brows_off(picture, brows, eyes.centres)
    for center, brow in zip(eyes.centres, brows):
        vertices[:, 1] += off * with_brow(vertices, brow, center)
    inside, parts = moved(person.inside), moved(person.parts)
    return person._replace(vertices=vertices, inside=inside, parts=parts, eyes=eyes, filmed=filmed)


def shows_ball(level: Level, center: Float[Array, "3"], radius: float) -> bool:
    """Whether the surface between the lids is the ball's; else the eye is painted on a surface that goes on."""
    offset = level.positions - center
    ahead = (offset[:, 2] > 0) & (np.hypot(offset[:, 0], offset[:, 1]) < 0.7 * radius)
    off = np.abs(np.linalg.norm(offset[ahead], axis=1) - radius)
    return int((off < BALL).sum()) >= SEEN


class FrontPicture(NamedTuple):
    """A part of a level as it looks from the front, row 0 on top."""

    colors: Float[Array, "height width 3"]  # sRGB in [0, 1]; NaN where there is nothing
    points: Float[Array, "height width 3"]  # canonical, metres
    low: Float[Array, "2"]  # x of the first column's and y of the last row's middle

    @property
    def light(self) -> Float[Array, "height width"]:
        """Brightness in [0, 1]."""
        return self.colors.mean(2)

    def column(self, x: Float[Array, "n"]) -> Float[Array, "n"]:
        """Columns of places."""
        return (x - self.low[0]) / PIXEL

    def row(self, y: Float[Array, "n"]) -> Float[Array, "n"]:
        """Rows of places."""
        return len(self.light) - 1 - (y - self.low[1]) / PIXEL


def front_camera(low: Float[Array, "3"], high: Float[Array, "3"]) -> Camera:
    """A camera before a box, so far that it is as good as parallel, a pixel PIXEL wide; depth is FAR at z = high."""
    width, height = (int(np.ceil((high[k] - low[k]) / PIXEL)) + 1 for k in (0, 1))
    middle = low[:2] + 0.5 * PIXEL * np.array([width - 1, height - 1])
    to_camera = np.diag([1.0, -1.0, -1.0, 1.0])
    to_camera[:3, 3] = [-middle[0], middle[1], FAR + high[2]]
    focal = (FAR + 0.5 * (high[2] - low[2])) / PIXEL
    return Camera(np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]), to_camera, (width, height))


def front_picture(level: Level, low: Float[Array, "3"], high: Float[Array, "3"]) -> FrontPicture:
    """The part of a level between two corners of a box, seen from the front, a pixel PIXEL wide."""
    camera = front_camera(low, high)
    height = camera.size[1]
    points, faces = level.positions.astype(np.float64), level.faces.astype(np.int64)
    corners = points[faces]
    faces = faces[((corners > low - 0.01) & (corners < high + 0.01)).all((1, 2))]
    seen = rasterise(points, faces, camera)
    hit = seen.face >= 0
    triangle = faces[seen.face[hit]]
    row, column = np.nonzero(hit)
    at = np.stack([low[0] + PIXEL * column, low[1] + PIXEL * (height - 1 - row)], 1)
    a, b, c = (points[triangle[:, k], :2] for k in range(3))
    cross = lambda u, v: u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    weight = np.stack([cross(b - at, c - at), cross(c - at, a - at), cross(a - at, b - at)], 1)
    weight = np.clip(weight / weight.sum(1, keepdims=True), 0, 1)
    weight /= weight.sum(1, keepdims=True)
    colors, places = np.full((2, *hit.shape, 3), np.nan)
    colors[hit] = sample_texture(level.base_color / 255.0, blended(level.uv.astype(np.float64), triangle, weight))
    places[hit] = blended(points, triangle, weight)
    return FrontPicture(colors, places, np.asarray(low[:2], np.float64))


def brow_vertices() -> tuple[list[int], list[int]]:
    """Vertices of the body along the left and the right brow, from right to left."""
    points = body_points()
    left, right = ([int(points[f"face_{k}"].vertices[0]) for k in range(first, first + 5)] for first in (22, 17))
    return left, right


def brows_off(picture: FrontPicture, brows: list[Float[Array, "5 3"]], eyes: Float[Array, "2 3"]) -> float:
    """How far above the template's brows those of the picture lie, metres; 0 where it does not show both alike."""
    found = []
    for brow, eye in zip(brows, eyes):
        off, dark = darkest_off(picture, brow[:, 0], brow[:, 1], BROWS, (BROW_WIDE, BROW_ROUND), eye[1] + LOWEST)
        if dark > -FAINT or (brow[:, 1] + off).mean() < eye[1] + LOWEST + ALONG:
            return 0.0
        found.append(float(off.mean()))
    return float(np.mean(found)) if abs(found[0] - found[1]) < ALIKE else 0.0


def with_brow(points: Float[Array, "n 3"], brow: Float[Array, "5 3"], eye: Float[Array, "3"]) -> Float[Array, "n"]:
    """The share of a brow's motion that skin takes: all of it at the brow, none at the lids and far beside."""
    x, y, z = points.T
    height = np.interp(x, brow[:, 0], brow[:, 1])
    over = np.where(y < height, (y - eye[1] - LID) / (height - eye[1] - LID), 1 - (y - height) / OVER_BROW)
    aside = np.maximum(np.maximum(brow[0, 0] - x, x - brow[-1, 0]), 0)
    share = np.clip(over, 0, 1) * np.clip(1 - aside / BESIDE_BROW, 0, 1) * (z > eye[2])
    return share * share * (3 - 2 * share)


def darkest_off(
    picture: FrontPicture, x: Float[Array, "n"], y: Float[Array, "n"], reach_m: float, widths: tuple[float, float],
    lowest: float = -np.inf,
) -> tuple[Float[Array, "n"], float]:  # fmt: skip
    """How far above the line x, y, within `reach_m` and above `lowest`, the way across lies that is darkest beside what
    is above and below it, and by how much; x rises. `widths`: of the way and of what it is compared with. A lip that is
    darker than the other one as a whole is no line."""
    light = np.nan_to_num(picture.light, nan=1.0)
    narrow, wide = (width / PIXEL for width in widths)
    light = ndimage.gaussian_filter(light, narrow) - ndimage.gaussian_filter(light, (wide, narrow))
    first, last = picture.column(x[[0, -1]])
    columns = np.arange(int(np.ceil(first)), int(last) + 1)
    line = picture.row(np.interp(picture.low[0] + PIXEL * columns, x, y))
    reach = int(reach_m / PIXEL)
    steps = np.arange(-reach, reach + 1)
    rows = np.clip(np.round(line[:, None] + steps).astype(np.int64), 0, len(light) - 1)
    cost = light[rows, columns[:, None]] + STRAY * np.abs(steps) + (rows > picture.row(np.array([lowest])))
    total, came = cost[0], np.zeros(cost.shape, np.int64)
    for k in range(1, len(columns)):
        tried = np.stack([np.roll(total, s) + BEND * abs(s) for s in (-1, 0, 1)])
        tried[0, -1] = tried[2, 0] = np.inf
        came[k] = tried.argmin(0) - 1
        total = tried.min(0) + cost[k]
    way = [int(total.argmin())]
    for k in range(len(columns) - 1, 0, -1):
        way.append(way[-1] - int(came[k, way[-1]]))
    way = np.array(way[::-1])
    off = -PIXEL * ndimage.gaussian_filter1d(steps[way].astype(np.float64), 6.0)
    dark = float(light[rows[np.arange(len(way)), way], columns].mean())
    return np.interp(x, picture.low[0] + PIXEL * columns, off), dark


def irises_at(picture: FrontPicture, centers: Float[Array, "2 3"]) -> Float[Array, "2 3"]:
    """Places on the surface, near the middles of two eyeballs, of the discs that are darkest beside what lies left and
    right of them; both are off the middles alike, mirrored.

    Raises:
        FaceRefused: there is no such pair.
    """
    reach = int(np.ceil(2 * IRIS / PIXEL))
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1] * PIXEL
    away = np.hypot(u, v)
    disc = (away < 0.8 * IRIS) & (np.abs(v) < 0.6 * IRIS)
    white = (away > 1.2 * IRIS) & (away < 1.9 * IRIS) & (np.abs(v) < 0.4 * IRIS)
    score = ndimage.correlate(
        np.nan_to_num(picture.light, nan=0.5), white / white.sum() - disc / disc.sum(), mode="nearest"
    )
    peak = (score == ndimage.maximum_filter(score, 5)) & (score > LEAST) & ~np.isnan(picture.light)
    row, column = np.nonzero(peak)
    places, height = picture.points[row, column], score[row, column]
    best, found = -np.inf, None
    near = [np.flatnonzero(np.linalg.norm((places - center)[:, :2], axis=1) < EYES) for center in centers]
    for i in near[0]:
        for k in near[1]:
            (x, y, _), (other_x, other_y, _) = places[[i, k]] - centers
            alike = abs(x + other_x) < ALIKE and abs(y - other_y) < ALIKE
            if alike and height[i] + height[k] > best:
                best, found = float(height[i] + height[k]), places[[i, k]]
    if found is None:
        raise FaceRefused("its picture shows no two eyes where its template has them")
    return found
