"""Registration of surfaces: point-to-plane ICP from a good start (Eq. 5), rigid point-to-point ICP for measuring."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from avatar.rotation import matrix_from_axis_angle, nearest_rotation
from avatar.similarity import Registration, similarity_rows, small_similarity
from geometry.closest import TriangleIndex, closest_points

Array = np.ndarray


class Anchors(NamedTuple):
    """Pairs of points that a registration should keep together (Eq. 6's landmarks)."""

    source: Float[Array, "k 3"]
    target: Float[Array, "k 3"]
    spread: float  # metres, standard deviation of a coordinate


INDEPENDENT = (
    # a surface trained from pictures is off in patches: it says about as much as so many free points
    50
)


def refine_by_surfaces(
    source: Float[Array, "n 3"],
    target: Float[Array, "m 3"],
    target_normals: Float[Array, "m 3"],
    *,
    source_normals: Float[Array, "n 3"] | None = None,
    anchors: Anchors | None = None,
    reach: float = 0.02,
    steps: int = 40,
    most: float = 0.03,
) -> Registration:
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
            or the answer moves points by more than `most` metres: the start was wrong, or the units are.
    """
    for name, array in (("source", source), ("target", target), ("normal", target_normals)):
        if not np.isfinite(array).all():
            raise ValueError(f"head registration: a {name} is not finite")
    tree = KDTree(target)
    transform = np.eye(4)
    residual, moved_by = np.inf, np.inf
    for step in range(steps):
        moved = source @ transform[:3, :3].T + transform[:3, 3]
        gap, row = tree.query(moved, distance_upper_bound=reach * max(0.25, 1 - step / steps), workers=-1)
        near = np.isfinite(gap)
        row = np.where(near, row, 0)
        if source_normals is not None:
            turned = source_normals @ (transform[:3, :3] / np.cbrt(np.linalg.det(transform[:3, :3]))).T
            near &= (turned * target_normals[row]).sum(1) > 0.5
        if near.sum() < max(6, 0.1 * len(source)):
            share = near.mean() if len(near) else 0.0
            raise ValueError(
                f"head registration: {share:.0%} of the surface within {reach} m of the body's, under 10 %"
            )
        p, q, n = moved[near], target[row[near]], target_normals[row[near]]
        r = ((p - q) * n).sum(1)
        residual = float(np.median(np.abs(r)))
        w = 1 / np.maximum(np.abs(r) / max(residual, 1e-9), 1.0)
        if anchors is None:
            update, moved_by = _plane_step(p, n, r, w)
        else:
            update, moved_by = _anchored_step(p, n, r, w, residual, anchors, transform)
        transform = update @ transform
        if moved_by < 1e-9:
            break
    # a rotation hardly determined may swing by a few millimetres; that is no failure
    if moved_by > 5e-3:
        raise ValueError(f"head registration: the last of {steps} steps still moves by {moved_by:.4f} m")
    shift = np.linalg.norm(source @ transform[:3, :3].T + transform[:3, 3] - source, axis=1).max()
    if shift > most:
        raise ValueError(
            f"head registration: moves the head by {shift:.3f} m, more than {most}; is Eq. 6's start right?"
        )
    return Registration(transform, residual)


def _anchored_step(
    points: Float[Array, "k 3"], normals: Float[Array, "k 3"], r: Float[Array, "k"], w: Float[Array, "k"],
    residual: float, anchors: Anchors, transform: Float[Array, "4 4"],
) -> tuple[Float[Array, "4 4"], float]:  # fmt: skip
    """The small similarity that lowers the sum over surfaces and anchors the most, and how far it moves points."""
    centre = points.mean(0)
    size = max(float(np.abs(points - centre).max()), 1e-12)
    # spread of a surface point, from the median of |r|
    spread = max(1.48 * residual, 1e-4)
    w = w * (INDEPENDENT / w.sum() / spread**2)
    J = np.einsum("ni,nij->nj", normals, similarity_rows(points, centre, size))
    placed = anchors.source @ transform[:3, :3].T + transform[:3, 3]
    e = placed - anchors.target
    K = similarity_rows(placed, centre, size).reshape(-1, 7)
    H = (J.T * w) @ J + K.T @ K / anchors.spread**2
    g = (J.T * w) @ r + K.T @ e.ravel() / anchors.spread**2
    delta = -np.linalg.solve(H, g)
    return small_similarity(delta, centre, size), float(np.abs(delta).max())


def _plane_step(
    points: Float[Array, "k 3"], normals: Float[Array, "k 3"], r: Float[Array, "k"], w: Float[Array, "k"]
) -> tuple[Float[Array, "4 4"], float]:
    """The rigid motion that lowers sum w r^2 the most when linearised, and the metres by which it moves points."""
    # turning about the middle decouples rotation from translation
    centre = points.mean(0)
    J = np.concatenate([np.cross(points - centre, normals), normals], 1)
    size = max(float(np.abs(points - centre).max()), 1e-12)
    J[:, :3] /= size
    H, g = (J * w[:, None]).T @ J, (J * w[:, None]).T @ r
    values, vectors = np.linalg.eigh(H)
    usable = values > 1e-3 * values[-1]
    delta = -vectors[:, usable] @ ((vectors[:, usable].T @ g) / np.maximum(values[usable], 1e-300))
    R = matrix_from_axis_angle(delta[:3] / size)
    update = np.eye(4)
    update[:3, :3] = R
    update[:3, 3] = centre - R @ centre + delta[3:]
    return update, float(np.abs(delta).max())


def rigid_icp(source: Float[Array, "n 3"], target: TriangleIndex, *, rounds: int = 20) -> Float[Array, "4 4"]:
    """target_from_source by point-to-point ICP (Besl and McKay 1992); rigid, never a mirror."""
    target_from_source = np.eye(4)
    moved = np.asarray(source, np.float64)
    for _ in range(rounds):
        nearest = closest_points(moved, target).point
        middle, aim = moved.mean(0), nearest.mean(0)
        R = nearest_rotation((nearest - aim).T @ (moved - middle))
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = R, aim - R @ middle
        moved = moved @ R.T + step[:3, 3]
        target_from_source = step @ target_from_source
        # a hundredth of a millimetre
        if np.abs(step - np.eye(4)).max() < 1e-5:
            break
    return target_from_source
