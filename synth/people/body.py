"""The person under the clothes: the free body shaped and scaled, its skin and eyes colored from the built-in people.

The painted face and hands of the built-in man and woman lie in the texture coordinates of the body that all shapes
share, so they fit every shape; their color is that of another skin in proportion, and their hair is painted over.
"""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from PIL import Image
from scipy.interpolate import LinearNDInterpolator

from avatar.body import Body, builtin_body, shaped
from avatar.skeleton import JOINTS
from avatar.skinning import dense_weights
from capture.template.eyes import fit_sphere, socket_spheres
from geometry.mesh import component_labels, vertex_normals
from synth.people.cloth import Picture
from synth.people.looks import Looks
from synth.people.mesh import PersonPiece, half_step, smoothstep
from synth.subject import SynthSubject, read_subject

BODY, HEAD, EYEBALL = range(3)  # pictures of the built-in people
# what their painted skin is in the plain
PAINTED = {"male": (222, 172, 143), "female": (232, 188, 164)}
SIZE = 1024
# in the head's picture, which covers HEIGHT metres: across from the middle line, and how far down hair grows there
HAIRLINE = np.array([(0, 0.200), (0.1, 0.198), (0.2, 0.212), (0.28, 0.238), (0.33, 0.262), (0.347, 0.34), (0.362, 0.27),
                     (0.385, 0.275), (0.41, 0.46), (0.43, 0.53), (0.5, 0.55)]).T  # fmt: skip
# the same of where the hair of the built-in people is painted, and a little more; and of where their neck begins
PAINTED_HAIR = np.array([(0, 0.24), (0.32, 0.26), (0.34, 0.30), (0.35, 0.48), (0.40, 0.56), (0.42, 0.64), (0.44, 0.72),
                         (0.5, 0.72)]).T  # fmt: skip
NECK = np.array([(0.15, 0.82), (0.33, 0.60)]).T
HEIGHT = 0.33
# metres of fat over what a joint moves, on the heaviest person
FLESH = {"pelvis": 0.035, "spine1": 0.055, "spine2": 0.04, "spine3": 0.022, "hip": 0.03, "knee": 0.012, "neck": 0.012,
         "collar": 0.015, "shoulder": 0.018, "elbow": 0.008}  # fmt: skip


def figure(looks: Looks) -> Body:
    """The free body in the person's shape and height."""
    body = shaped(builtin_body(looks.sex), np.array(looks.betas))
    fat = dense_weights(body.skin) @ [FLESH.get(name.rpartition("_")[2], 0.0) for name in JOINTS]
    step, calm = half_step(body.faces, len(body.vertices)), body.vertices
    for _ in range(40):
        calm = step @ calm
    vertices = body.vertices + looks.heavy * fat[:, None] * vertex_normals(calm, body.faces)
    scale = looks.stature / np.ptp(vertices[:, 1])
    return replace(body, vertices=scale * vertices, joints=scale * body.joints)


def built_in(sex: str) -> SynthSubject:
    """The stored man or woman, painted by experiments/builtin."""
    return read_subject(Path(str(files("synth") / "data" / f"builtin_{sex}.glb")))


def body_atlas(
    uv: Float[Array, "faces 3 2"], island: Int[Array, "faces"], on_head: Bool[Array, "faces"]
) -> tuple[Int[Array, "faces"], Float[Array, "faces 3 2"]]:
    """Picture (BODY or HEAD) and place in it of the free body's faces, from their own texture coordinates and islands.

    Face and hands are enlarged. The maps are monotone in u and in v, so islands that did not overlap still do not.
    """
    middle = uv.mean(1)
    head = island == island[np.argmin(np.hypot(*(middle - [0.863, 0.5165]).T))]
    # the insides of mouth and eye sockets; the tip of the left middle finger lies beside one of them
    inner = (middle[:, 0] < 0.16) & (middle[:, 1] > 0.365) & (middle[:, 1] < 0.455)
    inner |= (middle[:, 0] > 0.755) & (middle[:, 1] > 0.86) & ~head
    inner &= on_head
    u, v = uv[..., 0], uv[..., 1]
    on_body = np.stack([u / 0.765, np.interp(v, [0, 0.79, 1], [0.003, 0.56, 0.997])], -1)
    across = np.interp(u, [0.635, 0.80, 0.96, 1.0], [0, 0.25, 0.93, 1])
    face = np.stack([across, np.interp(v, [0.17, 0.415, 0.615, 0.86], [0.01, 0.17, 0.83, 0.99])], -1)
    chosen, tucked = (head | inner)[:, None, None], 0.003 + 0.026 * np.stack([u, v], -1)
    return np.where(head | inner, HEAD, BODY), np.where(chosen, np.where(inner[:, None, None], tucked, face), on_body)


def chart(body: Body) -> tuple[Int[Array, "faces"], Float[Array, "faces 3 2"]]:
    assert body.uv is not None and body.uv_faces is not None
    island = component_labels(body.uv_faces, len(body.uv))[body.uv_faces[:, 0]]
    return body_atlas(body.uv[body.uv_faces], island, dense_weights(body.skin)[body.faces[:, 0], 15] > 0.9)


