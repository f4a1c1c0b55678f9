"""The person of a seed, dressed: a subject to film like any other."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from avatar.skeleton import JOINTS, PARTS, joint_transforms, skin_transforms
from avatar.skinning import skin_points, strongest_four
from capture.fit.points import body_points
from capture.keypoints.record import FACE
from capture.read.template import part_of
from synth.people.body import built_in, figure, skin_pieces
from synth.people.clothes import dress
from synth.people.hair import hair_pieces
from synth.people.looks import Looks, draw
from synth.people.mesh import PersonPiece
from synth.people.shoes import heel_pieces, in_shoes, raised, shoe_pieces
from synth.subject import SynthSubject

HEAD = JOINTS.index("head")
EYES_AND_EARS = ("left_eye", "right_eye", "left_ear", "right_ear")
LICENCE = "CC0-1.0 (body: MakeHuman base mesh; clothes, hair and colors: this project)"


def person(seed: int) -> SynthSubject:
    looks = draw(seed)
    return replace(subject_of(*made(looks), f"builtin:{seed}"), features=features_of(looks))


def features_of(looks: Looks) -> dict[str, Float[np.ndarray, "3"]]:
    """Eyes, nose, ears and face_00 to face_67 of a person, in its shoes."""
    body = figure(looks)
    T = skin_transforms(raised(looks.heel), body.joints, rest=np.zeros((52, 3)))[HEAD]
    at = {name: point.place(body.vertices, body.joints) for name, point in body_points().items()}
    return {name: T[:3, :3] @ at[name] + T[:3, 3] for name in ("nose", *EYES_AND_EARS, *FACE)}


def made(looks: Looks) -> tuple[list[PersonPiece], Float[np.ndarray, "52 3"]]:
    """All pieces of a person, and the joints; shoes, and their heels, come last."""
    body, worn = figure(looks), built_in(looks.sex)
    clothes, hidden = dress(body, looks)
    pieces = skin_pieces(body, looks, worn, hidden | in_shoes(body, looks))
    pieces += [*clothes, *hair_pieces(body, looks, clothes), *shoe_pieces(body, looks)]
    if not looks.heel:
        return pieces, body.joints
    transforms = skin_transforms(raised(looks.heel), body.joints, rest=np.zeros((52, 3)))
    pieces = [replace(p, points=skin_points(p.points, strongest_four(p.weights), transforms)) for p in pieces]
    return pieces + heel_pieces(pieces[-2:]), joint_transforms(raised(looks.heel), body.joints)[:, :3, 3]


def subject_of(pieces: list[PersonPiece], joints: Float[np.ndarray, "52 3"], name: str) -> SynthSubject:
    """All pieces as one mesh; a vertex for each pair of a point and a texture coordinate."""
    rows, faces, start = [], [], 0
    for piece in pieces:
        corner = np.c_[piece.faces.reshape(-1, 1), np.round(piece.uv.reshape(-1, 2) * 2**20).astype(np.int64)]
        _, first, index = np.unique(corner, axis=0, return_index=True, return_inverse=True)
        point = piece.faces.reshape(-1)[first]
        faces.append(index.reshape(-1, 3) + start)
        rows.append((piece.points[point], piece.uv.reshape(-1, 2)[first], piece.weights[point]))
        start += len(point)
    vertices, uv, weights = (np.concatenate(values) for values in zip(*rows, strict=True))
    kind = np.repeat([piece.kind for piece in pieces], [len(points) for points, _, _ in rows])
    pictures = {id(piece.picture): piece.picture for piece in pieces}
    number = [list(pictures).index(id(piece.picture)) for piece in pieces]
    skin = strongest_four(weights)
    return SynthSubject(
        name=name,
        vertices=vertices.astype(np.float32),
        faces=np.concatenate(faces).astype(np.int32),
        uv=uv.astype(np.float32),
        material=np.repeat(number, [len(piece.faces) for piece in pieces]).astype(np.int32),
        textures=tuple(pictures.values()),
        alpha=(None,) * len(pictures),
        skin=skin,
        joints=joints.astype(np.float32).astype(np.float64),
        part=np.where(kind == "hair", np.uint8(PARTS.index("head")), part_of(skin)),
        hair=kind == "hair",
        eye=kind == "eye",
        licence=LICENCE,
    )
