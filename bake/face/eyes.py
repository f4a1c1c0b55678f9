"""Eyeballs of their own: the ball's side of a baked level is cut away, a rim closes the lids, a cap of a sphere with a
picture of the iris turns behind them.

The picture is put together in polar coordinates, which rings are rows of, and kept as a disc: round the pole of a polar
picture mipmaps mean iris and white, and eyes were grey from two metres on.

What the lids hid when the eye was filmed is filled: rings of the iris by what was seen of them, the white by its own
color. The dark of the upper lid stays with its rim, which is drawn in the color of the lid's edge.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array
from scipy import ndimage

from avatar.baked_avatar import Level
from avatar.face import Eye
from avatar.texture import sample_texture
from bake.face.cut import chains, cut_along, extended, places, refined
from bake.face.eye_drawing import EyeDrawing
from bake.face.template import FaceRefused, PersonFace
from geometry.cells import nearest_marked
from geometry.closest import beyond_loop, closest_points, triangle_index
from geometry.mesh import component_labels, half_edges

# metres off the ball beyond which nothing is of it
REACH = 0.012
# metres of an edge beside an eye that is painted on the surface or cut as pictured, at most
LONGEST = 0.0025
# metres, on the mean, that lids may be off those of the picture before the picture's count
OFF = 0.0007
# heights of the template's opening that one in the picture has at most
TALLER = 1.25
# width and height of its opening beside the template's
PAINTED = np.array([1.2, 1.25])
# radians from the axis to the edge of the cap: seen through the lids when it turns by 20 degrees
CAP = np.radians(105.0)
RINGS, SPOKES = 8, 24
# the polar picture's width, round the axis, and height, from it
POLAR = (256, 128)
# metres: the cap lies so far within the filmed ball
WITHIN = 0.0001
# radians from the lids' edge within which a picture shows lids and lashes; over which what was seen fades into the fill
EDGE, FADE = np.radians(2.0), np.radians(4.0)
# sRGB: the white of an eye differs by less from its median; one that was not seen; skin is more colorful
STAIN, WHITE, COLORFUL = 0.1, (0.66, 0.63, 0.61), 0.13
# radians: the iris ends between these; axes tried to either side of straight on
IRIS = (np.radians(20.0), np.radians(40.0))
AXES = np.radians(np.arange(-10, 10.5, 1.0))


class OpenEye(NamedTuple):
    """A level without its ball, and what was cut away."""

    level: Level
    loop: Integer[Array, "n"]  # vertices along the lids' edge, in order, the first not again; one of each place
    edge: Integer[Array, "m 2"]  # the lids' own edges there, as their faces run
    filmed: bool  # as PersonFace has it
    ball: Integer[Array, "faces 3"]  # by the level's vertices


def edge_of_lids(person: PersonFace, center: Float[Array, "3"]) -> Float[Array, "n 3"]:
    """Along the edges of a template's lids, or round the larger opening of an eye that is painted on a surface."""
    own = person.face.lids[0 if center[0] > person.eyes.centres[:, 0].mean() else 1]
    loop = person.vertices[np.r_[own[0], own[1][-2:0:-1]]]
    return loop if person.filmed else center + np.append(PAINTED, 1) * (loop - center)


