"""Unit vectors, and rotations made of two directions: what readers build bones' and palms' axes from."""

import numpy as np
from jaxtyping import Float

Array = np.ndarray


def unit_or_zero(v: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """Unit vectors; those without length stay 0."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(length > 0, length, 1)


def left_up_frame(left: Float[Array, "*b 3"], up: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Rotations with columns left, up, forward; up is kept, left made square to it."""
    up = unit_or_zero(up)
    left = unit_or_zero(left - up * np.sum(left * up, -1, keepdims=True))
    return np.stack([left, up, np.cross(left, up)], -1)


def palm_frame(along: Float[Array, "*b 3"], across: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Rotations with x from the wrist to the middle finger (`along`) and z towards the forefinger's side (`across`)."""
    x = unit_or_zero(along)
    z = unit_or_zero(across - x * np.sum(x * across, -1, keepdims=True))
    return np.stack([x, np.cross(z, x), z], -1)
