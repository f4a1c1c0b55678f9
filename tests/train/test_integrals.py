"""Volume rendering of a slab and a sphere against the integrals it stands for.

    T(t) = exp(-int_0^t sigma(s(u)) du)      opacity = 1 - T(end)      depth = int t sigma T dt / opacity

VolSDF (Yariv et al. 2021): sigma(s) = Psi_b(-s) / b, whose integral along a straight distance is elementary.
NeuS (Wang et al. 2021): sigma = max(0, -d/dt log Phi_b(s(t))), so T is a ratio of two logistics, exactly.
"""

import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from train.loss import color_norm_loss
from train.render import LOGISTIC_PER_BETA, density_weights, section_lengths, section_weights

BETA = 0.004  # metres


def _psi(s: float) -> float:
    """VolSDF's density times b, at signed distance s."""
    return 1 - 0.5 * math.exp(s / BETA) if s <= 0 else 0.5 * math.exp(-s / BETA)


def _psi_integral(s: float) -> float:
    """int from s to infinity of Psi_b(-u) / b du, in closed form."""
    return 0.5 * math.exp(-s / BETA) if s >= 0 else -s / BETA + 0.5 * math.exp(s / BETA)


def _log_phi(s: float) -> float:
    return -math.log1p(math.exp(-s / (LOGISTIC_PER_BETA * BETA)))