def cut_ball(
    level: Level, person: PersonFace, center: Float[Array, "3"], radius: float, coarse: float = 1.0,
    opening: Float[Array, "n 2"] | None = None,
) -> OpenEye:  # fmt: skip
    """Cut the ball's side of a level away: what lies in the pictured `opening`, or where the level is as near to the
    ball as to the template's lids; edges beside either may be `coarse` times as long.

    Raises:
        FaceRefused: there is no ball between the lids, or its edge is no loop.
    """
    if not person.filmed:
        opening = edge_of_lids(person, center)[:, :2]
    if opening is not None:
        level = refined(level, lambda points: np.linalg.norm(points - center, axis=1) < 1.7 * radius, coarse * LONGEST)
    points, faces = level.positions.astype(np.float64), level.faces.astype(np.int64)
    offset = points - center
    away = np.abs(np.linalg.norm(offset, axis=1) - radius)
    rows = np.flatnonzero((away < REACH) & (offset[:, 2] > 0))
    value = np.ones(len(points))
    if opening is None:
        corners = person.vertices[person.skin] - center
        near = (np.linalg.norm(corners, axis=2) < radius + 3 * REACH).all(1)
        lids = closest_points(points[rows], triangle_index(person.vertices, person.skin[near])).distance
        value[rows] = away[rows] - lids
    else:
        value[rows] = beyond_loop(points[rows, :2], opening)
    value = only_front(value, offset, places(points), faces)
    cut = cut_along(faces, value)
    grown, count = extended(level, cut.edges, cut.share), len(points)
    place = places(grown.positions)
    edges = half_edges(cut.faces)
    found = chains(place[edges[(edges >= count).all(1)]])
    if not found or len(found[0]) < 8 or found[0][0] != found[0][-1]:
        raise FaceRefused("an eyeball does not show between its lids as one piece")
    first = {int(at): row for row, at in reversed(list(enumerate(place))) if row >= count}
    loop = np.array([first[int(at)] for at in found[0][:-1]])
    kept = cut.faces[cut.side > 0].astype(np.uint32)
    own = half_edges(cut.faces[cut.side > 0])
    own = own[(own >= count).all(1) & np.isin(place[own], place[loop]).all(1)]
    return OpenEye(replace(grown, faces=kept), loop, own[lonely(place[own])], person.filmed, cut.faces[cut.side < 0])


def pictured_lids(
    level: Level, person: PersonFace, drawings: Sequence[EyeDrawing | None]
) -> list[Float[Array, "_ 2"] | None]:
    """The openings that drawings of both eyes have, where the lids that a cut leaves are farther than OFF from them;
    one that is TALLER took skin for white."""
    openings = [drawing.opening for drawing in drawings if drawing is not None]
    if not person.filmed or len(openings) < 2:
        return [None, None]
    off = []
    for center, radius, opening in zip(*person.eyes, openings):
        opened = cut_ball(level, person, center, float(radius))
        edge = opened.level.positions[opened.loop, :2].astype(np.float64)
        if np.ptp(opening[:, 1]) > TALLER * np.ptp(edge[:, 1]):
            return [None, None]
        off.append(np.abs(beyond_loop(edge, opening)).mean())
    return [*openings] if np.mean(off) > OFF else [None, None]


def lonely(edges: Integer[Array, "n 2"]) -> Bool[Array, "n"]:
    """Which directed edges have none against them."""
    last = int(edges.max()) + 1
    return ~np.isin(edges[:, 0] * last + edges[:, 1], edges[:, 1] * last + edges[:, 0])


def only_front(
    value: Float[Array, "vertices"], offset: Float[Array, "vertices 3"], place: Integer[Array, "vertices"],
    faces: Integer[Array, "faces 3"],
) -> Float[Array, "vertices"]:  # fmt: skip
    """The value, negative only on the one piece that looks forwards."""
    whole = place[faces[(value[faces] <= 0).all(1)]]
    piece = component_labels(whole, int(place.max()) + 1)[place]
    ahead = np.where(value <= 0, offset[:, 2] - 2 * np.hypot(offset[:, 0], offset[:, 1]), -np.inf)
    if not np.isfinite(ahead.max()):
        raise FaceRefused("an eyeball does not show between its lids")
    return np.where((value <= 0) & (piece != piece[ahead.argmax()]), 1e-5, value)


class Cap(NamedTuple):
    """A part of a sphere about an axis, and places on its disc."""

    directions: Float[Array, "n 3"]  # unit
    uv: Float[Array, "n 2"]  # [0, 1]
    faces: Integer[Array, "faces 3"]


