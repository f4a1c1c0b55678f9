"""VolSDF's density: values, gradients, and the weights that come of it."""

import pytest
import torch

from train.loss import color_norm_loss
from train.render import section_lengths


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
