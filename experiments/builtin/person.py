"""The built-in person as a subject to film: dressed, laid out, lit and painted."""

from functools import cache

import numpy as np
from jaxtyping import Float, UInt8

from avatar.body import builtin_body
from avatar.skeleton import PARTS
from avatar.skinning import strongest_four
from experiments.builtin.atlas import BODY, CLOTH, EYEBALL, HEAD, layout
from experiments.builtin.dress import dress
from experiments.builtin.dressed import EYE, HAIR
from experiments.builtin.eyes import eye_picture
from experiments.builtin.looks import FEMALE, MALE
from experiments.builtin.occlusion import baked_light, crease
from experiments.builtin.paint import Shade, painted
from geometry.mesh import vertex_normals
from synth.subject import SynthSubject

Array = np.ndarray

TEXTURE = 2048


@cache
def builtin_subject(sex: str, texture: int = TEXTURE) -> SynthSubject:
    """The built-in person, "male" or "female"; takes some seconds once, the same on every machine.

    Materials: 0 body, clothes and shoes, 1 head, 2 eyes, 3 the skirt of who wears one.

    Raises:
        ValueError: another word.
    """
    if sex not in ("male", "female"):
        raise ValueError(f"sex should be 'male' or 'female', is {sex!r}")
    body, looks = builtin_body(sex), {"male": MALE, "female": FEMALE}[sex]
    dressed = dress(body, looks)
    mesh = dressed.mesh
    material, atlas = layout(dressed)
    part = parts_of(mesh.weights)
    light, opened = baked_light(mesh, part)
    normals = vertex_normals(mesh.vertices, mesh.faces)
    cavity = crease(mesh.vertices, mesh.faces, normals)

    textures = []
    sizes = {BODY: texture, HEAD: texture, CLOTH: texture // 2}
    for number in (BODY, HEAD, CLOTH)[: 2 if looks.skirt is None else 3]:
        faces = np.flatnonzero(material == number)
        textures.append(
            painted(
                dressed,
                faces,
                atlas[faces],
                Shade(normals, light, opened, cavity),
                body.joints,
                looks,
                sizes[number],
            )
        )
    textures.insert(EYEBALL, eye_picture(looks, dressed.face.eye_radius))

    # one vertex for each pair of a point and a texture coordinate
    corner = np.concatenate([mesh.faces.reshape(-1, 1), np.round(atlas.reshape(-1, 2) * 2**22).astype(np.int64)], 1)
    corner = np.concatenate([corner, np.repeat(material, 3)[:, None]], 1)
    _, first, index = np.unique(corner, axis=0, return_index=True, return_inverse=True)
    point = mesh.faces.reshape(-1)[first]
    hair_points = np.zeros(len(mesh.vertices), bool)
    hair_points[mesh.faces[dressed.kind == HAIR]] = True
    eye_points = np.zeros(len(mesh.vertices), bool)
    eye_points[mesh.faces[dressed.kind == EYE]] = True
    skin = strongest_four(mesh.weights[point])
    return SynthSubject(
        name=f"builtin:{sex}",
        vertices=mesh.vertices[point].astype(np.float32),
        faces=index.reshape(-1, 3),
        uv=atlas.reshape(-1, 2)[first].astype(np.float32),
        material=material,
        textures=tuple(textures),
        alpha=(None,) * len(textures),
        skin=skin,
        joints=np.asarray(body.joints, np.float64),
        part=part[point],
        hair=hair_points[point],
        eye=eye_points[point],
        licence="CC0-1.0 (body: MakeHuman base mesh; clothes, hair and colors: this project)",
    )


def parts_of(weights: Float[Array, "vertices 52"]) -> UInt8[Array, "vertices"]:
    """Which part each vertex belongs to, by its strongest bone: hands with their wrists, head, body."""
    strongest = weights.argmax(1)
    part = np.full(len(weights), PARTS.index("body"), np.uint8)
    part[strongest == 15] = PARTS.index("head")
    part[(strongest == 20) | (strongest >= 22) & (strongest < 37)] = PARTS.index("hand_left")
    part[(strongest == 21) | (strongest >= 37)] = PARTS.index("hand_right")
    return part
