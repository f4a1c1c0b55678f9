"""Registration of surfaces: point-to-plane ICP from a good start (Eq. 5), rigid point-to-point ICP for measuring."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.rotation import affine, nearest_rotation
from avatar.similarity import Registration, similarity_rows, small_similarity
from geometry.closest import TriangleIndex, closest_points
from geometry.least_squares import NormalEquations


class Anchors(NamedTuple):
    """Pairs of points that a registration should keep together (Eq. 6's landmarks)."""

    source: Float[Array, "k 3"]
    target: Float[Array, "k 3"]
    spread: float  # metres, standard deviation of a coordinate


# a surface trained from pictures is off in patches: it says about as much as so many free points
INDEPENDENT = 50
STEPS = 40
MOST = 0.03  # metres


def refine_by_surfaces(
    source: Float[Array, "n 3"], target: Float[Array, "m 3"], target_normals: Float[Array, "m 3"], *,
    source_normals: Float[Array, "n 3"] | None = None, anchors: Anchors | None = None, reach: float = 0.02,
) -> Registration:  # fmt: skip
    """Eq. 5: target_from_source by point-to-plane ICP, robust to surface that only one side has.

        min over R, T of sum w_i (n_i . (R p_i + T - q_i))^2       q_i the target point nearest to R p_i + T

    A pair is rejected when it is farther apart than `reach` (which shrinks to a quarter) or when its normals are
    more than 60 degrees apart; the others weigh by Huber's rule at the median residual. (Tukey's biweight, which
    drops the rest altogether, can drop a whole side and with it what holds the rotation.) A rotation that the
    surfaces do not determine (a sphere, a plane) is left at zero by truncating the system's small eigenvalues.

    With `anchors` the landmarks stay in the sum, each coordinate over its variance, the surfaces as INDEPENDENT
    points with the template's, and the scale, which Eq. 6 took from a few noisy landmarks, is solved too. Under long
    hair little of a head is left to hold the rotation: without them it turned by 2.7 degrees.

    Raises:
        ValueError: numbers are not finite, under a tenth of the points find a partner, the steps do not settle,
            or the answer moves points by more than MOST: the start was wrong, or the units are.
    """
    for name, array in (("source", source), ("target", target), ("normal", target_normals)):
        if not np.isfinite(array).all():
            raise ValueError(f"head registration: a {name} is not finite")
    tree = KDTree(target)
    transform, residual, moved_by = np.eye(4), np.inf, np.inf
    for step in range(STEPS):
        moved = source @ transform[:3, :3].T + transform[:3, 3]
        gap, row = tree.query(moved, distance_upper_bound=reach * max(0.25, 1 - step / STEPS), workers=-1)
        near = np.isfinite(gap)
        row = np.where(near, row, 0)
        if source_normals is not None:
            turned = source_normals @ (transform[:3, :3] / np.cbrt(np.linalg.det(transform[:3, :3]))).T
            near &= (turned * target_normals[row]).sum(1) > 0.5
        if near.sum() < max(6, 0.1 * len(source)):
            share = f"{near.sum() / max(len(near), 1):.0%} of the surface"
            raise ValueError(f"head registration: {share} within {reach} m of the body's, under 10 %")
        p, n = moved[near], target_normals[row[near]]
        r = ((p - target[row[near]]) * n).sum(1)
        residual = float(np.median(np.abs(r)))
        w = 1 / np.maximum(np.abs(r) / max(residual, 1e-9), 1.0)
        update, moved_by = _step(p, n, r, w, None if anchors is None else (anchors, transform))
        transform = update @ transform
        if moved_by < 1e-9:
            break
    # a rotation hardly determined may swing by a few millimetres; that is no failure
    if moved_by > 5e-3:
        raise ValueError(f"head registration: the last of {STEPS} steps still moves by {moved_by:.4f} m")
    shift = np.linalg.norm(source @ transform[:3, :3].T + transform[:3, 3] - source, axis=1).max()
    if shift > MOST:
        found = f"moves the head by {shift:.3f} m, more than {MOST}"
        raise ValueError(f"head registration: {found}; is Eq. 6's start right?")
    return Registration(transform, residual)


def _step(
    points: Float[Array, "k 3"], normals: Float[Array, "k 3"], r: Float[Array, "k"], w: Float[Array, "k"],
    anchored: tuple[Anchors, Float[Array, "4 4"]] | None,
) -> tuple[Float[Array, "4 4"], float]:  # fmt: skip
    """The motion that lowers the sum over surfaces the most when linearised, and the metres by which it moves points.

    It is rigid; with anchors, moved so far by the transform beside them, a similarity that lowers their sum as well.
    """
    # turning about the middle decouples rotation from translation
    centre = points.mean(0)
    size = max(float(np.abs(points - centre).max()), 1e-12)
    J = np.einsum("ni,nij->nj", normals, similarity_rows(points, centre, size))
    delta = np.zeros(7)
    if anchored is None:
        J = J[:, :6]
        values, vectors = np.linalg.eigh((J.T * w) @ J)
        usable = values > 1e-3 * values[-1]
        along = vectors[:, usable].T @ ((J.T * w) @ r)
        delta[:6] = -vectors[:, usable] @ (along / np.maximum(values[usable], 1e-300))
    else:
        anchors, transform = anchored
        # spread of a surface point, from the median of |r|
        spread = max(1.48 * float(np.median(np.abs(r))), 1e-4)
        placed = anchors.source @ transform[:3, :3].T + transform[:3, 3]
        K = similarity_rows(placed, centre, size).reshape(-1, 7)
        equations = NormalEquations(1, 7)
        equations.add(0, J, -r, w * (INDEPENDENT / w.sum() / spread**2))
        equations.add(0, K, (anchors.target - placed).ravel(), np.full(len(K), anchors.spread**-2.0))
        delta = equations.solve()[0][0]
    return small_similarity(delta, centre, size), float(np.abs(delta).max())


def rigid_icp(source: Float[Array, "n 3"], target: TriangleIndex, *, rounds: int = 20) -> Float[Array, "4 4"]:
    """target_from_source by point-to-point ICP (Besl and McKay 1992); rigid, never a mirror."""
    target_from_source = np.eye(4)
    moved = np.asarray(source, np.float64)
    for _ in range(rounds):
        nearest = closest_points(moved, target).point
        middle, aim = moved.mean(0), nearest.mean(0)
        R = nearest_rotation((nearest - aim).T @ (moved - middle))
        step = affine(R, aim - R @ middle)
        moved = moved @ R.T + step[:3, 3]
        target_from_source = step @ target_from_source
        # a hundredth of a millimetre
        if np.abs(step - np.eye(4)).max() < 1e-5:
            break
    return target_from_source
