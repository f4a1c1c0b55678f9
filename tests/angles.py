"""How far rotations are from each other."""

import numpy as np

from avatar.rotation import quaternion_from_axis_angle, quaternion_inverse, quaternion_product


def angles_between(a, b):
    """Radians between rotations given as axis-angle, 0 to pi; exact for small and for large ones."""
    relative = quaternion_product(quaternion_inverse(quaternion_from_axis_angle(a)), quaternion_from_axis_angle(b))
    return 2 * np.arctan2(np.linalg.norm(relative[..., :3], axis=-1), np.abs(relative[..., 3]))
