"""VolSDF's density: values, gradients, and the weights that come of it."""

import math

import pytest
import torch

from train.loss import color_norm_loss
from train.render import density_weights, laplace_density, section_lengths

BETAS = [1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6]


@pytest.mark.parametrize("beta", BETAS)
def test_the_density_is_the_laplace_distribution_of_the_depth(beta):
    s = torch.tensor([-10.0, -0.1, -2 * beta, -beta / 3, 0.0, beta / 3, 2 * beta, 0.1, 10.0], dtype=torch.double)
    expected = [(1 - 0.5 * math.exp(x / beta) if x <= 0 else 0.5 * math.exp(-x / beta)) / beta for x in s.tolist()]
    torch.testing.assert_close(laplace_density(s, beta), torch.tensor(expected, dtype=torch.double), rtol=1e-12, atol=0)
    s = s[2:7].requires_grad_()
    scaled = lambda x: laplace_density(x, beta) * beta
    assert torch.autograd.gradcheck(scaled, s, eps=1e-4 * beta, atol=1e-3 / beta, rtol=1e-3)


def test_a_ray_through_a_slab_keeps_the_light_of_the_integral():
    """Transmittance of a wall, depth by depth, against the integral of the density in closed form."""
    beta, count = 0.004, 4000
    depth = torch.linspace(-0.05, 0.05, count + 1, dtype=torch.double)
    lengths = (depth[1:] - depth[:-1])[None]
    rendered = density_weights(-(depth[:-1] + depth[1:])[None] / 2, lengths, beta)
    light = 1 - rendered.weights.cumsum(1)[0]
    x = depth[1:]
    # int sigma: e^{x/b}/2 in front of the wall, 1/2 + x/b + (e^{-x/b} - 1)/2 behind it
    optical = torch.where(x < 0, 0.5 * (x.clamp_max(0) / beta).exp(),
                          0.5 + x / beta + 0.5 * ((-x.clamp_min(0) / beta).exp() - 1))  # fmt: skip
    torch.testing.assert_close(light, (-optical).exp(), rtol=0, atol=1e-5)


def test_true_lengths_are_used_and_a_gap_in_the_band_is_not_fog():
    ends = torch.cumsum(torch.tensor([0.0, 0.01, 0.01, 0.3, 0.01, 0.01]), 0)
    lengths = section_lengths(torch.stack([ends, 0 * ends, 0 * ends], 1)[None])
    torch.testing.assert_close(lengths, torch.full((1, 5), 0.01))
    lengths = section_lengths(2 * torch.stack([0 * ends[:3], ends[:3], 0 * ends[:3]], 1)[None])
    torch.testing.assert_close(lengths, torch.full((1, 2), 0.02))


def test_the_colour_loss_as_printed_is_the_length_of_the_difference():
    shown = torch.tensor([[0.3, 0.0, 0.4], [0.5, 0.5, 0.5]], requires_grad=True)
    loss = color_norm_loss(shown, torch.tensor([[0.0, 0.0, 0.0], [0.5, 0.5, 0.5]]))
    assert float(loss.detach()) == pytest.approx(0.25, abs=1e-6)  # (0.5 + 0) / 2
    (gradient,) = torch.autograd.grad(loss, shown)
    torch.testing.assert_close(gradient, torch.tensor([[0.3, 0.0, 0.4], [0.0, 0.0, 0.0]]))