def inside_line(line: Float[Array, "2 n"], places: Float[Array, "*m 2"]) -> Float[Array, "*m"]:
    """Metres above a line of the head's picture, about; -1 in mouth and sockets, tucked in its corner."""
    inside = HEIGHT * (np.interp(np.abs(places[..., 1] - 0.5), *line) - places[..., 0])
    return np.where((places < 0.032).all(-1), -1.0, inside)


def skin_pieces(body: Body, looks: Looks, worn: SynthSubject, hidden: Bool[Array, "vertices"]) -> list[PersonPiece]:
    """Body, head and eyes, without the faces whose corners are all `hidden`; `worn`: the built-in person."""
    number, uv = chart(body)
    weights, shown = dense_weights(body.skin), ~hidden[body.faces].all(1)
    # metres past the wrist
    past = np.abs(body.vertices[:, 0]) - np.abs(body.joints[20:22, 0]).mean()
    limbs = body_picture(worn.textures[BODY], looks, uv[number == BODY], past[body.faces[number == BODY]])
    pictures = {BODY: limbs, HEAD: head_picture(worn.textures[HEAD], looks)}
    rows = {part: np.flatnonzero((number == part) & shown) for part in pictures}
    return [PersonPiece("skin", body.vertices, body.faces[rows[part]], uv[rows[part]], weights, picture)
            for part, picture in pictures.items()] + [_eyes(body, looks, worn)]  # fmt: skip


def _places() -> Float[Array, "size size 2"]:
    row, column = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE
    return np.stack([column, row], -1)


def head_picture(painted: Picture, looks: Looks) -> Picture:
    """The painted face in another skin; where hair grows the bald scalp, or the ground color of hair."""
    places = _places()
    aside = np.abs(places[..., 1] - 0.5)
    covered = smoothstep(-1.0, 0.0, inside_line(PAINTED_HAIR, places) / np.interp(aside, [0.3, 0.4], [0.01, 0.03]))
    covered = np.maximum(covered, smoothstep(0.0, 0.15, places[..., 0] - np.interp(aside, *NECK)))[..., None]
    color = _toned(painted, looks) * (1 - covered) + _plain(looks, 3) * covered
    if looks.hair != "bald":
        grown = smoothstep(0.001, 0.008, inside_line(HAIRLINE, places))[..., None]
        color = color * (1 - grown) + 0.8 * np.array(looks.hair_color) * grown
    return np.clip(np.round(color), 0, 255).astype(np.uint8)


def body_picture(
    painted: Picture, looks: Looks, uv: Float[Array, "faces 3 2"], past: Float[Array, "faces 3"]
) -> Picture:
    """Plain skin, with the painted hands beyond the wrists; `past`: metres of the corners past the wrist."""
    places, first = np.unique(uv.reshape(-1, 2), axis=0, return_index=True)
    hand = LinearNDInterpolator(places, past.ravel()[first], fill_value=-1)(_places())
    share = smoothstep(-0.02, 0.03, hand)[..., None]
    color = _plain(looks, 4) * (1 - share) + _toned(painted, looks) * share
    return np.clip(np.round(color), 0, 255).astype(np.uint8)


def _toned(painted: Picture, looks: Looks) -> Float[Array, "size size 3"]:
    small = Image.fromarray(painted).resize((SIZE, SIZE), Image.Resampling.BOX)
    return np.asarray(small, np.float32) / PAINTED[looks.sex] * looks.skin


def _plain(looks: Looks, seed: int) -> Float[Array, "size size 3"]:
    """Skin as it is on arms and legs: a little uneven."""
    grain = np.random.default_rng([looks.seed, seed]).standard_normal((32, 32)).astype(np.float32)
    tone = np.asarray(Image.fromarray(grain).resize((SIZE, SIZE), Image.Resampling.BICUBIC))[..., None]
    return 0.93 * np.array(looks.skin) * (1 + tone * [0.012, 0.018, 0.018])


def _eyes(body: Body, looks: Looks, worn: SynthSubject) -> PersonPiece:
    """The painted eyeballs of the built-in person, put in the sockets, with another iris."""
    assert worn.eye is not None
    faces = worn.faces[worn.eye[worn.faces].all(1)]
    used, index = np.unique(faces, return_inverse=True)
    points = worn.vertices[used].astype(np.float64)
    for side, (*centre, radius) in zip((1, -1), socket_spheres(body.vertices), strict=True):
        own = side * worn.vertices[used, 0] > 0
        middle, size = fit_sphere(points[own])
        points[own] = centre + (points[own] - middle) * radius / size
    picture = worn.textures[EYEBALL].astype(np.float32)
    away = np.hypot(*((np.mgrid[: len(picture), : len(picture)] + 0.5) / len(picture) - 0.5))[..., None]
    tone = picture.mean(2, keepdims=True)
    # not the reflection
    iris = (away > 0.122) & (away < 0.2) & (tone < 225)
    picture = np.clip(np.where(iris, tone / 120 * looks.iris, picture), 0, 255).astype(np.uint8)
    weights = np.tile(np.eye(52)[15], (len(used), 1))
    return PersonPiece("eye", points, index.reshape(-1, 3), worn.uv[faces].astype(np.float64), weights, picture)
