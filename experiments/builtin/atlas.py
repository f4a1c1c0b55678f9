"""The built-in person's texture layout: the free body's islands, with face and hands enlarged; eyes and skirt keep
their own."""

import numpy as np
from jaxtyping import Float, Int

from experiments.builtin.dressed import EYE, SKIRT, Dressed
from geometry.mesh import component_labels
from synth.people.body import body_atlas

Array = np.ndarray

BODY, HEAD, EYEBALL, CLOTH = range(4)  # materials


def layout(dressed: Dressed) -> tuple[Int[Array, "faces"], Float[Array, "faces 3 2"]]:
    """Material and texture coordinates (v down) of each face."""
    mesh, body = dressed.mesh, np.flatnonzero(~np.isin(dressed.kind, (EYE, SKIRT)))
    uv, material = mesh.uv[mesh.uv_faces], np.where(dressed.kind == EYE, EYEBALL, CLOTH)
    island = component_labels(mesh.uv_faces, len(mesh.uv))[mesh.uv_faces[body, 0]]
    material[body], uv[body] = body_atlas(uv[body], island, mesh.weights[mesh.faces[body, 0], 15] > 0.9)
    return material, uv
