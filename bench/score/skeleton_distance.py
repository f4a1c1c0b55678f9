"""How far joints and poses of a skeleton are from the true one's, over frames of a video or of a set of poses."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle, nearest_rotation
from avatar.skeleton import JOINTS, LEFT_HAND, RIGHT_HAND, joint_transforms
from capture.held_out import HeldOutView

SIDES = ("left", "right")
LIMBS = [JOINTS.index(f"{side}_{name}") for side in SIDES
         for name in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")]  # fmt: skip
BODY = list(range(1, 22))
# a hand's joints, its wrist with them
HANDS = {f"hand_{side}": [JOINTS.index(f"{side}_wrist"), *range(52)[fingers]]
         for side, fingers in zip(SIDES, (LEFT_HAND, RIGHT_HAND))}  # fmt: skip


class PosedSkeletons(NamedTuple):
    """Two skeletons in the same frames, in one world."""

    ours: Float[Array, "frames 52 3"]
    true: Float[Array, "frames 52 3"]
    axis_angle: Float[Array, "frames 52 3"]
    true_axis_angle: Float[Array, "frames 52 3"]


def posed_skeletons(
    ours: Sequence[HeldOutView],
    true: Sequence[HeldOutView],
    joints: Float[Array, "52 3"],
    true_joints: Float[Array, "52 3"],
) -> PosedSkeletons:
    """Poses of the same frames; `joints` are those of each skeleton in pose 0."""
    place = lambda views, rest: np.stack([joint_transforms(v.axis_angle, rest, v.root)[:, :3, 3] for v in views])
    return PosedSkeletons(place(ours, joints), place(true, true_joints),
                          np.stack([v.axis_angle for v in ours]), np.stack([v.axis_angle for v in true]))  # fmt: skip


def joints_off(posed: PosedSkeletons, which: Sequence[int], *, aligned: bool) -> float:
    """Centimetres, mean; `aligned`: after the best rigid motion of these joints in each frame (Kabsch 1976)."""
    ours, true = posed.ours[:, which], posed.true[:, which]
    if aligned:
        a, b = ours - ours.mean(1, keepdims=True), true - true.mean(1, keepdims=True)
        ours = a @ np.swapaxes(nearest_rotation(np.swapaxes(b, 1, 2) @ a), 1, 2) + true.mean(1, keepdims=True)
    return 100 * float(np.linalg.norm(ours - true, axis=2).mean())


def turned_off(posed: PosedSkeletons, which: Sequence[int]) -> float:
    """Degrees, mean, by which joints are turned wrongly, each joint's own mean removed: what is the same in all frames
    is where a skeleton takes its rest pose to be."""
    turned, own = (matrix_from_axis_angle(a[:, which]) for a in (posed.true_axis_angle, posed.axis_angle))
    off = axis_angle_from_matrix(np.swapaxes(turned, -1, -2) @ own)
    return float(np.degrees(np.linalg.norm(off - off.mean(0), axis=-1)).mean())
