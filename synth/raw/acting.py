"""A built-in person who acts: what the face does in each frame of the film of a face, and what then is behind the lips.

How far the person goes beside the built-in shapes, and what color teeth and tongue have, is drawn from the seed.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.body import builtin_body
from avatar.face import SHAPES, eye_turn
from avatar.face_names import shapes_of
from avatar.face_template import BODY, builtin_face
from avatar.skeleton import JOINTS, PARTS
from avatar.skinning import SkinWeights
from capture.fit.face_film import moving_points
from capture.own_face import FITTED, NUMBERS
from capture.template.eyes import fit_sphere
from command.errors import AssetError
from synth.people.body import figure
from synth.people.looks import draw
from synth.people.mesh import smoothstep
from synth.subject import SynthSubject

# one after the other, with a rest before each
ACTS: tuple[dict[str, float], ...] = (
    {"jawOpen": 1.0}, {"mouthSmile": 1.0}, {"browInnerUp": 1.0, "browOuterUp": 1.0}, {"browDown": 1.0},
    {"eyeBlink": 1.0}, {"eyeLookOutLeft": 1.0, "eyeLookInRight": 1.0}, {"eyeLookInLeft": 1.0, "eyeLookOutRight": 1.0},
)  # fmt: skip
# shares of an act: the rest before it, and the ways there and back
REST, WAY = 0.3, 0.15
# the least and the most of a person's gains; radians that eyes turn aside
GAINS, ASIDE = (0.6, 1.3), np.radians(28.0)
# sRGB: an average mouth, and how much lighter or darker a person's is; metres behind the lips where it is darkest
TOOTH, GUM, TONGUE, FLESH = (226, 214, 190), (170, 90, 88), (176, 96, 94), (150, 78, 74)
SHADE, DEEP = 0.12, 0.05
HEAD = JOINTS.index("head")


@dataclass(frozen=True)
class FaceActs:
    """One film of a face. Offsets are metres, in pose 0."""

    subject: SynthSubject  # with teeth and tongue
    shapes: Float[Array, "52 vertices 3"]  # its vertices, at the person's own gains
    points: dict[str, Float[Array, "52 3"]]  # the same of named points
    weights: Float[Array, "frames 52"]
    eyes: tuple[tuple[Array, Float[Array, "3"]], ...]  # vertices and middle of each ball
    truth: dict[str, Any]

    def vertices(self, i: int) -> Float[Array, "vertices 3"]:
        """How far each vertex is off its place in frame i."""
        moved = np.tensordot(self.weights[i], self.shapes, 1)
        side = self.weights[i] @ _TO_THE_LEFT
        for rows, middle in self.eyes if side else ():
            arm = self.subject.vertices[rows] - middle
            moved[rows] = arm @ eye_turn(ASIDE * side, 0.0).T - arm
        return moved

    def named(self, i: int) -> dict[str, Float[Array, "3"]]:
        """The same of named points."""
        return {name: self.weights[i] @ each for name, each in self.points.items()}


_TO_THE_LEFT = np.zeros(len(SHAPES))
_TO_THE_LEFT[[SHAPES.index("eyeLookOutLeft"), SHAPES.index("eyeLookInLeft")]] = 1, -1


def acting(person: SynthSubject, frames: int, seed: int) -> FaceActs:
    """The film of a built-in person's face.

    Raises:
        AssetError: the person is no built-in one.
    """
    face, body = builtin_face(), body_of(person.name)
    rng = np.random.default_rng([seed, 71])
    gains = rng.uniform(*GAINS, len(FITTED))
    teeth, red = 1 + SHADE * rng.uniform(-1, 1, (2, 3))
    offsets = face.offsets.astype(np.float64)
    offsets[NUMBERS] *= gains[:, None, None]
    away, row = KDTree(body).query(person.vertices, distance_upper_bound=1e-5)
    skin = np.where(np.isfinite(away), row, BODY)
    subject, behind = with_mouth(person, skin, body, mouth_picture(teeth, red))
    own = np.where((skin < BODY)[:, None], offsets[:, skin], 0)
    shapes = np.concatenate([own, offsets[:, behind]], 1)
    points = {name: offsets[:, vertex] for name, vertex in moving_points().items()}
    eyes = []
    assert person.eye is not None
    for side in (1, -1):
        rows = np.flatnonzero(person.eye & (side * person.vertices[:, 0] > 0))
        eyes.append((rows, fit_sphere(person.vertices[rows].astype(np.float64))[0]))
    colors = {"teeth": (teeth * TOOTH).tolist(), "red": (red * TONGUE).tolist()}
    truth = {"gains": dict(zip(FITTED, gains.tolist())), **colors}
    return FaceActs(subject, shapes, points, weights_of_acts(frames), tuple(eyes), truth)


def weights_of_acts(frames: int) -> Float[Array, "frames 52"]:
    """What a film of so many frames does."""
    weights, place = np.zeros((frames, len(SHAPES))), np.arange(frames) * len(ACTS) / frames
    for number, act in enumerate(ACTS):
        share = place - number
        strength = smoothstep(REST, REST + WAY, share) * (1 - smoothstep(1 - WAY, 1.0, share))
        for shape, weight in shapes_of(act).items():
            weights[:, shape] += weight * strength
    return weights


def body_of(name: str) -> Float[Array, "body 3"]:
    """The free body's vertices as a built-in person has them, pose 0.

    Raises:
        AssetError: another person.
    """
    who = name.removeprefix("builtin:")
    if who in ("male", "female"):
        return builtin_body(who).vertices
    if who == name:
        raise AssetError(
            f"{name}: --face-film films builtin, builtin:female and builtin:SEED alone: of others no shapes are known"
        )
    # heels move no head
    return figure(draw(int(who))).vertices


def with_mouth(
    person: SynthSubject, skin: Int[Array, "vertices"], body: Float[Array, "body 3"], picture: UInt8[Array, "h w 3"]
) -> tuple[SynthSubject, Int[Array, "more"]]:
    """The person with teeth and tongue, and with the inside of the mouth in colors of its own; the numbers of the added
    vertices among all of the face template's. `skin`: the same of the person's own, BODY of those that have none."""
    face, average = builtin_face(), builtin_body("male").vertices
    inside, faces = np.unique(face.inside, return_inverse=True)
    # teeth and tongue lie in it as in the built-in man's
    affine = np.linalg.lstsq(np.c_[average[inside], np.ones(len(inside))], body[inside], rcond=None)[0]
    points = np.concatenate([body[inside], np.c_[face.parts, np.ones(len(face.parts))] @ affine])
    row = np.r_[np.zeros(len(inside)), np.repeat([1, 1, 2], face.part_counts)]
    across = np.r_[np.clip((body[inside, 2].max() - body[inside, 2]) / DEEP, 0, 1), _from_gum()]
    uv = np.c_[(0.5 + 63 * across) / 64, (row + 0.5) / 3]
    added = np.concatenate([faces.reshape(-1, 3), face.part_faces + len(inside)]) + len(person.vertices)
    key = lambda of: (of[:, 0] * (BODY + 1) + of[:, 1]) * (BODY + 1) + of[:, 2]
    kept = ~np.isin(key(skin[person.faces].astype(np.int64)), key(face.inside))
    first = np.eye(1, 4).repeat(len(points), 0)
    shape = lambda own: (len(points), *own.shape[1:])
    with_more = lambda own, more: np.concatenate([own, np.broadcast_to(more, shape(own)).astype(own.dtype)])
    subject = replace(
        person, vertices=with_more(person.vertices, points),
        faces=np.concatenate([person.faces[kept], added]).astype(np.int32),
        uv=with_more(person.uv, uv), part=with_more(person.part, PARTS.index("head")),
        hair=with_more(person.hair, False),
        material=np.r_[person.material[kept], np.full(len(added), len(person.textures))].astype(np.int32),
        textures=(*person.textures, picture), alpha=(*person.alpha, None),
        skin=SkinWeights(with_more(person.skin.joints, HEAD * first), with_more(person.skin.weights, first)),
        eye=None if person.eye is None else with_more(person.eye, False),
    )  # fmt: skip
    return subject, np.r_[inside, BODY + np.arange(len(face.parts))]


def mouth_picture(teeth: Float[Array, "3"], red: Float[Array, "3"]) -> UInt8[Array, "24 64 3"]:
    """Three rows of a picture: the inside from the lips to the throat, gums to the edge of the teeth, the tongue."""
    along = np.arange(64)[:, None] / 63
    rows = (red * FLESH * (1 - 0.8 * along), np.where(along < 0.36, red * GUM, teeth * TOOTH), red * TONGUE + 0 * along)
    return np.repeat(np.clip(np.stack(rows), 0, 255).round().astype(np.uint8), 8, 0)


def _from_gum() -> Float[Array, "parts"]:
    """How far on the way from the gum to a tooth's edge the vertices of teeth and tongue are."""
    face, at = builtin_face(), []
    for v in np.split(face.part_uv[:, 1].astype(np.float64), np.cumsum(face.part_counts)[:-1]):
        v = (v - v.min()) / np.ptp(v)
        at.append(np.where(v < 2 / 3, 1.5 * v, 3 * (1 - v)))
    return np.concatenate(at)
