"""Volume rendering and losses: the weights stay weights, the gradients stay finite."""

import mpmath
import numpy as np
import pytest
import torch

from train.field import unit_normals
from train.loss import color_loss, color_norm_loss, displacement_loss, eikonal_loss, mask_logit_loss, mask_loss
from train.render import (
    LOGISTIC_PER_BETA,
    Weights,
    accumulated,
    crossing,
    density_weights,
    jittered,
    laplace_density,
    section_lengths,
    section_weights,
)

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


def _neus(distance: torch.Tensor, beta: float) -> Weights:
    return section_weights(distance, beta)


def _volsdf(distance: torch.Tensor, beta: float) -> Weights:
    lengths = torch.full_like(distance, 0.005).detach()
    lengths[:, -1] = 0  # the last sample stands for nothing
    return density_weights(distance, lengths, beta)


DENSITIES = pytest.mark.parametrize("density", [_neus, _volsdf], ids=["neus", "volsdf"])


def everywhere(test):
    """Of both densities, with every width and all kinds of sections."""
    for name, values in (("beta", BETAS), ("kind", KINDS)):
        test = pytest.mark.parametrize(name, values)(test)
    return DENSITIES(test)


@everywhere
def test_weights_and_the_light_that_passes_sum_to_one(density, kind, beta, within):
    rendered = density(_sections(kind), beta)
    within(rendered.weights.sum(1) + rendered.log_transmittance.exp() - 1, 1e-6)
    assert (rendered.weights >= 0).all() and (rendered.weights <= 1).all()
    assert (rendered.log_transmittance <= 0).all()
    left = 1 - torch.cumsum(rendered.weights.double(), 1)  # transmittance behind each section
    assert (left > -1e-6).all() and (left.diff(dim=1) <= 0).all()


@everywhere
def test_weights_equal_the_float64_products_of_their_paper(density, kind, beta, within):
    distance = _sections(kind)
    if density is _neus:
        s = distance.double() / (LOGISTIC_PER_BETA * beta)
        log_phi = -torch.nn.functional.softplus(-s)
        alpha = 1 - (log_phi[:, 1:] - log_phi[:, :-1]).clamp_max(0).exp()
        # float32 rounds s/b to 1e-7 of its size before it is subtracted
        bound = 1e-5 + 2e-7 * s.abs().clamp_max(50).max().item() * 4
    else:
        s = distance.double()
        laplace = torch.distributions.Laplace(torch.tensor(0.0).double(), torch.tensor(beta).double())
        sigma = laplace.cdf(-s) / beta
        alpha = 1 - (-0.005 * sigma).exp()
        alpha[:, -1] = 0
        bound = 2e-5
    before = torch.cumprod(torch.nn.functional.pad(1 - alpha, (1, 0), value=1.0), 1)[:, :-1]
    within(density(distance, beta).weights.double() - before * alpha, bound)


@everywhere
def test_gradients_of_weights_are_finite_and_those_of_float64(density, kind, beta, within):
    """Against the same formula in float64, whose own gradient gradcheck confirms below."""
    pull = torch.linspace(1, 2, _sections(kind).shape[1] - (density is _neus))
    gradients = []
    for dtype in (torch.float32, torch.float64):
        distance = _sections(kind).to(dtype).requires_grad_()
        rendered = density(distance, beta)
        value = (rendered.weights * pull.to(dtype)).sum() + rendered.log_transmittance.clamp_min(-20).exp().sum()
        (gradient,) = torch.autograd.grad(value, distance)
        assert torch.isfinite(gradient).all()
        gradients.append(gradient.double() * beta)  # a slope of the weights is of the order 1/beta
    within(gradients[0] - gradients[1], 1e-3, "of the steepest slope, 1/beta")


@DENSITIES
@pytest.mark.parametrize("beta", [1e-1, 1e-2, 1e-3])
def test_the_gradient_is_the_slope_of_the_value(density, beta):
    distance = (_sections("unsorted")[:6].double() * beta * 10).requires_grad_()
    value = lambda scaled: density(scaled * beta, beta).weights
    assert torch.autograd.gradcheck(value, (distance.detach() / beta).requires_grad_(), eps=1e-6, atol=1e-5)


@DENSITIES
@pytest.mark.parametrize("beta", BETAS)
def test_a_single_sample_and_none(density, beta):
    for distance in (torch.tensor([[0.0]]), torch.tensor([[-10.0]]), torch.zeros(0, 4)):
        rendered = density(distance, beta)
        assert rendered.weights.shape == (len(distance), distance.shape[1] - (density is _neus))
        if density is _volsdf or len(distance) == 0:
            assert (rendered.weights == 0).all() and (rendered.log_transmittance == 0).all()


