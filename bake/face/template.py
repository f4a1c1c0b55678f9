"""The registered template of a capture as the face's shapes need it, in the canonical pose.

The canonical pose turns neither trunk nor head, so shapes are added as they are. Registration follows surface, not
features: where a surface said little the lips of a template are torn. So its mouth is mended by what the skin round it
does on the whole, and what lies behind the lips is the built-in body's, moved with that skin.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.body import builtin_body
from avatar.face_template import BODY, FaceTemplate, builtin_face
from avatar.skeleton import BIG_POSE, JOINTS, skin_transforms
from capture.folder import CaptureSubject
from capture.template.eyes import EyeSpheres, body_sockets, eye_spheres, socket_spheres

# metres round the middle of the mouth in which lips are mended, and inside of which the whole mouth moves alike
NEAR_MOUTH = 0.045
# metres that a vertex of the mouth may be off what its neighbours do
TORN = 0.0025
NEIGHBOURS, SMOOTHINGS = 60, 10
# metres off a smooth line at which a mended lip line still is torn
REFUSED = 0.004


class FaceRefused(Exception):
    """This person gets no face; the sentence says why."""


class MouthTint(NamedTuple):
    """Factors of what is painted behind the lips, red, green and blue."""

    teeth: Float[Array, "3"]
    red: Float[Array, "3"]


class PersonFace(NamedTuple):
    """The built-in face on one person, canonical, metres."""

    face: FaceTemplate
    vertices: Float[Array, "body 3"]  # the template's, the mouth mended
    # those of its skin that a shape may move, without the inside of the mouth and the eye sockets
    skin: Integer[Array, "skin 3"]
    # where the vertices are of face.inside, ascending, and of face.parts
    inside: Float[Array, "inside 3"]
    parts: Float[Array, "parts 3"]
    eyes: EyeSpheres
    # the surface shows the balls between the lids; else eyes are painted on a surface that goes on
    filmed: bool = True
    tint: MouthTint = MouthTint(np.ones(3), np.ones(3))


def person_face(subject: CaptureSubject) -> PersonFace:
    """The face of a person whose template was registered from a built-in body.

    Raises:
        FaceRefused: the template is another one, or its lips cannot be mended.
    """
    body, face = builtin_body("male"), builtin_face()
    key = lambda faces: (faces[:, 0] * BODY + faces[:, 1]) * BODY + faces[:, 2]
    if not subject.on_free_body:
        raise FaceRefused("its template is not of the built-in body")
    hidden = np.isin(key(body.faces), key(face.inside))
    for socket in body_sockets():
        hidden |= np.isin(body.faces, socket.inside).all(1)
    moves = (face.offsets[:, :BODY] != 0).any((0, 2))
    skin = body.faces[~hidden & moves[body.faces].any(1)]
    inside = np.unique(face.inside)
    middle = body.vertices[np.concatenate(face.seam)].mean(0)
    near = np.setdiff1d(np.unique(skin), inside)
    near = near[np.linalg.norm(body.vertices[near] - middle, axis=1) < NEAR_MOUTH]
    vertices = np.asarray(subject.vertices[:BODY], np.float64).copy()
    linear, shift = affine(body.vertices[near], vertices[near])
    seam = np.unique(np.concatenate(face.seam))
    lips = np.union1d(near, seam)
    off = vertices[lips] - body.vertices[lips] @ linear - shift
    vertices[lips] = body.vertices[lips] @ linear + shift + smoothed(body.vertices[lips], off)
    for half in face.seam:
        at = vertices[half]
        rough = float(np.abs(at[:, 1] - np.polyval(np.polyfit(at[:, 0], at[:, 1], 6), at[:, 0])).max())
        if rough > REFUSED or (np.diff(at[:, 0]) < -0.003).any():
            raise FaceRefused(f"its template's lips are torn by {rough * 1e3:.0f} mm")
    moved = lambda points: points @ linear + shift
    return PersonFace(face, vertices, skin, moved(body.vertices[inside]), moved(face.parts), spheres(subject))


def spheres(subject: CaptureSubject) -> EyeSpheres:
    """The eyeballs of a template of the built-in body, canonical: stated, or what its sockets hold."""
    found = eye_spheres(subject)
    if found is not None:
        return found
    head = skin_transforms(BIG_POSE, subject.joints, rest=np.zeros((52, 3)))[JOINTS.index("head")]
    balls = socket_spheres(subject.rest[:BODY])
    return EyeSpheres(balls[:, :3] @ head[:3, :3].T + head[:3, 3], balls[:, 3])


def affine(source: Float[Array, "n 3"], target: Float[Array, "n 3"]) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    """A and b of target = source A + b, robustly: what is farther off than most counts less."""
    system, weight = np.c_[source, np.ones(len(source))], np.ones(len(source))
    for _ in range(5):
        found = np.linalg.lstsq(system * weight[:, None], target * weight[:, None], rcond=None)[0]
        off = np.linalg.norm(system @ found - target, axis=1)
        weight = 1 / np.sqrt(1 + (off / (2 * np.median(off) + 1e-9)) ** 2)
    return found[:3], found[3]


def smoothed(places: Float[Array, "n 3"], off: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Displacements of which those torn from what their neighbours do are replaced."""
    near = np.asarray(KDTree(places).query(places, k=min(NEIGHBOURS, len(places)))[1])
    middle = np.median(off[near], axis=1)
    torn = np.linalg.norm(off - middle, axis=1) > TORN
    off = np.where(torn[:, None], middle, off)
    for _ in range(SMOOTHINGS if torn.any() else 0):
        off = np.where(torn[:, None], off[near[:, :9]].mean(1), off)
    return off