def _volsdf(t: np.ndarray, distance: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    """Weights and total log transmittance of a ray along x, by the code under test."""
    ends = torch.zeros(1, len(t), 3, dtype=torch.double)
    ends[0, :, 0] = torch.tensor(t)
    s = torch.tensor(distance)[None, :-1]
    rendered = density_weights(s, section_lengths(ends), BETA)
    return rendered.weights[0], rendered.log_transmittance[0]


def _neus(t: np.ndarray, distance: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    rendered = section_weights(torch.tensor(distance)[None], BETA)
    return rendered.weights[0], rendered.log_transmittance[0]


def _depth(t: np.ndarray, weights: torch.Tensor) -> float:
    return float((weights * torch.tensor(0.5 * (t[1:] + t[:-1]))).sum() / weights.sum())


@pytest.mark.parametrize("tilt", [1.0, 0.7, 0.3])  # cosine of the ray with the slab's normal
@pytest.mark.parametrize("deep", [-0.02, 0.0, 0.004, 0.03])  # how far under the face the ray ends, metres
def test_volsdf_stops_the_light_of_the_closed_form_in_a_slab(tilt, deep):
    """s = -tilt t: the integral of the density along the ray is elementary; the left sums come near as 1/n."""
    begin, stop = -0.05 / tilt, deep / tilt
    expected = -(_psi_integral(-tilt * stop) - _psi_integral(-tilt * begin)) / tilt
    errors = []
    for count in (500, 1000):
        t = np.linspace(begin, stop, count + 1)
        _, log_t = _volsdf(t, -tilt * t)
        errors.append(abs(log_t.item() - expected))
    step = (stop - begin) / 500
    assert errors[0] <= 0.5 * step / BETA + 1e-9  # half a section of the densest
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.05, abs=1e-9)


@pytest.mark.parametrize("tilt", [1.0, 0.3])
def test_volsdf_sees_a_slab_at_the_depth_of_the_integral(tilt):
    T = lambda t: math.exp(-(_psi_integral(-tilt * t) - _psi_integral(0.05)) / tilt)
    begin, stop = -0.05 / tilt, 0.05 / tilt
    seen = lambda t: _psi(-tilt * t) / BETA * T(t)
    opacity = quad(seen, begin, stop, points=[0], epsabs=1e-12)[0]
    expected = quad(lambda t: t * seen(t), begin, stop, points=[0], epsabs=1e-12)[0] / opacity
    t = np.linspace(begin, stop, 4001)
    weights, log_t = _volsdf(t, -tilt * t)
    assert opacity == pytest.approx(-math.expm1(math.log(T(stop))), abs=1e-9)  # the two closed forms agree
    assert weights.sum().item() == pytest.approx(opacity, abs=2e-3)
    assert -math.expm1(log_t.item()) == pytest.approx(weights.sum().item(), abs=1e-12)
    assert _depth(t, weights) == pytest.approx(expected, abs=2 * (stop - begin) / 4000)


@pytest.mark.parametrize("count", [3, 17, 500])
@pytest.mark.parametrize("tilt", [1.0, 0.3])
def test_neus_in_a_slab_is_exact_at_any_number_of_sections(tilt, count):
    """The weights telescope: each is a difference of T(t) = Phi(s(t)) / Phi(s(0))."""
    t = np.linspace(-0.03, 0.02, count)
    weights, log_t = _neus(t, -tilt * t)
    T = np.exp([_log_phi(-tilt * x) - _log_phi(0.03 * tilt) for x in t])
    np.testing.assert_allclose(weights.numpy(), T[:-1] - T[1:], atol=1e-12)
    assert log_t.item() == pytest.approx(math.log(T[-1]), abs=1e-12)


def test_neus_sees_a_slab_at_the_depth_of_the_integral():
    """int T dt from the start is the mean depth behind it; of a logistic it is elementary and lies on the face."""
    t = np.linspace(-0.06, 0.06, 2001)
    weights, _ = _neus(t, -t)
    width = LOGISTIC_PER_BETA * BETA
    expected = -0.06 + width * (math.log1p(math.exp(0.06 / width)) - math.log1p(math.exp(-0.06 / width)))
    assert expected == pytest.approx(0, abs=1e-9)
    assert _depth(t, weights) == pytest.approx(expected, abs=1e-6)


RADIUS = 0.1


def _sphere(t: np.ndarray | float, miss: float) -> np.ndarray | float:
    """Signed distance along a ray that passes the centre at distance `miss`; t = 0 is nearest to it."""
    return np.sqrt(miss**2 + np.square(t)) - RADIUS


@pytest.mark.parametrize("miss", [0.0, 0.05, 0.09, 0.1, 0.103, 0.12])
def test_volsdf_of_a_sphere_is_the_integral_by_quadrature(miss):
    """Through the middle, grazing, and past it, where some light is lost although nothing is hit."""
    low = -0.16
    density = lambda t: _psi(float(_sphere(t, miss))) / BETA
    inner = math.sqrt(max(RADIUS**2 - miss**2, 0.0))
    stop = 0.16 if miss > 0.095 else -0.3 * inner  # deep inside all light is gone
    breaks = [x for x in (-inner, 0.0, inner) if low < x < stop]
    optical = quad(density, low, stop, points=breaks, limit=400, epsabs=1e-10)[0]
    t = np.linspace(low, stop, 8001)
    weights, log_t = _volsdf(t, np.asarray(_sphere(t, miss)))
    assert log_t.item() == pytest.approx(-optical, abs=2e-3 * max(1, optical))
    grid = np.linspace(low, stop, 40001)
    sigma = np.array([density(x) for x in grid])
    T = np.exp(-np.concatenate([[0], np.cumsum(0.5 * (sigma[1:] + sigma[:-1]) * np.diff(grid))]))
    depth = np.trapezoid(grid * sigma * T, grid) / np.trapezoid(sigma * T, grid)
    assert weights.sum().item() == pytest.approx(1 - T[-1], abs=2e-3)
    assert _depth(t, weights) == pytest.approx(depth, abs=1e-4)


@pytest.mark.parametrize("miss", [0.0, 0.05, 0.09, 0.1, 0.103, 0.12])
def test_neus_of_a_sphere_is_the_closed_form(miss):
    """Light is lost on the way in alone: T(end) = Phi(s_nearest) / Phi(s_start); depth by quadrature of T."""
    t = np.linspace(-0.16, 0.16, 3201)  # holds t = 0
    weights, log_t = _neus(t, np.asarray(_sphere(t, miss)))
    start, nearest = _log_phi(float(_sphere(-0.16, miss))), _log_phi(miss - RADIUS)
    assert log_t.item() == pytest.approx(nearest - start, rel=1e-12, abs=1e-12)
    T = lambda x: math.exp(_log_phi(float(_sphere(min(x, 0.0), miss))) - start)
    inner = math.sqrt(max(RADIUS**2 - miss**2, 0.0))
    area = quad(T, -0.16, 0, points=[-inner] if 0 < inner < 0.16 else None, limit=200, epsabs=1e-12)[0]
    opacity = -math.expm1(nearest - start)
    depth = (area - 0.16) / opacity if opacity > 0.01 else None
    assert weights.sum().item() == pytest.approx(opacity, abs=1e-12)
    if depth is not None:  # int t dT = t T | - int T dt; the light that passes leaves at t = 0
        assert _depth(t, weights) == pytest.approx(depth, abs=1e-6)


def test_true_lengths_are_used_and_the_colour_loss_as_printed_is_the_length_of_the_difference():
    ends = torch.cumsum(torch.tensor([0.0, 0.01, 0.01, 0.3, 0.01, 0.01]), 0)
    lengths = section_lengths(torch.stack([ends, 0 * ends, 0 * ends], 1)[None])
    torch.testing.assert_close(lengths, torch.full((1, 5), 0.01))
    lengths = section_lengths(2 * torch.stack([0 * ends[:3], ends[:3], 0 * ends[:3]], 1)[None])
    torch.testing.assert_close(lengths, torch.full((1, 2), 0.02))
    shown = torch.tensor([[0.3, 0.0, 0.4], [0.5, 0.5, 0.5]], requires_grad=True)
    loss = color_norm_loss(shown, torch.tensor([[0.0, 0.0, 0.0], [0.5, 0.5, 0.5]]))
    assert float(loss.detach()) == pytest.approx(0.25, abs=1e-6)  # (0.5 + 0) / 2
    (gradient,) = torch.autograd.grad(loss, shown)
    torch.testing.assert_close(gradient, torch.tensor([[0.3, 0.0, 0.4], [0.0, 0.0, 0.0]]))