def cap(axis: Float[Array, "3"], coarse: float = 1.0) -> Cap:
    """CAP round an axis, its quads `coarse` times as long."""
    rings, spokes = (round(count / coarse) for count in (RINGS, SPOKES))
    v, u = np.meshgrid(np.linspace(0, 1, rings + 1), np.linspace(0, 1, spokes + 1), indexing="ij")
    number = np.arange(u.size).reshape(u.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1)[:].reshape(-1, 3), np.stack([a, c, d], -1)[1:].reshape(-1, 3)])
    uv = np.stack([u, v], -1).reshape(-1, 2)
    return Cap(polar(axis, uv), on_disc(uv), faces)


def on_disc(uv: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    """Places of a polar picture on the disc, where the iris has two fifths of the radius."""
    angle, away = 2 * np.pi * uv[:, 0], np.sin(0.5 * np.pi * uv[:, 1:])
    return 0.5 + 0.5 * away * np.stack([np.cos(angle), np.sin(angle)], 1)


def disc(picture: Float[Array, "height width 3"], size: tuple[int, int]) -> Float[Array, "rows columns 3"]:
    """The disc of a polar picture, `size` texels wide and high; its edge's colors beyond it."""
    height, width = picture.shape[:2]
    columns, rows = size
    y, x = np.meshgrid(
        2 * (np.arange(rows) + 0.5) / rows - 1, 2 * (np.arange(columns) + 0.5) / columns - 1, indexing="ij"
    )
    away = np.arcsin(np.minimum(np.hypot(x, y), 1)) / (0.5 * np.pi) * height - 0.5
    round_it = (np.arctan2(y, x) / (2 * np.pi) % 1) * width + 0.5
    wrapped = np.concatenate([picture[:, -1:], picture, picture[:, :1]], 1)
    shown = [ndimage.map_coordinates(wrapped[..., c], [away, round_it], order=1, mode="nearest") for c in range(3)]
    return np.stack(shown, -1)


def frame(axis: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Columns: to the left, upwards, along the axis."""
    left = np.cross([0.0, 1.0, 0.0], axis)
    left /= np.linalg.norm(left)
    return np.stack([left, np.cross(axis, left), axis], 1)


def polar(axis: Float[Array, "3"], uv: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    """Unit directions of places in a polar picture."""
    round_it, from_it = 2 * np.pi * uv[:, 0], CAP * uv[:, 1]
    local = [np.sin(from_it) * np.cos(round_it), np.sin(from_it) * np.sin(round_it), np.cos(from_it)]
    return np.stack(local, 1) @ frame(axis).T


def ball_colors(opened: OpenEye, center: Float[Array, "3"], directions: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """What a level shows of a ball in directions from its center; NaN where it shows nothing."""
    level = opened.level
    corners = level.positions.astype(np.float64)[opened.ball] - center
    image = level.base_color.astype(np.float64) / 255
    colors = np.full((len(directions), 3), np.nan)
    solid = np.abs(np.linalg.det(corners)) > 1e-16
    for triangle, uv in zip(corners[solid], level.uv.astype(np.float64)[opened.ball[solid]]):
        weight = directions @ np.linalg.inv(triangle)
        hit = np.flatnonzero((weight >= -1e-9).all(1) & (weight.sum(1) > 0))
        if len(hit):
            share = weight[hit] / weight[hit].sum(1, keepdims=True)
            colors[hit] = sample_texture(image, share @ uv)
    return colors


def eye_axis(opened: OpenEye, center: Float[Array, "3"]) -> Float[Array, "3"]:
    """Where an eye looks at rest: the axis about which rings explain most of the luminance of what was seen."""
    v, u = np.meshgrid(np.linspace(0, 0.6, 46), np.linspace(0, 1, 121), indexing="ij")
    best, axis = np.inf, np.array([0.0, 0.0, 1.0])
    directions = polar(axis, np.stack([u, v], -1).reshape(-1, 2))
    colors = ball_colors(opened, center, directions)
    known = ~np.isnan(colors[:, 0])
    shown, light = directions[known], colors[known].mean(1)
    for pitch in AXES:
        for yaw in AXES:
            tried = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
            away = np.arccos(np.clip(shown @ tried, -1, 1))
            inner = away < IRIS[1]
            ring = np.floor(away[inner] / np.radians(1.5)).astype(np.int64)
            count, total, square = (np.bincount(ring, w) for w in (None, light[inner], light[inner] ** 2))
            left = (square - total**2 / np.maximum(count, 1)).sum() / max(np.var(light[inner]) * inner.sum(), 1e-9)
            if left < best:
                best, axis = float(left), tried
    return axis


def iris_picture(opened: OpenEye, eye: Eye, drawing: EyeDrawing | None = None) -> Float[Array, "height width 3"]:
    """The polar picture of a ball, [0, 1] sRGB, with what a drawing adds."""
    center, axis = eye.center, eye.axis
    width, height = POLAR
    row, column = np.mgrid[:height, :width]
    uv = np.stack([(column.ravel() + 0.5) / width, (row.ravel() + 0.5) / height], 1)
    directions = polar(axis, uv)
    colors = ball_colors(opened, center, directions).reshape(height, width, 3)
    if drawing is not None:
        colors += drawing.at(center + eye.radius * directions).reshape(colors.shape)
        colors = colors.clip(0, 1)
    edge = opened.level.positions.astype(np.float64)[opened.loop] - center
    edge /= np.linalg.norm(edge, axis=1, keepdims=True)
    inside = np.arccos(np.clip(directions @ edge.T, -1, 1)).min(1).reshape(height, width)
    # a painted eye's own lids are the picture's
    share = np.clip((inside - EDGE) / FADE, 0, 1) if opened.filmed else 1.0
    share = np.where(np.isnan(colors[..., 0]), 0, share)
    unknown, colors = np.isnan(colors), np.nan_to_num(colors)
    fill = filled_rings(colors, share > 0.5)
    # what stands out from the white is of the lids' corner
    stain = STAIN if opened.filmed else 3 * STAIN
    white = (np.arange(height) + 0.5) / height * CAP > IRIS[1]
    share *= np.where(white[:, None], np.clip(2 - np.abs(colors - fill).max(2) / stain, 0, 1), 1)
    share = ndimage.gaussian_filter(share, 1.0, mode="nearest")[..., None]
    if not opened.filmed:
        # its lids lie before the ball: past them one sees on
        beside = np.clip(1 - inside / (3 * FADE), 0, 1)[..., None]
        fill = np.where(unknown, beside * colors[nearest_marked(~unknown[..., 0])] + (1 - beside) * fill, fill)
    return np.where(unknown, fill, share * colors + (1 - share) * fill)


def filled_rings(
    colors: Float[Array, "height width 3"], known: Bool[Array, "height width"]
) -> Float[Array, "height width 3"]:
    """Each ring the median of what is known of it; beyond the iris a bright color of what is known of the white."""
    height = len(colors)
    ring = np.array([np.median(row[own], 0) if own.sum() > 4 else [np.nan] * 3 for row, own in zip(colors, known)])
    rows = np.arange(height)
    at = (rows + 0.5) / height * CAP
    has = ~np.isnan(ring[:, 0])
    if not has.any():
        raise FaceRefused("an eyeball was not seen between its lids")
    ring = np.stack([np.interp(rows, rows[has], ring[has, k]) for k in range(3)], 1)
    step = np.where((at > IRIS[0]) & (at < IRIS[1]), np.gradient(ndimage.gaussian_filter1d(ring.mean(1), 2.0)), -1)
    edge = int(step.argmax()) + int(np.radians(4) / CAP * height)
    beyond = known & (np.arange(height) > edge)[:, None]
    beyond &= np.ptp(colors, axis=2) < COLORFUL
    white = np.percentile(colors[beyond], 70, axis=0) if beyond.sum() > 20 else np.array(WHITE)
    over = np.clip((rows - edge) / 4, 0, 1)[:, None]
    # the ball is round: its light falls off from where it looks at the lids' corners
    round_off = 1 - 0.45 * np.clip((at - at[edge]) / np.radians(40.0), 0, 1)[:, None] * np.array([0.8, 1.05, 1.1])
    ring = (1 - over) * ring + over * white * round_off
    return np.repeat(ring[:, None], colors.shape[1], 1)
