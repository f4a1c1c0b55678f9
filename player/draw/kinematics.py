"""Forward kinematics of one skeleton, frame by frame, in a third of the plain version's time.

avatar/skeleton.py says what is computed, avatar/rotation.py how each number stays exact; this says it again in few
NumPy calls, since at 52 joints a call costs more than its arithmetic (chain 94 us -> 35, quaternions 63 -> 16).
tests/player/test_posing.py holds the two together.
"""

import numpy as np
from jaxtyping import Float

from avatar.skeleton import DEPTHS, PARENTS


def _ancestors() -> list[np.ndarray]:
    """Each joint's 1st, 2nd, 4th and 8th ancestor; 52, which stands still, where there is none."""
    rounds = [np.append(np.where(PARENTS < 0, 52, PARENTS), 52)]
    while 2 ** len(rounds) <= len(DEPTHS):
        rounds.append(rounds[-1][rounds[-1]])
    return rounds


ANCESTORS = _ancestors()

# v @ CROSS is the matrix K with K u = v x u, row by row
CROSS = np.zeros((3, 9))
CROSS[[2, 1, 2, 0, 1, 0], [1, 2, 3, 5, 6, 7]] = [-1, 1, 1, -1, -1, 1]


def rotations(axis_angle: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """R = cos t I + a K + b v vᵀ, as avatar.rotation.matrix_from_axis_angle (K² = v vᵀ - t² I)."""
    v = axis_angle
    t2 = np.einsum("ij,ij->i", v, v)
    near_zero = t2 < 1e-4
    if near_zero.any():
        t = np.sqrt(np.where(near_zero, 1.0, t2))
        half_sine = np.sin(0.5 * t) / t
        a = np.where(near_zero, 1 - t2 * (1 / 6 - t2 / 120), np.sin(t) / t)
        b = np.where(near_zero, 0.5 - t2 * (1 / 24 - t2 / 720), 2 * half_sine * half_sine)
    else:
        t = np.sqrt(t2)
        half_sine = np.sin(0.5 * t) / t
        a, b = np.sin(t) / t, 2 * half_sine * half_sine
    out = (b[:, None] * v)[:, :, None] * v[:, None, :]
    flat = out.reshape(-1, 9)
    flat += (a[:, None] * v) @ CROSS
    flat[:, ::4] += (1 - b * t2)[:, None]
    return out


class Chain:
    """A skeleton whose joints rest at `joints`, metres."""

    def __init__(self, joints: Float[np.ndarray, "52 3"]):
        self.rest = np.zeros((53, 4, 4))
        self.rest[:] = np.eye(4)
        self.rest[1:52, :3, 3] = joints[1:] - joints[PARENTS[1:]]

    def transforms(
        self, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"], outer: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, "52 4 4"]:
        """outer_from_joint of each joint: `outer` times avatar.skeleton.joint_transforms, in double precision.

        By pointer jumping: after a round each joint holds the product over twice as many of its ancestors.
        """
        posed = self.rest.copy()
        posed[:52, :3, :3] = rotations(axis_angle)
        posed[0, :3, 3] = root
        posed[0] = outer @ posed[0]
        for ancestors in ANCESTORS:
            posed = posed.take(ancestors, 0) @ posed
        return posed[:52]


def _candidates() -> tuple[np.ndarray, np.ndarray]:
    """The four multiples 4 q_i q of Shepperd (1978) as a linear map of the nine entries of R, and its constant."""
    linear, constant = np.zeros((9, 16)), np.zeros(16)
    # 4 q_i q_i = 1 + R_ii - R_jj - R_kk
    for i in range(3):
        linear[[0, 4, 8], 5 * i] = [1 if i == j else -1 for j in range(3)]
    linear[[0, 4, 8], 15] = 1
    constant[[0, 5, 10, 15]] = 1
    # 4 q_i q_j = R_ij + R_ji
    for i, j in ((0, 1), (0, 2), (1, 2)):
        linear[[3 * i + j, 3 * j + i], 4 * i + j] = linear[[3 * i + j, 3 * j + i], 4 * j + i] = 1
    # 4 q_i w = R_jk - R_kj
    for i, (j, k) in enumerate(((2, 1), (0, 2), (1, 0))):
        linear[3 * j + k, [4 * i + 3, 12 + i]] = 1
        linear[3 * k + j, [4 * i + 3, 12 + i]] = -1
    return linear, constant


SHEPPERD, SHEPPERD_1 = _candidates()


def quaternions(rotations: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 4"]:
    """Unit quaternions, xyzw, w >= 0, of rotation matrices: avatar.rotation.quaternion_from_matrix."""
    count = len(rotations)
    candidates = rotations.reshape(count, 9) @ SHEPPERD + SHEPPERD_1
    best = candidates[:, ::5].argmax(1)
    q = candidates.reshape(count, 4, 4)[np.arange(count), best]
    q /= np.copysign(np.sqrt(np.einsum("ij,ij->i", q, q)), q[:, 3])[:, None]
    return q
