"""What a face does in a film of it: how far its own shapes go beside the built-in ones.

A point of the face lies in a frame at pi(R (x + b + sum_s a_s d_s) + t): x its place on the template, b how far off
the detector always has it, d_s what shape s moves it by. Gauss and Newton: pose R, t of each frame and how
much a_s >= 0 of each shape it shows (Lawson and Hanson 1974; the pose's columns projected out), points weighed as Geman
and McClure (1985) do. The first pose is that of points which hardly move; b is the median over the frames, in most of
which each part of a face rests, freed of what moves, turns and scales all of it.

A shape's gain is what it shows while it is performed. Its offset is what of it is in b, drawn to 0, for most of b is a
detector's habit.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.ndimage import median_filter
from scipy.optimize import nnls

from avatar.body import builtin_body
from avatar.constant import constant
from avatar.face_template import builtin_face
from avatar.rotation import cross_matrix, matrix_from_axis_angle
from avatar.similarity import similarity_from_landmarks
from capture.fit.footage import SIGMA
from capture.fit.points import body_points
from capture.keypoints.record import FACE, Keypoints
from capture.own_face import FITTED, GAINS, NUMBERS
from capture.raw.glance import SURE
from command.errors import AssetError
from geometry.least_squares import robust_weight

# numbers of the points that are used: a jaw's slide along the outline, but for the chin; and of those that no shape of
# a film moves by 3 mm: bridge of the nose and its tip, below it, corners of the eyes
USED = (8, *range(17, 68))
STILL = np.isin(USED, (27, 28, 29, 30, 32, 33, 34, 36, 39, 42, 45))
# those between the lips, of the upper one and of the lower one
BETWEEN = ((61, 62, 63), (67, 66, 65))
# rounds of pose and shapes, steps of each; standard deviations from which on a point counts little
ROUNDS, STEPS, CUT = 4, (10, 3), 3.0
# metres from the camera at which a head is looked for first, and nearer than which none is; what a detector's points
# may be off on the mean
AWAY, NEAREST, ASTRAY = 0.6, 0.05, 0.02
# share of the points that a frame has, and frames that are needed
MOST, FEWEST = 0.6, 20
# seconds: weights are the median of so many, and a shape is shown for so long
STEADY, SHOWN = 0.25, 0.2
# a gain is so many times what nine frames of ten have beside the performance; less than that is none
CLEAR, FAINT = 2.5, 0.15
# standard deviations: a detector's habit, metres, and a rest's offset
HABIT, OFFSET = 0.003, 0.2


class FaceFit(NamedTuple):
    """A film's frames, those that show the face."""

    frames: Bool[Array, "all"]
    weights: Float[Array, "frames 10"]  # a column for each of FITTED
    # those of USED on the template, in the camera's frame (OpenCV), metres
    places: Float[Array, "frames points 3"]
    bias: Float[Array, "points 3"]  # in the head's frame, metres


class FaceGains(NamedTuple):
    gains: Float[Array, "10"]
    offsets: Float[Array, "10"]
    # for each of FITTED why its gain is 1; empty: it was found
    why: tuple[str, ...]
    # frames that show each
    shown: Bool[Array, "frames 10"]


@constant
def moving_points() -> dict[str, int]:
    """The free body's vertex at each point of a face; of the points between the lips each has its own lip's."""
    points = {name: int(body_points()[name].vertices[0]) for name in FACE}
    x = builtin_body("male").vertices[:, 0]
    for numbers, half in zip(BETWEEN, builtin_face().seam):
        for name in (FACE[number] for number in numbers):
            points[name] = int(half[np.abs(x[half] - x[points[name]]).argmin()])
    return points


@constant
def point_rows() -> list[int]:
    """The free body's vertices at the points USED."""
    return [moving_points()[FACE[number]] for number in USED]


