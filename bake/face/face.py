"""A face for the finest levels of a finished avatar: shapes, lips that part, lids that close, eyes that turn."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Integer
from numpy import ndarray as Array
from PIL import Image

from avatar.baked_avatar import Level
from avatar.face import SHAPES, SIDES, Eye, FaceShapes
from avatar.skeleton import JOINTS
from avatar.texture import bytes_of
from bake.face.blink import LIDS, fitted_blink, outside, pushed_out
from bake.face.carry import carried
from bake.face.cut import MEANS, joined
from bake.face.eye_drawing import draw_eyes
from bake.face.eyes import (
    WITHIN,
    Cap,
    OpenEye,
    cap,
    cut_ball,
    disc,
    edge_of_lids,
    eye_axis,
    iris_picture,
    pictured_lids,
)
from bake.face.features import aligned
from bake.face.follow import following
from bake.face.lips import LipLine, cut_lips, kept_closed, lip_line
from bake.face.mouth import Mouth, coarser, mouth_behind, mouth_picture
from bake.face.own import with_own_face
from bake.face.strip import LEFT_EYE, MOUTH, RIGHT_EYE, StripPart, size_in, uv_in, with_strip
from bake.face.template import FaceRefused, PersonFace
from capture.own_face import OwnFace
from geometry.mesh import vertex_normals

# levels, from the finest on, whose triangles are fine enough for lips and lids: how much longer edges are there
COARSE = (1.0, 1.6)
# times that a blink is fitted and kept off the ball: what pushes lids out also parts their edges
ROUNDS = 3
# metres: less is no motion, and takes no bytes; the same of what lies behind the lips
STILL, BEHIND_LIPS = 2e-4, 5e-4
# metres that the rim of the lids reaches into the ball, and behind the lids
RIM_IN, RIM_UNDER = 0.0006, 0.003

# texels a side of an atlas below which there are 16 rows for the pictures
SMALLEST = 256
HEAD = JOINTS.index("head")
EYES = (LEFT_EYE, RIGHT_EYE)


class Growing(NamedTuple):
    """A level to which a face is given."""

    level: Level
    offsets: Float32[Array, "52 vertices 3"]

    def with_geometry(
        self, points: Float[Array, "n 3"], uv: Float[Array, "n 2"], faces: Integer[Array, "faces 3"],
        offsets: Float32[Array, "52 n 3"], like: Integer[Array, "k"],
    ) -> "Growing":  # fmt: skip
        """With geometry of the head behind its own, whose faces may have vertices of both, lit as the vertices `like`
        are on the mean; nothing of it changes with the view."""
        level, count, before = self.level, len(points), len(self.level.positions)
        normals = vertex_normals(np.concatenate([level.positions, points]).astype(np.float64), faces)[before:]
        first = np.eye(1, 4, dtype=np.uint8).repeat(count, 0)
        fields = {
            "positions": points, "normals": normals, "uv": uv, "joints": HEAD * first,
            "weights": 255 * first, "view_dir": -normals, "view_q": np.zeros((count, 6)),
            "view_seen": np.zeros(count),
        }  # fmt: skip
        if level.light is not None:
            fields["light"] = np.repeat(level.light[like].mean(0, keepdims=True), count, 0)
        if level.loose is not None:
            fields["loose"] = np.zeros(count)
        whole = np.concatenate([level.faces, faces.astype(np.uint32)])
        return Growing(replace(joined(level, fields), faces=whole), np.concatenate([self.offsets, offsets], 1))


class Faced(NamedTuple):
    """Levels with a face, and its eyes."""

    levels: list[Level]
    eyes: tuple[Eye, Eye]


Pictures = dict[StripPart, Float[Array, "height width 3"]]


class Parted(NamedTuple):
    """A level whose lips are parted and whose sockets are open, still without what belongs there."""

    growing: Growing
    opened: tuple[OpenEye, OpenEye]
    upper: Integer[Array, "cut"]  # along the lips, right to left
    lower: Integer[Array, "cut"]


def with_face(levels: Sequence[Level], person: PersonFace, film: OwnFace | None = None) -> Faced:
    """The levels of a finished avatar, finest first, as many of them with a face as COARSE has; `film`: what one of
    the face said.

    Raises:
        FaceRefused: this surface takes none; the sentence says why.
    """
    person = aligned(person, levels[0])
    if film is not None:
        person = with_own_face(person, film, levels[0])
    line, out = lip_line(person), list(levels)
    pictures: Pictures = {}
    eyes: list[Eye] = []
    lids = [edge_of_lids(person, center) for center in person.eyes.centres]
    drawings = draw_eyes(levels[0], lids, person.eyes.centres) or [None, None]
    openings = pictured_lids(levels[0], person, drawings)
    for number, (level, coarse) in enumerate(zip(levels, COARSE, strict=False)):
        texels = len(level.base_color)
        try:
            if texels < SMALLEST:
                raise FaceRefused(f"its atlas of {texels} texels a side has no room for it")
            parts = parted(level, person, line, coarse, openings)
        except FaceRefused:
            if number == 0:
                raise
            break
        at = parts.growing.level.positions[parts.upper].astype(np.float64)
        moves = [parts.growing.offsets[:, edge] for edge in (parts.upper, parts.lower)]
        mouth = mouth_behind(coarser(person) if number else person, at, (moves[0], moves[1]))
        if number == 0:
            for one, center, radius, place, drawing in zip(parts.opened, *person.eyes, EYES, drawings):
                axis = eye_axis(one, center) if drawing is None else drawing.axis(float(radius))
                eyes.append(Eye(center, axis, float(radius) - WITHIN))
                pictures[place] = disc(iris_picture(one, eyes[-1], drawing), size_in(place, texels))
            pictures[MOUTH] = mouth_picture(person, mouth, size_in(MOUTH, texels))
        own = {place: resized(picture, size_in(place, texels)) for place, picture in pictures.items()}
        grown = joined_face(parts, mouth, [(eye, cap(eye.axis, coarse)) for eye in eyes], own)
        out[number] = following(out[0], grown) if number else grown
    return Faced(out, (eyes[0], eyes[1]))


def parted(
    level: Level, person: PersonFace, line: LipLine, coarse: float = 1.0,
    openings: Sequence[Float[Array, "_ 2"] | None] = (None, None),
) -> Parted:  # fmt: skip
    """A level cut at lips and eyes, these at the pictured openings or the template's, its shapes carried from the
    template and fitted to its eyes."""
    cut = cut_lips(level, line, coarse)
    level, opened = cut.level, []
    for center, radius, opening in zip(*person.eyes, openings):
        opened.append(cut_ball(level, person, center, float(radius), coarse, opening))
        level = opened[-1].level
    lip = np.r_[cut.lip, np.zeros(len(level.positions) - len(cut.lip), np.int64)]
    offsets = kept_closed(cut, carried(level, person, line, lip, flat=not person.filmed))
    points = level.positions.astype(np.float64)
    used = np.unique(level.faces)
    for side, one, center, radius in zip(SIDES, opened, *person.eyes):
        near = used[(np.linalg.norm(points[used] - center, axis=1) < LIDS) & (points[used, 2] > center[2])]
        points[near] = pushed_out(points[near], center, float(radius))
        blink = offsets[SHAPES.index(f"eyeBlink{side.title()}")]
        for _ in range(ROUNDS):
            blink[:] = fitted_blink(points, blink, one.loop, center)
            blink[near] = outside(points[near], blink[near], center, float(radius))
        for shape in offsets:
            moved = near[np.linalg.norm(shape[near], axis=1) > STILL]
            shape[moved] = outside(points[moved], shape[moved], center, float(radius))
    grown = Growing(replace(level, positions=points.astype(np.float32)), offsets)
    return Parted(grown, (opened[0], opened[1]), cut.upper, cut.lower)


def joined_face(parts: Parted, mouth: Mouth, eyes: Sequence[tuple[Eye, Cap]], pictures: Pictures) -> Level:
    """A level with its lids' rims, mouth and balls, and with the record of what moves."""
    growing, texels = parts.growing, len(parts.growing.level.base_color)
    growing = growing._replace(level=with_strip(growing.level, pictures))
    for one, (eye, _) in zip(parts.opened, eyes):
        growing = with_rim(growing, one.edge, eye)
    faces = mouth.faces + len(growing.level.positions)
    growing = growing.with_geometry(mouth.points, uv_in(MOUTH, mouth.uv, texels), faces, mouth.offsets, parts.upper)
    balls, still = [], np.unique(growing.level.faces)
    least = np.full(len(growing.level.positions), STILL)
    least[-len(mouth.points) + 2 * len(parts.upper) :] = BEHIND_LIPS
    for one, (eye, ball), place in zip(parts.opened, eyes, EYES):
        balls.append([len(growing.level.positions), len(ball.uv)])
        offsets = np.zeros((len(SHAPES), len(ball.uv), 3), np.float32)
        at = eye.center + eye.radius * ball.directions
        growing = growing.with_geometry(at, uv_in(place, ball.uv, texels), ball.faces + balls[-1][0], offsets, one.loop)
    # what was cut away of the old balls is named by no triangle
    kept = np.r_[still, np.arange(balls[0][0], len(growing.level.positions))]
    level = only(growing.level, kept)
    offsets = growing.offsets[:, kept]
    least = np.r_[least, np.full(len(growing.level.positions) - len(least), STILL)][kept, None]
    offsets = np.where(np.linalg.norm(offsets, axis=2, keepdims=True) > least, offsets, np.float32(0))
    vertices = np.flatnonzero(offsets.any((0, 2)))
    first = np.array(balls) - [[balls[0][0] - len(still), 0]]
    face = FaceShapes(vertices.astype(np.uint32), offsets[:, vertices], first.astype(np.uint32))
    return replace(level, face=face)


