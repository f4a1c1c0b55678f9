"""The losses of TotalSelfScan, Eq. 10-12."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def color_loss(rendered: Float[Tensor, "rays 3"], observed: Float[Tensor, "rays 3"]) -> Float[Tensor, ""]:
    """L_rgb, Eq. 11, as the mean absolute difference: an outlier of a mask border does not outvote a texture."""
    return (rendered - observed).abs().mean()


def color_norm_loss(rendered: Float[Tensor, "rays 3"], observed: Float[Tensor, "rays 3"]) -> Float[Tensor, ""]:
    """L_rgb of Eq. 11 as printed: |C~ - C|_2 of each ray (not squared), the mean over rays for the sum."""
    return ((rendered - observed).square().sum(-1) + 1e-12).sqrt().mean()


def mask_loss(log_transmittance: Float[Tensor, "rays"], mask: Float[Tensor, "rays"]) -> Float[Tensor, ""]:
    """L_mask, Eq. 11: cross entropy of the rendered opacity, from its logarithm.

    -log(1 - opacity) is the negative log transmittance itself; it is capped at 20, so that a stray ray deep in
    the body counts as wrong and not as a cliff. log(opacity) has a floor of 1e-4 under the opacity.
    """
    missed = -(-torch.expm1(log_transmittance) + 1e-4).log()
    hit = -log_transmittance.clamp_min(-20)
    return torch.where(mask > 0.5, missed.clamp_min(0), hit).mean()


def mask_logit_loss(lowest: Float[Tensor, "rays"], mask: Float[Tensor, "rays"], rho: float) -> Float[Tensor, ""]:
    """L_mask of Eq. 11 as printed: BCE(sigmoid(-rho s), M) with s the lowest distance on the ray, from logits.

    Divided by rho, so that the gradient stays that of a distance while rho climbs.
    """
    return F.binary_cross_entropy_with_logits(-rho * lowest, mask) / rho


def eikonal_loss(gradient: Float[Tensor, "n 3"]) -> Float[Tensor, ""]:
    """L_E, Eq. 12: (|grad F_s| - 1)^2, with a finite gradient where grad F_s = 0."""
    return ((gradient.square().sum(-1) + 1e-12).sqrt() - 1).square().mean()


def displacement_loss(displacement: Float[Tensor, "n 3"]) -> Float[Tensor, ""]:
    """L_nr, Eq. 12: mean length of T_nr, in metres."""
    return (displacement.square().sum(-1) + 1e-12).sqrt().mean()
