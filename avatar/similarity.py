"""Similarities: the one that takes a set of points to another (Umeyama 1991), and small ones that refine others.

A small similarity has seven increments: turn (x, y, z), shift (x, y, z) and scale. Turn and scale are counted in metres
at `arm` metres from its centre, so that all unknowns are alike in size.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.rotation import affine, matrix_from_axis_angle


class Registration(NamedTuple):
    """A transform target_from_source and how well it fits."""

    transform: Float[Array, "4 4"]
    # metres, root mean square (landmarks) or median (surfaces)
    residual: float


def similarity_from_landmarks(source: Float[Array, "n 3"], target: Float[Array, "n 3"]) -> Registration:
    """Eq. 6 with scale: min |s R source + T - target|^2, R a proper rotation (Umeyama 1991).

    Raises:
        ValueError: fewer than 3 points, points on a line, a mirrored correspondence, or numbers that are not
            finite; the rotation would be undetermined or a reflection.
    """
    if len(source) < 3 or source.shape != target.shape:
        raise ValueError(f"landmarks: expected at least 3 pairs, found {len(source)} and {len(target)}")
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise ValueError("landmarks: a coordinate is not finite")
    middle_s, middle_t = source.mean(0), target.mean(0)
    a, b = source - middle_s, target - middle_t
    for name, points in (("source", a), ("target", b)):
        spread = np.linalg.svd(points, compute_uv=False)
        if not spread[0] > 0 or spread[1] < 1e-3 * spread[0]:
            raise ValueError(f"landmarks: the {name} points lie on a line; the rotation about it is undetermined")
    U, D, Vt = np.linalg.svd(b.T @ a)
    mirrored = np.linalg.det(U @ Vt) < 0
    if mirrored and D[2] > 0.05 * D[1]:
        raise ValueError("landmarks: source and target are mirror images; left and right may be exchanged")
    sign = np.array([1.0, 1.0, -1.0 if mirrored else 1.0])
    R = U @ np.diag(sign) @ Vt
    scale = float((D * sign).sum() / (a * a).sum())
    if not scale > 0:
        raise ValueError("landmarks: no positive scale fits the points")
    out = affine(scale * R, middle_t - scale * R @ middle_s)
    error = source @ out[:3, :3].T + out[:3, 3] - target
    return Registration(out, float(np.sqrt((error**2).sum(1).mean())))


def small_similarity(delta: Float[Array, "7"], centre: Float[Array, "3"], arm: float) -> Float[Array, "4 4"]:
    """Turn, shift and scale about `centre` of the increments delta."""
    A = matrix_from_axis_angle(delta[:3] / arm) * (1 + delta[6] / arm)
    return affine(A, centre - A @ centre + delta[3:6])


def similarity_rows(points: Float[Array, "n 3"], centre: Float[Array, "3"], arm: float) -> Float[Array, "n 3 7"]:
    """Derivative of points under `small_similarity` to its increments, at zero."""
    about = (points - centre) / arm
    D = np.zeros((len(points), 3, 7))
    for axis in range(3):
        D[:, :, axis] = np.cross(np.eye(3)[axis], about)
        D[:, axis, 3 + axis] = 1
    D[:, :, 6] = about
    return D
