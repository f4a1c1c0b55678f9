"""Volume rendering and losses: the weights stay weights, the gradients stay finite."""

import math

import numpy as np
import pytest
import torch

from train.field import unit_normals
from train.loss import color_loss, displacement_loss, eikonal_loss, mask_logit_loss, mask_loss
from train.render import LOGISTIC_PER_BETA, crossing, jittered, section_weights

BETAS = [1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6]


def _sections(kind: str) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    if kind == "through a wall":
        return torch.linspace(0.05, -0.05, 33).expand(4, -1).clone()
    if kind == "ten metres":
        return torch.tensor([[10.0, -10.0], [-10.0, 10.0], [10.0, 10.0], [-10.0, -10.0]])
    if kind == "equal":
        return torch.zeros(3, 5)
    if kind == "unsorted":
        return 0.1 * torch.randn(64, 17, generator=generator)
    assert kind == "one section"
    return torch.tensor([[0.01, -0.01], [0.0, 0.0]])


KINDS = ["through a wall", "ten metres", "equal", "unsorted", "one section"]


@pytest.mark.parametrize("beta", BETAS)
@pytest.mark.parametrize("kind", KINDS)
def test_weights_and_the_light_that_passes_sum_to_one(kind, beta):
    distance = _sections(kind).requires_grad_()
    rendered = section_weights(distance, beta)
    total = rendered.weights.sum(1) + rendered.log_transmittance.exp()
    torch.testing.assert_close(total, torch.ones_like(total), rtol=0, atol=1e-6)
    assert (rendered.weights >= 0).all() and (rendered.weights <= 1).all()
    assert (rendered.log_transmittance <= 0).all()
    (gradient,) = torch.autograd.grad(rendered.weights.square().sum() + rendered.log_transmittance.exp().sum(), distance)
    assert torch.isfinite(gradient).all()


@pytest.mark.parametrize("beta", BETAS)
@pytest.mark.parametrize("kind", KINDS)
def test_weights_equal_the_float64_products_of_neus(kind, beta):
    distance = _sections(kind)
    s = distance.double() / (LOGISTIC_PER_BETA * beta)
    log_phi = -torch.nn.functional.softplus(-s)
    alpha = 1 - (log_phi[:, 1:] - log_phi[:, :-1]).clamp_max(0).exp()
    before = torch.cumprod(torch.nn.functional.pad(1 - alpha, (1, 0), value=1.0), 1)[:, :-1]
    expected = before * alpha
    # float32 rounds s/b to 1e-7 of its size before it is subtracted
    bound = 1e-5 + 2e-7 * s.abs().clamp_max(50).max().item() * 4
    torch.testing.assert_close(section_weights(distance, beta).weights.double(), expected, rtol=0, atol=bound)


@pytest.mark.parametrize("beta", [1e-2, 1e-3, 1e-4])
def test_an_opaque_slab_is_seen_at_its_surface(beta):
    """A ray into the half space z < 0 has log transmittance log Phi(s_end) - log Phi(s_start), in closed form."""
    ends = torch.linspace(0.04, -0.03, 17)[None]
    rendered = section_weights(ends, beta)
    phi = lambda s: -math.log1p(math.exp(-s / (LOGISTIC_PER_BETA * beta)))
    assert rendered.log_transmittance.item() == pytest.approx(phi(-0.03) - phi(0.04), rel=1e-5)
    section = (0.04 + 0.03) / 16
    depth = (rendered.weights * 0.5 * (ends[:, 1:] + ends[:, :-1])).sum().item()
    assert abs(depth) < 0.5 * section + beta


def test_a_sphere_is_shaded_on_its_surface():
    """The shaded point of the heaviest section lies on the sphere, though sections are 5 mm long."""
    generator = torch.Generator().manual_seed(1)
    radius, target = 0.1, 0.06 * (torch.rand(200, 2, generator=generator) * 2 - 1)
    t = torch.linspace(-0.2, 0.0, 41)
    ends = torch.stack([target[:, :1].expand(-1, 41), target[:, 1:].expand(-1, 41), t.expand(200, -1)], -1)
    distance = ends.norm(dim=-1) - radius
    rendered = section_weights(distance, 1e-3)
    heaviest = rendered.weights.argmax(1)
    points = crossing(distance, ends)[torch.arange(200), heaviest]
    assert ((points.norm(dim=1) - radius).abs() < 2e-4).all()
    assert (rendered.weights.sum(1) > 0.999).all()