def with_rim(growing: Growing, edges: Integer[Array, "n 2"], eye: Eye) -> Growing:
    """With a rim from the lids' `edges` into the ball, in the color of that edge: else one would see past the lids."""
    level = growing.level
    edge, number = np.unique(edges, return_inverse=True)
    rest = level.positions[edge].astype(np.float64)
    inner = tucked(rest, rest, eye)
    moved = np.stack([tucked(rest + shape, rest, eye) - inner for shape in growing.offsets[:, edge]])
    start = len(level.positions)
    a, b = edges.T
    a_in, b_in = number.reshape(-1, 2).T + start
    faces = np.concatenate([np.stack([b, a, a_in], 1), np.stack([b, a_in, b_in], 1)])
    uv = level.uv[edge].astype(np.float64)
    return growing.with_geometry(inner, uv, faces, moved.astype(np.float32), edge)


def tucked(edge: Float[Array, "n 3"], rest: Float[Array, "n 3"], eye: Eye) -> Float[Array, "n 3"]:
    """Points of an edge of lids, moved from the opening's middle under the lids and into the ball."""
    outwards = rest - rest.mean(0)
    under = edge - eye.center + RIM_UNDER * outwards / np.linalg.norm(outwards, axis=1, keepdims=True)
    return eye.center + (eye.radius - RIM_IN) * under / np.linalg.norm(under, axis=1, keepdims=True)


def only(level: Level, kept: Integer[Array, "kept"]) -> Level:
    """The level with these vertices alone, in their order."""
    number = np.full(len(level.positions), -1)
    number[kept] = np.arange(len(kept))
    rows = {name: values[kept] for name, values in vars(level).items() if name in (*MEANS, "joints", "weights")
            and values is not None}  # fmt: skip
    return replace(level, **rows, faces=number[level.faces].astype(np.uint32))


def resized(picture: Float[Array, "height width 3"], size: tuple[int, int]) -> Float[Array, "own_height own_width 3"]:
    """A picture of the finest level at another's size."""
    if picture.shape[1::-1] == size:
        return picture
    return np.asarray(Image.fromarray(bytes_of(picture)).resize(size, Image.Resampling.BOX)) / 255.0
