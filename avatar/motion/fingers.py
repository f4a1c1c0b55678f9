"""Fingers by curl and spread: flexion axes of the built-in hand, and the hand at rest.

Everything is described for the left side; the right side is its mirror image at x -> -x, under which an
axis-angle vector (x, y, z) becomes (x, -y, -z). In pose 0 the left arm points along +x, the palm down and the
thumb forward, hence finger flexion turns +x towards the palm (-y): about -z.
"""


import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.body import builtin_body
from avatar.constant import constant
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle, unit_or_zero
from avatar.skeleton import FINGERS, JOINTS

# radians of the three joints in a full curl
JOINT_SHARE = np.array([[1.2, 1.5, 0.9]] * 4 + [[0.55, 0.75, 1.1]])
# an axis-angle vector times this is its mirror image
MIRROR = np.array([1.0, -1, -1])
# curl of index, middle, pinky, ring, thumb (0 straight, 1 closed), spread (radians between neighbours)
HAND_RELAXED = np.array([0.24, 0.29, 0.36, 0.33, 0.18, -0.06])


@constant
def finger_axes() -> tuple[Array, Array]:
    """Flexion axis of each left finger joint (5, 3, 3) and the palm's normal, from the built-in hand."""
    at = dict(zip(JOINTS, builtin_body("male").joints, strict=True))
    along, across = at["left_middle1"] - at["left_wrist"], at["left_index1"] - at["left_pinky1"]
    palm = -unit_or_zero(np.cross(across, along))
    if palm[1] > 0:
        palm = -palm
    axes = np.zeros((5, 3, 3))
    for f, finger in enumerate(FINGERS):
        for n in range(3):
            first = min(n, 1) + 1
            bone, inward = unit_or_zero(at[f"left_{finger}{first + 1}"] - at[f"left_{finger}{first}"]), palm
            # the thumb closes over the palm towards the little finger
            if finger == "thumb":
                inward = unit_or_zero(at["left_pinky1"] + 0.045 * palm - at["left_thumb2"])
            axes[f, n] = unit_or_zero(np.cross(bone, inward - bone * (bone @ inward)))
    return axes, palm


def hand_pose(hand: Float[Array, "6"]) -> Float[Array, "15 3"]:
    """Axis-angle vectors of the left hand's fingers from curls and spread."""
    axes, palm = finger_axes()
    curl, spread = hand[:5], hand[5]
    pose = axes * (curl[:, None] * JOINT_SHARE)[:, :, None]
    # towards the thumb is positive
    for f, place in ((0, 1.0), (1, 0.0), (3, -1.0), (2, -2.1)):
        sideways = matrix_from_axis_angle(palm * place * spread)  # about the palm's normal: +x to +z
        pose[f, 0] = axis_angle_from_matrix(sideways @ matrix_from_axis_angle(pose[f, 0]))
    return pose.reshape(15, 3)


def relaxed_hands() -> Float[Array, "30 3"]:
    """Both hands at rest, fingers slightly bent: what `--hands relaxed` puts in place of the file's."""
    left = hand_pose(HAND_RELAXED)
    return np.concatenate([left, left * MIRROR])
