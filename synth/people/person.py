"""The person of a seed, dressed: a subject to film like any other."""

from dataclasses import replace

import numpy as np

from avatar.skeleton import JOINTS, PARTS, joint_transforms, skin_transforms
from avatar.skinning import skin_points, strongest_four
from capture.read.template import part_of
from synth.people.body import built_in, eye_piece, figure, skin_pieces
from synth.people.clothes import dress
from synth.people.hair import hair_pieces
from synth.people.looks import draw
from synth.people.mesh import Piece
from synth.people.shoes import heel_pieces, in_shoes, raised, shoe_pieces
from synth.subject import SynthSubject

LICENCE = "CC0-1.0 (body: MakeHuman base mesh; clothes, hair and colors: this project)"


def person(seed: int) -> SynthSubject:
    """The dressed person of a seed: the same on every machine."""
    looks = draw(seed)
    body, worn = figure(looks), built_in(looks.sex)
    clothes = dress(body, looks)
    shoes = shoe_pieces(body, looks)
    hidden = clothes.hidden | in_shoes(body, looks)
    pieces = [*skin_pieces(body, looks, worn, hidden), eye_piece(body, looks, worn), *clothes.pieces]
    pieces += [*hair_pieces(body, looks, clothes.pieces), *shoes]
    joints = body.joints
    if looks.heel:
        pose = raised(looks.heel)
        transforms = skin_transforms(pose, joints, rest=np.zeros((len(JOINTS), 3)))
        pieces = [replace(p, points=skin_points(p.points, strongest_four(p.weights), transforms)) for p in pieces]
        pieces += heel_pieces(pieces[-2:])
        joints = joint_transforms(pose, joints)[:, :3, 3]
    return _subject(pieces, joints, seed)


def _subject(pieces: list[Piece], joints, seed: int) -> SynthSubject:
    """All pieces as one mesh; a vertex for each pair of a point and a texture coordinate."""
    points, faces, uv, weights, kinds, material = [], [], [], [], [], []
    pictures, start = [], 0
    for piece in pieces:
        corner = np.c_[piece.faces.reshape(-1, 1), np.round(piece.uv.reshape(-1, 2) * 2**20).astype(np.int64)]
        _, first, index = np.unique(corner, axis=0, return_index=True, return_inverse=True)
        point = piece.faces.reshape(-1)[first]
        points.append(piece.points[point])
        weights.append(piece.weights[point])
        uv.append(piece.uv.reshape(-1, 2)[first])
        faces.append(index.reshape(-1, 3) + start)
        kinds += [piece.kind] * len(point)
        start += len(point)
        known = [k for k, picture in enumerate(pictures) if picture is piece.picture]
        if not known:
            pictures.append(piece.picture)
        material.append(np.full(len(piece.faces), known[0] if known else len(pictures) - 1))
    skin, kind = strongest_four(np.concatenate(weights)), np.array(kinds)
    part = part_of(skin)
    part[kind == "hair"] = PARTS.index("head")
    return SynthSubject(
        name=f"builtin:{seed}",
        vertices=np.concatenate(points).astype(np.float32),
        faces=np.concatenate(faces).astype(np.int32),
        uv=np.concatenate(uv).astype(np.float32),
        material=np.concatenate(material).astype(np.int32),
        textures=tuple(pictures),
        alpha=(None,) * len(pictures),
        skin=skin,
        joints=joints.astype(np.float32).astype(np.float64),
        part=part,
        hair=kind == "hair",
        eye=kind == "eye",
        licence=LICENCE,
    )