def test_a_ray_that_passes_or_starts_inside_is_finite():
    away = section_weights(torch.full((2, 9), 0.5), 1e-3)
    assert away.log_transmittance.abs().max() < 1e-6
    inside = section_weights(torch.full((2, 9), -0.5).requires_grad_(), 1e-3)
    assert torch.isfinite(inside.weights).all()


def test_closed_sections_let_all_light_through():
    open_ = torch.zeros(2, 8, dtype=torch.bool)
    rendered = section_weights(torch.linspace(0.1, -0.1, 9).expand(2, -1), 1e-3, open_)
    assert (rendered.weights == 0).all() and (rendered.log_transmittance == 0).all()


def test_crossing_and_jitter_stay_within_their_section():
    ends = torch.rand(5, 9, 3)
    for distance in (torch.zeros(5, 9), torch.randn(5, 9), torch.full((5, 9), 1e-30)):
        points = crossing(distance, ends)
        low, high = torch.minimum(ends[:, 1:], ends[:, :-1]), torch.maximum(ends[:, 1:], ends[:, :-1])
        assert ((points >= low - 1e-6) & (points <= high + 1e-6)).all()
    assert torch.equal(jittered(ends, torch.zeros(5)), ends[:, :-1])


@pytest.mark.parametrize("mask", [torch.zeros(6), torch.ones(6), torch.tensor([0.0, 1, 0, 1, 0, 1])])
@pytest.mark.parametrize("log_t", [0.0, -1e-8, -1e-3, -1.0, -30.0, -1e6])
def test_mask_loss_and_gradient_are_finite_whatever_the_opacity(log_t, mask):
    log_transmittance = torch.full((6,), log_t, requires_grad=True)
    loss = mask_loss(log_transmittance, mask)
    (gradient,) = torch.autograd.grad(loss, log_transmittance)
    assert torch.isfinite(loss) and torch.isfinite(gradient).all() and loss >= 0


@pytest.mark.parametrize("rho", [50.0, 1600.0])
@pytest.mark.parametrize("distance", [-5.0, -1e-4, 0.0, 1e-4, 5.0])
def test_mask_logit_loss_is_a_distance_in_metres_at_the_far_end(rho, distance):
    lowest = torch.full((4,), distance, requires_grad=True)
    wrong = torch.zeros(4) if distance < 0 else torch.ones(4)
    loss = mask_logit_loss(lowest, wrong, rho)
    (gradient,) = torch.autograd.grad(loss, lowest)
    assert torch.isfinite(gradient).all()
    # -log(1 - sigmoid(x)) lies between |x| and |x| + log 2
    assert abs(distance) <= loss.item() + 1e-6 <= abs(distance) + math.log(2) / rho + 2e-6


def test_vanishing_gradients_give_finite_normals_and_losses():
    zero = torch.zeros(3, 3, requires_grad=True)
    value = unit_normals(zero).sum() + eikonal_loss(zero) + displacement_loss(zero)
    (gradient,) = torch.autograd.grad(value, zero)
    assert torch.isfinite(value) and torch.isfinite(gradient).all()
    assert eikonal_loss(zero).item() == pytest.approx(1.0, abs=1e-5)
    torch.testing.assert_close(unit_normals(torch.tensor([[0.0, 3e4, 4e4]])), torch.tensor([[0.0, 0.6, 0.8]]))


def test_constant_images_have_zero_loss_and_gradient():
    shown = torch.full((7, 3), 0.25, requires_grad=True)
    loss = color_loss(shown, torch.full((7, 3), 0.25))
    (gradient,) = torch.autograd.grad(loss, shown)
    assert loss.item() == 0 and np.isfinite(gradient.numpy()).all()
