"""A face as a film of it showed it: shapes that go as far as this person's do, and the colors behind the lips."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.baked_avatar import Level
from avatar.face import SHAPES
from avatar.texture import sample_texture
from bake.face.mouth import TONGUE, TOOTH
from bake.face.template import MouthTint, PersonFace
from capture.fit.face_film import moving_points
from capture.fit.mouth_color import CHEEKS
from capture.keypoints.record import FACE
from capture.own_face import FITTED, NUMBERS, OwnFace

# metres round the middle of a cheek that its color is taken from
CHEEK = 0.006
# how light teeth and what is red are beside the painted ones: an open mouth in a room is in the shade of its lips
LIGHT = (0.7, 1.15)


def with_own_face(person: PersonFace, own: OwnFace, finest: Level) -> PersonFace:
    """The built-in face on a person, as the film has it; lids end on lids all the same (blink.py fits them after)."""
    gains = np.ones(len(SHAPES), np.float32)
    gains[NUMBERS] = own.gains
    # what closes an open mouth
    gains[SHAPES.index("mouthClose")] = own.gains[FITTED.index("jawOpen")]
    face = replace(person.face, offsets=person.face.offsets * gains[:, None, None])
    skin = cheek_color(person, finest)
    tint = MouthTint(*(
        np.ones(3) if color is None else _tint(color * skin / painted)
        for color, painted in ((own.teeth, TOOTH), (own.red, TONGUE))
    ))  # fmt: skip
    return person._replace(face=face, tint=tint)


def cheek_color(person: PersonFace, level: Level) -> Float[Array, "3"]:
    """The color of both cheeks, sRGB 0 to 255."""
    ends = np.array([[moving_points()[FACE[number]] for number in pair] for pair in CHEEKS])
    tree = KDTree(level.positions)
    near = [tree.query_ball_point(middle, CHEEK) or [tree.query(middle)[1]] for middle in person.vertices[ends].mean(1)]
    return np.median(sample_texture(level.base_color, level.uv[np.concatenate(near)]), 0).astype(np.float64)


def _tint(tint: Float[Array, "3"]) -> Float[Array, "3"]:
    light = tint.mean()
    return tint / light * np.clip(light, *LIGHT)
