"""The sRGB curve: what a byte of a picture means in linear light (IEC 61966-2-1)."""

import numpy as np
from jaxtyping import Float

Array = np.ndarray


def linear_from_srgb(shown: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Linear light, 0 to 1, of sRGB values 0 to 1; negative values are taken for 0."""
    shown = np.maximum(shown, 0)
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(linear: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """sRGB values of linear light, the inverse of `linear_from_srgb`; what is over 1 stays over 1."""
    linear = np.maximum(linear, 0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
