"""Linear blend skinning, its inverse, and the orthonormal rule for directions.

One rule everywhere (training, view statistics, baking, GLSL): x_posed = (sum_k w_k B_k) x_rest, and the inverse
map is the inverse of that one matrix (TotalSelfScan supplement, Eq. 1).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Integer
from numpy import ndarray as Array

from avatar.rotation import matrix_from_quaternion, quaternion_from_matrix

# |det| of a blended matrix under which its inverse is refused: B moves points by < 1/50 of volume
SINGULAR = 0.02


class SkinWeights(NamedTuple):
    """The four strongest bones of each point; the weights of a row sum to 1, unused slots are 0."""

    joints: Int[Array, "points 4"]
    weights: Float[Array, "points 4"]

    def of(self, points: Array) -> "SkinWeights":
        """Those of some points, by index or mask."""
        return SkinWeights(self.joints[points], self.weights[points])

    @property
    def heaviest(self) -> Integer[Array, "points"]:
        return np.take_along_axis(self.joints, self.weights.argmax(1)[:, None], 1)[:, 0]


def strongest_four(dense: Float[Array, "points bones"]) -> SkinWeights:
    """The four largest weights of each row, largest first, scaled to sum to 1.

    Raises:
        ValueError: a row is negative, not finite or sums to nothing: there is no bone to follow.
    """
    dense = np.asarray(dense, np.float64)
    if not np.isfinite(dense).all() or (dense < 0).any():
        row = int(np.argmax(~np.isfinite(dense).all(1) | (np.nan_to_num(dense) < 0).any(1)))
        raise ValueError(f"skin weights of point {row} are negative or not finite")
    order = np.argsort(-dense, axis=1, kind="stable")[:, :4]
    weights = np.take_along_axis(dense, order, 1)
    total = weights.sum(1, keepdims=True)
    if not (total > 1e-8).all():
        raise ValueError(f"skin weights of point {int(np.argmin(total))} sum to {float(total.min()):.3g}, expected 1")
    return SkinWeights(order, (weights / total).astype(np.float32))


def dense_weights(skin: SkinWeights, bones: int = 52) -> Float[Array, "points bones"]:
    dense = np.zeros((len(skin.joints), bones))
    np.add.at(dense, (np.arange(len(dense))[:, None], skin.joints), skin.weights)
    return dense


def blended_transforms(skin: SkinWeights, transforms: Float[Array, "bones 4 4"]) -> Float[Array, "points 4 4"]:
    """sum_k w_k B_k for each point."""
    joints, weights = skin
    # float32 weights sum to 1 within 6e-8: half a millimetre of noise with a root 10 km away
    weights = weights.astype(np.float64)
    weights = weights / weights.sum(1, keepdims=True)
    rows = np.ascontiguousarray(transforms, np.float64).reshape(len(transforms), 16)
    out = rows[joints[:, 0]] * weights[:, 0:1]
    for slot in range(1, joints.shape[1]):
        out += rows[joints[:, slot]] * weights[:, slot : slot + 1]
    return out.reshape(-1, 4, 4)


def skin_points(
    points: Float[Array, "points 3"], skin: SkinWeights, transforms: Float[Array, "bones 4 4"]
) -> Float[Array, "points 3"]:
    """Points of the rest pose, posed: (sum_k w_k B_k) x."""
    M = blended_transforms(skin, transforms)
    return (M[:, :3, :3] @ np.asarray(points, np.float64)[:, :, None])[:, :, 0] + M[:, :3, 3]


def unskin_points(
    points: Float[Array, "points 3"], skin: SkinWeights, transforms: Float[Array, "bones 4 4"]
) -> tuple[Float[Array, "points 3"], Bool[Array, "points"]]:
    """Posed points, back in the rest pose: (sum_k w_k B_k)^-1 x, and whether that inverse exists.

    Bones blended half and half across a half turn flatten space (det = 0). Where |det| < SINGULAR the flag is
    false and the point comes back unchanged, so that nothing downstream sees an infinity.
    """
    M = blended_transforms(skin, transforms)
    A = M[:, :3, :3]
    ok = np.abs(np.linalg.det(A)) > SINGULAR
    inverse = np.linalg.inv(np.where(ok[:, None, None], A, np.eye(3)))
    points = np.asarray(points, np.float64)
    moved = (inverse @ (points - M[:, :3, 3])[:, :, None])[:, :, 0]
    return np.where(ok[:, None], moved, points), ok


def blended_rotations(skin: SkinWeights, transforms: Float[Array, "bones 4 4"]) -> Float[Array, "points 3 3"]:
    """Orthonormal posed_from_rest rotation of each point: the rule for directions and frames.

        q = normalise(sum_k w_k s_k q_k)    with s_k = +-1 so that q_k lies in the hemisphere of the heaviest bone

    Unlike sum_k w_k R_k it keeps unit vectors unit, and unlike the heaviest bone's rotation alone it does not
    jump at every bone border; it jumps only where a heavy pair passes 180 degrees apart. d_rest = R^T d_posed.
    The blend cannot vanish: the heaviest term has weight >= 1/4 and no other term points away from it.
    """
    joints, weights = skin
    bones = quaternion_from_matrix(transforms[..., :3, :3])
    q = bones[joints]
    same_side = np.einsum("psc,pc->ps", q, bones[skin.heaviest]) >= 0
    signed = np.where(same_side, weights, -weights).astype(np.float64)
    return matrix_from_quaternion(np.einsum("ps,psc->pc", signed, q))


def skin_normals(
    normals: Float[Array, "points 3"], skin: SkinWeights, transforms: Float[Array, "bones 4 4"]
) -> Float[Array, "points 3"]:
    """Unit normals of the rest pose, posed through the orthonormal rule."""
    return (blended_rotations(skin, transforms) @ np.asarray(normals, np.float64)[:, :, None])[:, :, 0]
