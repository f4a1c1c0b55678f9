"""Dual quaternion blending in double precision: what shaders/skinning_dual.glsl is tested against."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.rotation import matrix_from_quaternion, quaternion_from_matrix, quaternion_product
from avatar.skinning import SkinWeights


def skin_points_dual_quaternion(
    points: Float[Array, "points 3"], skin: SkinWeights, transforms: Float[Array, "bones 4 4"]
) -> Float[Array, "points 3"]:
    """Points posed by dual quaternion blending (Kavan et al. 2008): keeps volume where joints twist."""
    bones = dual_quaternion_from_transform(transforms)
    blended = blend_dual_quaternions(bones[skin.joints], skin.weights)
    M = transform_from_dual_quaternion(blended)
    return (M[:, :3, :3] @ np.asarray(points, np.float64)[:, :, None])[:, :, 0] + M[:, :3, 3]


def dual_quaternion_from_transform(transforms: Float[Array, "*b 4 4"]) -> Float[Array, "*b 2 4"]:
    """(real, dual) parts of rigid transforms: real = q, dual = t q / 2 with t the pure quaternion of translation."""
    real = quaternion_from_matrix(transforms[..., :3, :3])
    t = np.concatenate([transforms[..., :3, 3], np.zeros((*transforms.shape[:-2], 1))], -1)
    return np.stack([real, 0.5 * quaternion_product(t, real)], -2)


def transform_from_dual_quaternion(dual_quaternion: Float[Array, "*b 2 4"]) -> Float[Array, "*b 4 4"]:
    """Rigid transform of a dual quaternion with a non-zero real part; it need not be unit."""
    length = np.linalg.norm(dual_quaternion[..., 0, :], axis=-1, keepdims=True)
    real, dual = dual_quaternion[..., 0, :] / length, dual_quaternion[..., 1, :] / length
    out = np.zeros((*real.shape[:-1], 4, 4))
    out[..., :3, :3] = matrix_from_quaternion(real)
    out[..., :3, 3] = 2 * quaternion_product(dual, real * np.array([-1.0, -1, -1, 1]))[..., :3]
    out[..., 3, 3] = 1
    return out


def blend_dual_quaternions(
    bones: Float[Array, "points slots 2 4"], weights: Float[Array, "points slots"]
) -> Float[Array, "points 2 4"]:
    """Weighted sum with every bone first flipped into the hemisphere of the heaviest one.

    q and -q are the same rotation; against a fixed pivot (bone 0) a point without weight on it would blend
    across the sphere. With the heaviest as pivot the real part is never shorter than its weight.
    """
    pivot = np.take_along_axis(bones[..., 0, :], weights.argmax(-1)[:, None, None], 1)
    sign = np.where(np.sum(bones[..., 0, :] * pivot, -1) < 0, -1.0, 1.0)
    return np.einsum("ps,pscd->pcd", sign * weights, bones)
