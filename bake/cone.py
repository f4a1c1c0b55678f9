"""What directions training saw, per vertex: global view direction, tangent metric, visibility (paper, Eq. 14)."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer
from numpy import ndarray as Array

from avatar.rotation import unit_or_zero
from geometry.harmonic import fill_reached
from geometry.mesh import blended

# a field's sRGB in [0, 1] at points, seen along unit directions from the camera to the point
ColorFunction = Callable[[Float[Array, "n 3"], Float[Array, "n 3"]], Float[Array, "n 3"]]

# standard deviations of the seen directions at which the clamp has bent them by 1/sqrt(2)
REACH = 1.6
# a vertex seen from one direction only still has a cone of this width
FLOOR = np.radians(3.0)
# observations between which visibility rises from 0 to 1
FEWEST, ENOUGH = 5.0, 20.0
# |mean| below which the directions cancel and their mean means nothing
OPPOSED = 0.05


class ViewCone(NamedTuple):
    """What the training saw of each point, in the canonical frame."""

    direction: Float[Array, "n 3"]  # unit, from camera to surface, canonical
    # Q: xx, xy, xz, yy, yz, zz; zero across the direction
    metric: Float[Array, "n 6"]
    seen: Float[Array, "n"]  # [0, 1]

    def of(self, points: Array) -> "ViewCone":
        """Those of some points, by index or mask."""
        return ViewCone(*(value[points] for value in self))


def matrix_from_six(six: Float[Array, "*n 6"]) -> Float[Array, "*n 3 3"]:
    """Symmetric matrices of their six numbers xx, xy, xz, yy, yz, zz."""
    return six[..., [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(*six.shape[:-1], 3, 3)


def six_from_matrix(matrix: Float[Array, "*n 3 3"]) -> Float[Array, "*n 6"]:
    """The upper triangle of symmetric matrices, row by row."""
    return matrix.reshape(*matrix.shape[:-2], 9)[..., [0, 1, 2, 4, 5, 8]]


def view_cone(
    count: Float[Array, "n"], mean: Float[Array, "n 3"], covariance: Float[Array, "n 6"], normals: Float[Array, "n 3"],
    faces: Integer[Array, "faces 3"],
) -> ViewCone:  # fmt: skip
    """Cone of each vertex of the surface that the statistics were gathered on.

        Q = sum_i e_i e_i^T / (REACH^2 (lambda_i + FLOOR^2)),  v = smoothstep(FEWEST, ENOUGH, count)

    with e_i, lambda_i the eigenpairs of the covariance in the plane across the mean. Where nothing was seen,
    or only from opposite sides (|mean| < 0.05), v = 0 and the direction is filled from the neighbours, and
    where they too cancel it is against the normal: a unit vector always.
    """
    length = np.linalg.norm(mean, axis=1)
    sure = (count > 0) & (length >= OPPOSED)
    x = np.clip((count - FEWEST) / (ENOUGH - FEWEST), 0, 1)
    seen = np.where(sure, x * x * (3 - 2 * x), 0.0)
    direction = np.where(sure[:, None], mean / np.maximum(length, 1e-20)[:, None], 0.0)
    if not sure.any():
        direction = -normals
    elif not sure.all():
        # far from anything seen a harmonic direction is short but sound; below a thousandth it has cancelled
        filled = fill_reached(direction, sure, faces)
        direction = np.where((np.linalg.norm(filled, axis=1) > 1e-3)[:, None], filled, -normals)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)

    first, second = tangent_frame(direction)
    frame = np.stack([first, second], 1)  # (n, 2, 3)
    flat = frame @ matrix_from_six(np.where(sure[:, None], covariance, 0.0)) @ frame.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(0.5 * (flat + flat.transpose(0, 2, 1)))
    axes = vectors.transpose(0, 2, 1) @ frame  # rows: tangent eigenvectors in 3-D
    weight = 1.0 / (REACH**2 * (np.maximum(values, 0) + FLOOR**2))
    metric = np.einsum("nk,nki,nkj->nij", weight, axes, axes)
    return ViewCone(direction, six_from_matrix(metric), seen)


def tangent_frame(direction: Float[Array, "n 3"]) -> tuple[Array, Array]:
    """Two unit vectors across each unit direction (Duff et al. 2017): no square root, no pole."""
    x, y, z = direction.T
    sign = np.where(z >= 0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1 + sign * x * x * a, sign * b, -sign * x], 1), np.stack([b, sign + y * y * a, -y], 1)


def interpolated(cone: ViewCone, corners: Integer[Array, "n 3"], barycentric: Float[Array, "n 3"]) -> ViewCone:
    """The cone inside triangles, as the shader sees it: linear, direction renormalised."""
    direction = unit_or_zero(blended(cone.direction, corners, barycentric))
    return ViewCone(direction, blended(cone.metric, corners, barycentric), (barycentric * cone.seen[corners]).sum(1))


def clamped_tangent(direction: Float[Array, "n 3"], cone: ViewCone) -> Float[Array, "n 3"]:
    """t' = v t / sqrt(1 + t^T Q t), t = d - (d . d_bar) d_bar: directions pulled into the cone that was seen."""
    axis = cone.direction
    tangent = direction - (direction * axis).sum(1, keepdims=True) * axis
    stretch = np.einsum("ni,nij,nj->n", tangent, matrix_from_six(cone.metric), tangent)
    return (cone.seen / np.sqrt(1 + np.maximum(stretch, 0)))[:, None] * tangent


def cone_direction(tangent: Float[Array, "n 3"], cone: ViewCone) -> Float[Array, "n 3"]:
    """The direction the teacher is asked at: d' = t' + d_bar sqrt(1 - |t'|^2), unit."""
    square = np.minimum((tangent**2).sum(1, keepdims=True), 1.0)
    return unit_or_zero(tangent + cone.direction * np.sqrt(1 - square))
