"""One texture of the dressed person: each texel goes to the painter of what it is made of.

Soft sky light and folds are painted in.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from experiments.builtin.canvas import Canvas
from experiments.builtin.dressed import BELT, HAIR, LINING, SHIRT, SHOE, SKIN, SKIRT, SOLE, TROUSERS, Dressed
from experiments.builtin.footwear import paint_shoe, paint_sole
from experiments.builtin.hair import hairline, paint_hair
from experiments.builtin.looks import Looks
from experiments.builtin.shirt import paint_shirt
from experiments.builtin.skin import paint_skin
from experiments.builtin.skirt import paint_skirt
from experiments.builtin.texels import covered_texels, spread
from experiments.builtin.trousers import paint_belt, paint_lining, paint_trousers

Array = np.ndarray


class Shade(NamedTuple):
    """What was measured of every vertex for the painters."""

    normals: Float[Array, "vertices 3"]  # of the dressed person, unit
    # from the sky, 0 to 1
    light: Float[Array, "vertices"]
    # to an even sky, 0 to 1
    opened: Float[Array, "vertices"]
    cavity: Float[Array, "vertices"]  # -1 (crease) to 1 (ridge)


def paint(
    c: Canvas, kind: Int[Array, "n"], dressed: Dressed, joints: Float[Array, "52 3"], looks: Looks
) -> Float[Array, "n 3"]:
    """The color of each texel, sRGB, 0 to 1."""
    out = np.zeros((len(kind), 3), np.float32)
    ground = float(dressed.mesh.vertices[:, 1].min())
    painters = {
        SKIN: lambda x: paint_skin(x, dressed.face, joints, looks),
        SHIRT: lambda x: paint_shirt(x, joints, looks),
        TROUSERS: lambda x: paint_trousers(x, joints, looks),
        BELT: lambda x: paint_belt(x, joints, looks),
        HAIR: lambda x: paint_hair(x, dressed.face, looks),
        SHOE: lambda x: paint_shoe(x, joints, ground, looks),
        SOLE: lambda x: paint_sole(x, ground, looks),
        LINING: lambda x: paint_lining(x, joints, looks),
        SKIRT: lambda x: paint_skirt(x, looks),
    }
    for number, painter in painters.items():
        whole = np.flatnonzero(kind == number)
        for start in range(0, len(whole), 100_000):
            rows = whole[start : start + 100_000]
            some = c.at(rows)
            if number in (SHIRT, TROUSERS, BELT):
                # patterns follow the cloth, not the skin below
                some = replace(some, p=some.q)
            out[rows] = painter(some)
    return np.clip(out, 0, 1)


def painted(
    dressed: Dressed,
    faces: Int[Array, "faces"],
    atlas: Float[Array, "faces 3 2"],
    shade: Shade,
    joints: Float[Array, "52 3"],
    looks: Looks,
    size: int,
) -> UInt8[Array, "size size 3"]:
    """The texture, sRGB, of these faces of the dressed person, at these texture coordinates (v down)."""
    mesh = dressed.mesh
    texels = covered_texels(atlas, size)
    corners = mesh.faces[faces[texels.face]]
    uv_corners = mesh.uv_faces[faces[texels.face]]
    b = texels.barycentric

    def across(values: Array, ids: Array = corners) -> Array:
        """Values of vertices, at the texels."""
        values = np.asarray(values, np.float32)
        weights = b if values.ndim == 1 else b[..., None]
        first, second, third = (values[ids[:, i]] * weights[:, i] for i in range(3))
        return first + second + third

    p = across(dressed.skin_positions)
    n = across(shade.normals)
    n = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
    line = hairline(p, dressed.face, looks).astype(np.float32)
    canvas = Canvas(
        p,
        across(mesh.vertices),
        n,
        across(mesh.uv, uv_corners),
        line,
        across(dressed.collar),
        across(shade.light),
        across(shade.opened),
        across(shade.cavity),
    )
    image = np.zeros((size * size, 3), np.float32)
    image[texels.index] = paint(canvas, dressed.kind[faces[texels.face]], dressed, joints, looks)
    covered = np.zeros(size * size, bool)
    covered[texels.index] = True
    return spread(image.reshape(size, size, 3), covered.reshape(size, size))