@pytest.mark.parametrize("beta", BETAS)
@pytest.mark.parametrize("s", [-10.0, -1e-3, -1e-30, 0.0, 1e-30, 1e-3, 10.0])
def test_both_branches_of_the_density_are_finite_on_either_side(s, beta, within):
    distance = torch.full((3,), s, requires_grad=True)
    width = torch.tensor(beta, requires_grad=True)
    sigma = laplace_density(distance, width)
    by_distance, by_width = torch.autograd.grad(sigma.sum(), [distance, width])
    assert torch.isfinite(by_distance).all() and torch.isfinite(by_width)
    x = -abs(np.float64(np.float32(s))) / np.float64(np.float32(beta))
    expected = (1 - 0.5 * np.exp(x) if s <= 0 else 0.5 * np.exp(x)) / beta
    within((sigma.detach().double().numpy() - expected) * beta, 1e-6, "of 1/beta")
    within((by_distance.double().numpy() + 0.5 * np.exp(x) / beta**2) * beta**2, 1e-6, "of 1/beta^2")


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


@DENSITIES
def test_a_ray_that_passes_or_starts_inside(density, within):
    within(density(torch.full((2, 9), 0.5), 1e-3).log_transmittance, 1e-6)
    inside = torch.full((2, 9), -0.5, requires_grad=True)
    rendered = density(inside, 1e-3)
    (gradient,) = torch.autograd.grad(rendered.weights.sum(), inside)
    assert torch.isfinite(rendered.weights).all() and torch.isfinite(gradient).all()


def test_sections_of_no_length_stop_nothing_and_have_finite_gradients():
    ends = torch.rand(4, 7, 3)
    ends[:, 3] = ends[:, 2]
    ends[1] = ends[1, :1]  # a ray of no length
    ends.requires_grad_()
    rendered = density_weights(torch.full((4, 6), -0.01), section_lengths(ends), 1e-3)
    assert (rendered.weights[:, 2] == 0).all() and rendered.log_transmittance[1] == 0
    shaded = crossing(torch.zeros(4, 7), ends)
    (gradient,) = torch.autograd.grad(rendered.weights.sum() + shaded.sum(), ends)
    assert torch.isfinite(gradient).all()


def test_rays_with_all_samples_culled_let_all_light_through_and_pull_at_nothing():
    open_ = torch.zeros(2, 8, dtype=torch.bool)
    passed = torch.linspace(-0.1, -2, 8).repeat(2, 1).requires_grad_()
    rendered = accumulated(torch.where(open_, passed, 0.0))
    assert (rendered.weights == 0).all() and (rendered.log_transmittance == 0).all()
    loss = mask_loss(rendered.log_transmittance, torch.tensor([0.0, 1.0])) + rendered.weights.square().sum()
    (gradient,) = torch.autograd.grad(loss, passed)
    assert torch.isfinite(loss) and (gradient == 0).all()


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


@pytest.mark.parametrize("rho", [50.0, 400.0, 1600.0])
@pytest.mark.parametrize("distance", [-10.0, -0.3, -1e-4, 0.0, 1e-4, 0.3, 10.0])
@pytest.mark.parametrize("seen", [0.0, 1.0])
def test_mask_loss_of_metres_at_any_rho_is_that_of_sixty_digits(rho, distance, seen, within):
    lowest = torch.full((4,), distance, requires_grad=True)
    loss = mask_logit_loss(lowest, torch.full((4,), seen), rho)
    (gradient,) = torch.autograd.grad(loss, lowest)
    with mpmath.workdps(60):
        x = -mpmath.mpf(rho) * mpmath.mpf(float(np.float32(distance)))
        p = 1 / (1 + mpmath.exp(-x))
        expected = -mpmath.log(p if seen else 1 / (1 + mpmath.exp(x))) / rho
        slope = float(seen - p)
    within(loss.item() - float(expected), 1e-6 * max(1, abs(distance)), "m")
    within(4 * gradient - slope, 1e-6, "slope")


def test_vanishing_gradients_give_finite_normals_and_losses():
    zero = torch.zeros(3, 3, requires_grad=True)
    value = unit_normals(zero).sum() + eikonal_loss(zero) + displacement_loss(zero)
    (gradient,) = torch.autograd.grad(value, zero)
    assert torch.isfinite(value) and torch.isfinite(gradient).all()
    assert eikonal_loss(zero).item() == pytest.approx(1.0, abs=1e-5)
    torch.testing.assert_close(unit_normals(torch.tensor([[0.0, 3e4, 4e4]])), torch.tensor([[0.0, 0.6, 0.8]]))


@pytest.mark.parametrize("loss", [color_loss, color_norm_loss])
@pytest.mark.parametrize("level", [0.0, 0.25, 1.0])
def test_constant_images_have_no_loss_and_finite_gradients(loss, level, within):
    shown = torch.full((7, 3), level, requires_grad=True)
    value = loss(shown, torch.full((7, 3), level))
    (gradient,) = torch.autograd.grad(value, shown)
    within(value.item(), 1e-6)
    assert torch.isfinite(gradient).all()


def test_a_width_that_is_almost_nothing_and_a_ray_deep_in_the_body_stay_bounded():
    weights, left = section_weights(torch.tensor([[10.0, 5.0, -5.0, -10.0]]), 1e-39)
    assert torch.isfinite(weights).all() and torch.isfinite(left).all()
    # a stray ray counts as wrong, not as a cliff
    assert mask_loss(torch.tensor([-1000.0]), torch.tensor([0.0])) == 20
