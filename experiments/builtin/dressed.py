"""The dressed person, as `dress` hands it to the painters and to the film.

Frame: pose 0, pelvis at the origin, metres.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from experiments.builtin.face import Face
from experiments.builtin.refine import TexturedMesh

Array = np.ndarray

# what a face is made of
SKIN, SHIRT, TROUSERS, BELT, HAIR, SHOE, SOLE, LINING, EYE, SKIRT = range(10)


@dataclass(frozen=True)
class Dressed:
    """The dressed person, still with the texture coordinates of the body (shoes, eyes and skirt: their own)."""

    mesh: TexturedMesh  # as seen
    # where each vertex lies on the naked body
    skin_positions: Float[Array, "vertices 3"]
    kind: Int[Array, "faces"]
    face: Face
    hairline: Float[Array, "vertices"]  # metres inside the hairline, negative outside
    # metres from the edge of the collar, over the cloth
    collar: Float[Array, "vertices"]


def joined(
    dressed: Dressed,
    points: Float[Array, "n 3"],
    faces: Int[Array, "G 3"],
    uv: Float[Array, "T 2"],
    uv_faces: Int[Array, "G 3"],
    weights: Float[Array, "n 52"],
    kind: Int[Array, "G"],
    skin: Float[Array, "n 3"],
) -> Dressed:
    """The dressed person and one more closed piece, which lies at `skin` on the naked body."""
    mesh, n = dressed.mesh, len(dressed.mesh.vertices)
    return replace(
        dressed,
        mesh=TexturedMesh(
            np.concatenate([mesh.vertices, points]),
            np.concatenate([mesh.faces, faces + n]),
            np.concatenate([mesh.uv, uv]),
            np.concatenate([mesh.uv_faces, uv_faces + len(mesh.uv)]),
            np.concatenate([mesh.weights, weights]),
        ),
        skin_positions=np.concatenate([dressed.skin_positions, skin]),
        kind=np.concatenate([dressed.kind, kind]),
        hairline=np.concatenate([dressed.hairline, np.full(len(points), -0.1)]),
        collar=np.concatenate([dressed.collar, np.full(len(points), 1.0)]),
    )
