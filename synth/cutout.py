"""Hair cards, lashes and other see-through cloth made solid: the triangles that a texture's alpha hides are cut away.

A rasteriser that keeps the nearest triangle cannot look through one. Cut once, the mesh is the same thing to
pictures, masks, visibility and distances alike.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from avatar.skinning import dense_weights, strongest_four
from avatar.texture import sample_texture
from synth.people.mesh import in_four
from synth.subject import SynthSubject

FINEST_EDGE = 0.003  # metres: cut edges are as ragged as this
MAX_SPLITS = 4


def cut_out(subject: SynthSubject) -> SynthSubject:
    """The subject without the surface where alpha is below one half; unchanged if nothing is see-through."""
    if all(alpha is None for alpha in subject.alpha):
        return subject
    vertices, uv = subject.vertices.astype(np.float64), subject.uv.astype(np.float64)
    weights, part, hair = dense_weights(subject.skin), subject.part, subject.hair
    eye = np.zeros(len(vertices), bool) if subject.eye is None else subject.eye
    kept_faces, kept_material = [], []
    for number, alpha in enumerate(subject.alpha):
        faces = subject.faces[subject.material == number].astype(np.int64)
        if alpha is not None and len(faces):
            whole = []
            for split in range(MAX_SPLITS + 1):
                longest = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2).max(1)
                opaque = _opaque_share(alpha, uv[faces])
                last = (longest <= FINEST_EDGE) | (split == MAX_SPLITS)
                whole.append(faces[(opaque == 1) | (last & (opaque >= 0.5))])
                faces = faces[(opaque > 0) & (opaque < 1) & ~last]
                if not len(faces):
                    break
                faces, edges = in_four(faces, len(vertices))
                vertices, uv, weights = (np.r_[values, values[edges].mean(1)] for values in (vertices, uv, weights))
                part, hair, eye = (np.r_[values, values[edges[:, 0]]] for values in (part, hair, eye))
            faces = np.concatenate(whole)
        kept_faces.append(faces)
        kept_material.append(np.full(len(faces), number))
    faces = np.concatenate(kept_faces)
    used, index = np.unique(faces, return_inverse=True)
    return replace(
        subject,
        vertices=vertices[used].astype(np.float32),
        faces=index.reshape(-1, 3).astype(np.int32),
        uv=uv[used].astype(np.float32),
        material=np.concatenate(kept_material).astype(np.int32),
        alpha=(None,) * len(subject.alpha),
        skin=strongest_four(weights[used]),
        part=part[used],
        hair=hair[used],
        eye=None if subject.eye is None else eye[used],
    )


def _opaque_share(alpha: UInt8[Array, "height width"], uv: Float[Array, "faces 3 2"]) -> Float[Array, "faces"]:
    """The share of 15 places spread over each triangle at which alpha is one half or more."""
    grid = [(i, j, 4 - i - j) for i in range(5) for j in range(5 - i)]
    places = np.einsum("pc,fcx->fpx", np.array(grid) / 4, uv).reshape(-1, 2)
    opaque = sample_texture(alpha[:, :, None], np.where((places < 0) | (places > 1), places % 1, places))[:, 0] >= 128
    return opaque.reshape(len(uv), len(grid)).mean(1)
