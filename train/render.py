"""Volume rendering of a signed distance field, in logarithms, with either of two densities.

NeuS (Wang et al. 2021), presets demo and fast; opaque where the surface is, at any width b:

    alpha_i = max(0, 1 - Phi(s_{i+1}/b) / Phi(s_i/b))        Phi the logistic function, s signed distance
    log(1 - alpha_i) = min(0, log Phi(s_{i+1}/b) - log Phi(s_i/b))

The logarithms are sums of softplus: no ratio of two numbers that both underflow, whatever b and s.

VolSDF (Yariv et al. 2021, Eq. 2 and 3), preset paper:

    sigma(x) = Psi_b(-s(x)) / b                                  Psi_b the cumulated Laplace distribution
    log(1 - alpha_i) = -sigma(x_i) |x_{i+1} - x_i|
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

# a logistic of scale .6 beta has about the width of VolSDF's Laplace density of scale beta (Yariv et al. 2021)
LOGISTIC_PER_BETA = 0.6


class Weights(NamedTuple):
    """What each section of a ray contributes."""

    weights: Float[Tensor, "rays sections"]
    # the whole ray's; opacity = 1 - exp of it
    log_transmittance: Float[Tensor, "rays"]


def section_weights(distance: Float[Tensor, "rays ends"], beta: float) -> Weights:
    """NeuS weights of the sections between consecutive ends.

    weights.sum() + exp(log_transmittance) = 1 by construction: each weight is a difference of transmittances.
    """
    scaled = distance / (LOGISTIC_PER_BETA * beta)
    # beyond 1e6 the logistic is saturated many times over; unclamped, 10 m over 1e-30 would be infinite
    log_phi = F.logsigmoid(scaled.clamp(-1e6, 1e6))
    return accumulated((log_phi[:, 1:] - log_phi[:, :-1]).clamp_max(0))


def laplace_density(distance: Float[Tensor, "*batch"], beta: float | Float[Tensor, ""]) -> Float[Tensor, "*batch"]:
    """sigma, VolSDF's density, per metre: 1/beta deep inside, 1/(2 beta) on the surface, 0 far outside.

    Each branch sees 0 on the other's side: `where` computes both, and an exponential that overflows where it is
    not wanted would turn the gradient into NaN.
    """
    above = distance > 0
    outside = 0.5 * (-torch.where(above, distance, 0.0) / beta).exp()
    inside = 1 - 0.5 * (torch.where(above, 0.0, distance) / beta).exp()
    return torch.where(above, outside, inside) / beta


def density_weights(
    distance: Float[Tensor, "rays samples"], lengths: Float[Tensor, "rays samples"], beta: float | Float[Tensor, ""]
) -> Weights:
    """VolSDF weights of samples, each standing for the section of length `lengths` metres that begins there.

    weights.sum() + exp(log_transmittance) = 1 by construction.
    """
    return accumulated(-laplace_density(distance, beta) * lengths)


def section_lengths(ends: Float[Tensor, "rays ends 3"]) -> Float[Tensor, "rays sections"]:
    """Lengths of the sections between consecutive ends, metres.

    The ends of a ray are evenly spaced but where it leaves the band round the template and comes back. A section
    across such a gap counts as long as the ray's median one: the gap is known to be empty.
    """
    lengths = (ends[:, 1:] - ends[:, :-1]).norm(dim=-1)
    median = lengths.median(1, keepdim=True).values
    return torch.where(lengths > 2 * median, median, lengths)


def accumulated(passed: Float[Tensor, "rays sections"]) -> Weights:
    """Weights from log(1 - alpha) of the sections: each is a difference of two transmittances."""
    log_t = torch.cumsum(passed, 1)
    before = F.pad(log_t[:, :-1], (1, 0))
    # a ray of one end has no section
    total = log_t[:, -1] if passed.shape[1] else passed.sum(1)
    return Weights(before.exp() * -torch.expm1(passed), total)


def crossing(
    distance: Float[Tensor, "rays ends"], ends: Float[Tensor, "rays ends 3"]
) -> Float[Tensor, "rays sections 3"]:
    """The point of each section that is shaded: where the distance, taken as linear, is zero; else its middle.

    Sections are several millimetres long, the color changes faster; at the crossing a wide section shows the
    same texel as a narrow one.
    """
    s0, s1 = distance[:, :-1], distance[:, 1:]
    enters = (s0 > 0) & (s1 <= 0)
    at = torch.where(enters, s0 / torch.where(enters, s0 - s1, 1.0), 0.5)
    return torch.lerp(ends[:, :-1], ends[:, 1:], at[..., None])


def jittered(ends: Float[Tensor, "rays ends 3"], u: Float[Tensor, "rays"]) -> Float[Tensor, "rays fewer 3"]:
    """One end fewer, each moved the share u of the way to its successor: the stratified jitter of cached ends."""
    return torch.lerp(ends[:, :-1], ends[:, 1:], u[:, None, None])
