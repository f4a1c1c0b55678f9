"""Volume rendering of a signed distance field (NeuS: Wang et al. 2021), in logarithms.

    alpha_i = max(0, 1 - Phi(s_{i+1}/b) / Phi(s_i/b))        Phi the logistic function, s signed distance
    log(1 - alpha_i) = min(0, log Phi(s_{i+1}/b) - log Phi(s_i/b))

The logarithms are sums of softplus: no ratio of two numbers that both underflow, whatever b and s.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

# a logistic of scale .6 beta has about the width of VolSDF's Laplace density of scale beta (Yariv et al. 2021)
LOGISTIC_PER_BETA = 0.6


class Weights(NamedTuple):
    """What each section of a ray contributes."""

    weights: Float[Tensor, "rays sections"]
    log_transmittance: Float[Tensor, "rays"]  # of the whole ray; opacity = 1 - exp of it


def section_weights(
    distance: Float[Tensor, "rays ends"], beta: float, open_: Bool[Tensor, "rays sections"] | None = None
) -> Weights:
    """NeuS weights of the sections between consecutive ends; sections that are not `open_` have opacity 0.

    weights.sum() + exp(log_transmittance) = 1 by construction: each weight is a difference of transmittances.
    """
    scaled = distance / (LOGISTIC_PER_BETA * beta)
    # beyond 1e6 the logistic is saturated many times over; unclamped, 10 m over 1e-30 would be infinite
    log_phi = F.logsigmoid(scaled.clamp(-1e6, 1e6))
    passed = (log_phi[:, 1:] - log_phi[:, :-1]).clamp_max(0)
    if open_ is not None:
        passed = torch.where(open_, passed, 0.0)
    log_t = torch.cumsum(passed, 1)
    before = F.pad(log_t[:, :-1], (1, 0))
    return Weights(before.exp() * -torch.expm1(passed), log_t[:, -1])


def crossing(
    distance: Float[Tensor, "rays ends"], ends: Float[Tensor, "rays ends 3"]
) -> Float[Tensor, "rays sections 3"]:
    """The point of each section that is shaded: where the distance, taken as linear, is zero; else its middle.

    Sections are several millimetres long, the colour changes faster; at the crossing a wide section shows the
    same texel as a narrow one.
    """
    s0, s1 = distance[:, :-1], distance[:, 1:]
    enters = (s0 > 0) & (s1 <= 0)
    at = torch.where(enters, s0 / torch.where(enters, s0 - s1, 1.0), 0.5)
    return torch.lerp(ends[:, :-1], ends[:, 1:], at[..., None])


def jittered(ends: Float[Tensor, "rays ends 3"], u: Float[Tensor, "rays"]) -> Float[Tensor, "rays fewer 3"]:
    """One end fewer, each moved the share u of the way to its successor: the stratified jitter of cached ends."""
    return torch.lerp(ends[:, :-1], ends[:, 1:], u[:, None, None])
