"""Positional encoding (Mildenhall et al. 2020)."""

from math import pi

import torch
from jaxtyping import Float
from torch import Tensor


def positional_encoding(x: Float[Tensor, "n c"], frequencies: int) -> Float[Tensor, "n d"]:
    """x, sin(2^k pi x), cos(2^k pi x) for k < frequencies: c (1 + 2 frequencies) numbers; x of order one."""
    scales = pi * 2.0 ** torch.arange(frequencies, device=x.device, dtype=x.dtype)
    angles = (x[:, None, :] * scales[:, None]).flatten(1)
    return torch.cat([x, angles.sin(), angles.cos()], -1)