def fit_face(
    vertices: Float[Array, "vertices 3"], keypoints: Keypoints, size: tuple[int, int], focal: float, name: str
) -> FaceFit:
    """Pose and shapes of each frame of the film `name`, of pictures of a `size`, for a template of the free body.

    Raises:
        AssetError: too few frames show the face.
    """
    seen = np.stack([keypoints.seen(FACE[number]) for number in USED], 1)
    sure = np.where(seen[..., 2] > SURE, seen[..., 2], 0.0)
    frames = (sure > 0).mean(1) > MOST
    if frames.sum() < FEWEST:
        raise AssetError(
            f"{name}: expected {FEWEST} frames or more that show the face from the front, with its 68 points; found "
            f"{int(frames.sum())} of {len(frames)}"
        )
    # directions, and what a detector's sigma is of them
    sigma = SIGMA * min(size) / 1080 / focal
    rays, sure = np.nan_to_num(seen[frames, :, :2] - 0.5 * np.array(size)) / focal, sure[frames]
    rows = point_rows()
    moves, rest = builtin_face().offsets[NUMBERS][:, rows].astype(np.float64), vertices[rows].astype(np.float64)
    bias, weights = np.zeros_like(rest), np.zeros((len(rays), len(FITTED)))
    R = np.tile(np.diag([1.0, -1.0, -1.0]), (len(rays), 1, 1))
    t = np.tile([0, 0, AWAY] - R[0] @ rest.mean(0), (len(rays), 1))
    placed = lambda offsets: np.einsum("fij,fkj->fki", R, rest + offsets) + t[:, None]
    for number in range(ROUNDS):
        begun = number > 0
        for _ in range(STEPS[begun]):
            local = placed(bias + np.tensordot(weights, moves, 1))
            depth = np.maximum(local[..., 2:], NEAREST)
            flat = lambda v: v[..., :2] - (local[..., :2] / depth)[..., None, :] * v[..., 2:]
            turns = cross_matrix(local - t[:, None])
            by_pose = flat(np.concatenate([turns, np.tile(np.eye(3), (*local.shape[:2], 1, 1))], 2))
            by_shape = flat(np.einsum("fij,skj->fksi", R, moves))
            equations = _Equations(by_pose, by_shape, rays * depth - local[..., :2], sigma * depth[..., 0])
            step, weights = equations.solved(sure if begun else np.where(STILL, sure, 0), weights, begun)
            R, t = matrix_from_axis_angle(step[:, :3]) @ R, t + step[:, 3:]
        # without the shapes: noise shows none of them below 0, and would drive it away
        local = placed(np.tile(bias, (len(rays), 1, 1)))
        left = np.einsum("fji,fkj->fki", R[:, :2], rays * local[..., 2:] - local[..., :2]) + bias
        known = (sure > 0).any(0)
        bias[known] = np.nanmedian(np.where(sure[:, known, None] > 0, left[:, known], np.nan), 0)
        off = float(np.sqrt(np.square(bias).sum(1).mean()))
        if not off < ASTRAY:
            raise AssetError(f"{name}: its keypoints lie {1e3 * off:.0f} mm off a face at rest; are they of this film?")
        # what all of a face is off is where the camera stands
        T = np.linalg.inv(similarity_from_landmarks(rest, rest + bias).transform)
        bias = (rest + bias) @ T[:3, :3].T + T[:3, 3] - rest
    return FaceFit(frames, weights, placed(np.tensordot(weights, moves, 1)), bias)


class _Equations(NamedTuple):
    """off = step by_pose + change by_shape in each frame, in the camera's plane, metres."""

    by_pose: Float[Array, "frames points 6 2"]
    by_shape: Float[Array, "frames points 10 2"]
    off: Float[Array, "frames points 2"]
    sigma: Float[Array, "frames points"]  # standard deviation of a point

    def solved(
        self, sure: Float[Array, "frames points"], weights: Float[Array, "frames 10"], begun: bool
    ) -> tuple[Float[Array, "frames 6"], Float[Array, "frames 10"]]:
        """The step of the pose, and the shapes' weights; before the fit has begun these stay, and all points count."""
        rows = lambda each: np.moveaxis(each, 2, 3).reshape(len(each), -1, each.shape[2])
        P, M, y, trust = rows(self.by_pose), rows(self.by_shape), self.off.reshape(len(self.off), -1, 1), sure
        y, weights = y + begun * (M @ weights[..., None]), weights.copy()
        for _ in range(3 if begun else 1):
            s = np.sqrt(np.repeat(trust, 2, axis=1))[..., None]
            A = s * P
            H = A.swapaxes(1, 2) @ A + 1e-9 * np.eye(6)
            by_step = lambda v: np.linalg.solve(H, A.swapaxes(1, 2) @ v)
            if begun:
                left = s * np.concatenate([M, y], 2)
                left -= A @ by_step(left)
                weights = np.stack([nnls(one[:, :-1], one[:, -1], maxiter=300)[0] for one in left])
            change = y - begun * (M @ weights[..., None])
            step = by_step(s * change)
            away = np.square((change - P @ step).reshape(self.off.shape)).sum(2)
            trust = sure * robust_weight(away / self.sigma**2, CUT)
        return step[..., 0], weights


def gains_of(fit: FaceFit, rate: float) -> FaceGains:
    """What a film of `rate` frames a second says of the shapes."""
    width = 2 * round(0.5 * STEADY * rate) + 1
    steady = median_filter(fit.weights, (width, 1), mode="nearest")
    shown = steady > np.maximum(0.5 * steady.max(0), 1e-6)
    gains, why = np.ones(len(FITTED)), []
    for s in range(len(FITTED)):
        on = shown[:, s]
        found, beside = float(np.median(fit.weights[on, s])) if on.any() else 0.0, steady[~on, s]
        if on.sum() < SHOWN * rate or found < max(CLEAR * float(np.quantile(np.r_[beside, 0.0], 0.9)), FAINT):
            why.append("not shown")
        elif not GAINS[0] <= found <= GAINS[1]:
            why.append(f"{found:.2f} times as far is not believed")
        else:
            gains[s] = found
            why.append("")
    moves = builtin_face().offsets[NUMBERS][:, point_rows(), :2].reshape(len(FITTED), -1).astype(np.float64)
    H = moves @ moves.T + np.eye(len(FITTED)) * (HABIT / OFFSET) ** 2
    return FaceGains(gains, np.linalg.solve(H, moves @ fit.bias[:, :2].ravel()), tuple(why), shown)
