"""Landmarks of the free body's face and hands, found by texture coordinates, which both sexes share.

Frame: pose 0, pelvis at the origin, metres.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from experiments.builtin.refine import TexturedMesh

Array = np.ndarray

NAILS = (  # texture coordinates (v up) of the nails' middles
    (0.408, 0.0822), (0.4140, 0.0463), (0.4459, 0.0160), (0.5010, 0.0186), (0.5378, 0.0577),
    (0.7166, 0.0822), (0.7113, 0.0463), (0.6791, 0.0160), (0.6241, 0.0186), (0.5874, 0.0577),
)  # fmt: skip
LID_X = np.linspace(-0.0125, 0.0135, 11)  # towards the temple, from the eye's centre


@dataclass(frozen=True)
class Face:
    """Landmarks found on the body by its texture coordinates, which both sexes share."""

    # centres of the eyeballs, left then right
    eyes: Float[Array, "2 3"]
    eye_radius: float
    # of each eye the upper and the lower lid's edge: y over the centre at LID_X
    lids: Float[Array, "2 2 11"]
    mouth: Float[Array, "3"]
    nose: Float[Array, "3"]
    chin: Float[Array, "3"]
    ears: Float[Array, "2 3"]
    # the middles of the finger nails
    nails: Float[Array, "10 3"]


def at_uv(mesh: TexturedMesh, u: float, v: float) -> Float[Array, "3"]:
    """The surface point at a texture coordinate (v down)."""
    a, b, c = (mesh.uv[mesh.uv_faces[:, i]] for i in range(3))
    p = np.array([u, v])

    def cross(x, y):
        return x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]

    area = cross(b - a, c - a)
    area = np.where(area == 0, np.inf, area)
    s, t = cross(p - a, c - a) / area, cross(b - a, p - a) / area
    inside = np.where(np.isfinite(area), np.minimum(np.minimum(s, t), 1 - s - t), -1.0)
    k = int(np.argmax(inside))
    return np.array([1 - s[k] - t[k], s[k], t[k]]) @ mesh.vertices[mesh.faces[k]]


def find_face(mesh: TexturedMesh) -> Face:
    """Eyes from the sockets' own islands of the texture, the rest from fixed texture coordinates."""
    middle = mesh.uv[mesh.uv_faces].mean(1)
    island = (middle[:, 0] < 0.16) & (middle[:, 1] > 0.365) & (middle[:, 1] < 0.455)
    island &= mesh.weights[mesh.faces[:, 0]][:, 15] > 0.9
    socket = np.unique(mesh.faces[island])
    eyes, radii = [], []
    for side in (1, -1):
        points = mesh.vertices[socket][side * (mesh.vertices[socket][:, 0] - mesh.vertices[socket][:, 0].mean()) > 0]
        system = np.concatenate([2 * points, np.ones((len(points), 1))], 1)
        centre = np.linalg.lstsq(system, (points**2).sum(1), rcond=None)[0][:3]
        eyes.append(centre)
        radii.append(np.linalg.norm(points - centre, axis=1).min())
    on_socket, on_skin = np.zeros((2, len(mesh.vertices)), bool)
    on_socket[mesh.faces[island]] = True
    on_skin[mesh.faces[~island]] = True
    rim = mesh.vertices[on_socket & on_skin]
    lids = []
    for side, centre in zip((1, -1), eyes):
        d = rim - centre
        d = d[np.linalg.norm(d, axis=1) < 0.02] * [side, 1, 1]
        d = d[np.argsort(d[:, 0])]
        over = d[:, 1] >= np.interp(d[:, 0], d[[0, -1], 0], d[[0, -1], 1])
        lids.append([np.interp(LID_X, d[rows, 0], d[rows, 1]) for rows in (over, ~over)])
    return Face(
        np.array(eyes),
        float(min(radii)),
        np.array(lids),
        0.5 * (at_uv(mesh, 0.909, 1 - 0.502) + at_uv(mesh, 0.909, 1 - 0.466)),
        at_uv(mesh, 0.863, 1 - 0.4835),
        at_uv(mesh, 0.936, 1 - 0.4835),
        np.array([at_uv(mesh, 0.846, 1 - 0.626), at_uv(mesh, 0.846, 1 - 0.341)]),
        np.array([at_uv(mesh, u, 1 - v) for u, v in NAILS]),
    )
