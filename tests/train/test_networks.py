"""The networks of the three presets: the paper's layer by layer, the hash grid's derivatives, and that each learns."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from filmed_part import filmed_part, untrained
from torch import nn

from capture.folder import read_capture
from train import run as run_folder
from train.networks.hash import HashGrid, HashNetworks, take_rows
from train.networks.paper import PaperGeometry, PaperNetworks, SkipLayers, input_sizes
from train.networks.triplane import TriPlaneNetworks
from train.objective import Batch, choose_rays, losses, rho_at
from train.part_job import ray_settings
from train.prefit import fit_template
from train.preset import DEMO, FAST, PAPER, shortened
from train.rays import part_rays
from train.trainer import FieldTraining, grids_of, rate_at, train_field

HALF = torch.tensor([0.5, 1.0, 0.25])


def _layers(network: nn.Module) -> list[tuple[int, int]]:
    return [(m.in_features, m.out_features) for m in network.modules() if isinstance(m, nn.Linear)]


@pytest.fixture(scope="module")
def paper_networks():
    torch.manual_seed(0)
    return PaperNetworks().build(7, HALF, 0.05)


# --- paper: the supplement, section 1 ------------------------------------------------------------------------


def test_the_papers_three_networks_have_its_layers_inputs_and_codes(paper_networks):
    hidden = [(39, 256), *[(256, 256)] * 3, (256 + 39, 256), *[(256, 256)] * 3]
    assert _layers(paper_networks.geometry) == [*hidden, (256, 1 + 256)]
    x = torch.linspace(-0.1, 0.1, 5)
    trunk = paper_networks.geometry.trunk
    torch.testing.assert_close(trunk.activation(x), torch.log1p((100 * x).exp()) / 100)
    inputs = 39 + 27 + 3 + 256 + 128
    hidden = [(inputs, 256), (256, 256), (256 + inputs, 256), (256, 256)]
    assert _layers(paper_networks.color) == [*hidden, (256, 3)]
    assert paper_networks.color.trunk.activation is torch.nn.functional.relu
    assert paper_networks.appearance.weight.shape == (7, 128)
    inputs = 39 + 128
    hidden = [(inputs, 256), *[(256, 256)] * 3, (256 + inputs, 256), *[(256, 256)] * 3]
    assert _layers(paper_networks.displacement) == [*hidden, (256, 3)]
    assert paper_networks.displacement.trunk.activation is torch.nn.functional.relu
    assert paper_networks.displacement.code.weight.shape == (7, 128)


def test_the_middle_layer_sees_the_input_itself():
    """Cut the path through the first half: what comes out still depends on the input, by the skip alone."""
    torch.manual_seed(0)
    layers = [nn.Linear(size, 4) for size in input_sizes(3, 4, 4)]
    network = SkipLayers(layers, torch.tanh)
    nn.init.zeros_(layers[0].weight)
    x = torch.rand(5, 3, requires_grad=True)
    (gradient,) = torch.autograd.grad(network(x).square().sum(), x)
    assert (gradient != 0).any()
    nn.init.zeros_(layers[2].weight[:, 4:])
    (gradient,) = torch.autograd.grad(network(x).square().sum(), x, allow_unused=True)
    assert (gradient == 0).all()


def test_an_untrained_geometry_is_a_sphere_of_half_the_box(paper_networks):
    directions = torch.nn.functional.normalize(torch.randn(200, 3, generator=torch.Generator().manual_seed(1)), dim=1)
    with torch.no_grad():
        value = {r: paper_networks.geometry(r * directions / (HALF / HALF.max()))[0] for r in (0.25, 0.5, 1.0)}
    assert (value[0.25] < 0).all() and (value[1.0] > 0).all()
    # metres per metre (the longest half side is 1 m): 1 on average over the random weights, .2 about it
    slope = (value[1.0] - value[0.25]).mean() / 0.75
    assert abs(float(slope) - 1) < 0.5
    assert value[0.5].std() < 0.08


def test_the_paper_preset_holds_the_supplements_numbers():
    part = PAPER.parts[0]
    assert [p.iterations for p in PAPER.parts] == [100_000] * 4 and PAPER.appearance_steps == 15_000
    assert [p.displacement_weight for p in PAPER.parts] == [0.01, 0.01, 0.001, 0.001]
    assert PAPER.eikonal_weight == 0.1 and PAPER.mask_weight == 1.0
    assert PAPER.network_rate == PAPER.displacement_rate == PAPER.appearance_rate == 5e-4
    assert PAPER.network_rate * rate_at(0, part, PAPER) == pytest.approx(5e-4)
    assert PAPER.network_rate * rate_at(100_000, part, PAPER) == pytest.approx(5e-5)
    half_way = PAPER.network_rate * rate_at(50_000, part, PAPER)
    assert half_way == pytest.approx((5e-4 * 5e-5) ** 0.5)  # exponential
    assert (PAPER.rays, PAPER.sections) == (1024, 64) and PAPER.shaded == PAPER.sections
    assert [p.band.outside for p in PAPER.parts] == [0.1, 0.04, 0.1, 0.1]


def test_a_short_training_warms_up_for_a_tenth_of_its_steps_at_most():
    short = replace(DEMO.parts[0], iterations=200)
    at_full = [next(n for n in range(200) if rate_at(n, part, DEMO) >= DEMO.last_rate ** (n / part.iterations))
               for part in (short, replace(short, iterations=2000))]  # fmt: skip
    assert at_full == [19, DEMO.warm_up - 1] and rate_at(0, short, DEMO) == pytest.approx(1 / 20)


@pytest.mark.parametrize(
    "iteration, rho",
    [(0, 50), (9_999, 50), (10_000, 100), (20_000, 200), (49_999, 800), (50_000, 1600), (99_999, 1600)],
)
def test_rho_doubles_every_ten_thousand_steps_up_to_1600(iteration, rho):
    assert rho_at(iteration, PAPER.parts[0]) == rho


def test_a_shortened_preset_shortens_every_loop_and_a_paper_batch_is_of_one_frame_in_turn():
    short = shortened(PAPER, 20)
    assert [p.iterations for p in short.parts] == [20] * 4
    assert short.appearance_steps == short.union.iterations == 20 and short.prefit == 100
    assert shortened(PAPER, 10_000).prefit == PAPER.prefit
    assert shortened(DEMO, 10**6).appearance_steps == DEMO.appearance_steps
    counts = torch.tensor([5, 0, 9, 3])  # the second frame shows nobody
    frame_of_ray = torch.arange(4).repeat_interleave(counts)
    generator = torch.Generator().manual_seed(0)
    batches = [frame_of_ray[choose_rays(counts, PAPER, generator)] for _ in range(60)]
    assert all((batch == batch[0]).all() and len(batch) == 1024 for batch in batches)
    assert {int(batch[0]) for batch in batches} == {0, 2, 3}
    mixed = frame_of_ray[choose_rays(counts, DEMO, generator)]
    assert set(mixed.tolist()) == {0, 2, 3}


# --- fast: the hash grid -------------------------------------------------------------------------------------

TINY_HASH = HashNetworks(cell=0.05, levels=5, rows=512, coarsest=4, first_levels=2, width=16)


@pytest.fixture
def grid():
    torch.manual_seed(0)
    grid = HashGrid(TINY_HASH, HALF)
    nn.init.normal_(grid.table)
    grid.open_for(1.0)
    return grid.double()


def _reference(grid: HashGrid, unit: np.ndarray) -> np.ndarray:
    """The features of points, one corner at a time."""
    table, side = grid.table.detach().numpy(), (HALF / HALF.max()).numpy().astype(float)
    features = np.zeros((len(unit), len(grid.rows), table.shape[1]))
    for level, resolution in enumerate(grid.resolution.tolist()):
        points = np.ceil(side * resolution).astype(int) + 1
        rows = min(int(points.prod()), TINY_HASH.rows)
        first = int(grid.first_row[level])
        for n, place in enumerate((np.clip(unit, -1, 1) + 1) / 2 * side * resolution):
            low = np.minimum(np.floor(place).astype(int), points - 2)
            for corner in np.ndindex(2, 2, 2):
                at = [int(v) for v in low + corner]
                weight = np.prod(np.where(corner, place - low, 1 - (place - low)))
                if points.prod() <= TINY_HASH.rows:
                    row = at[0] + points[0] * (at[1] + points[1] * at[2])
                else:
                    row = (at[0] ^ (at[1] * 2654435761) ^ (at[2] * 805459861)) % rows
                features[n, level] += weight * table[first + row]
    return features.reshape(len(unit), -1)


def test_hash_features_equal_a_loop_over_corners_inside_on_the_border_and_beyond(grid):
    assert 0 < int(grid.plain.sum()) < len(grid.plain)  # both kinds of level are there
    unit = np.random.default_rng(0).uniform(-1, 1, (40, 3))
    unit[:8] = [[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    unit[8:12] = [[1.5, 0, 0], [0, -3, 0], [0, 0, 1 + 1e-6], [0, 0, 0]]
    features = grid(torch.tensor(unit)).detach().numpy()
    np.testing.assert_allclose(features, _reference(grid, unit), atol=1e-6)
    assert grid(torch.zeros(0, 3, dtype=torch.double)).shape == (0, features.shape[1])


def test_hash_derivatives_of_first_and_second_order_are_right(grid):
    points = torch.rand(3, 3, dtype=torch.double, generator=torch.Generator().manual_seed(2)) * 1.8 - 0.9
    points.requires_grad_()
    assert torch.autograd.gradcheck(grid, points, eps=1e-7, atol=1e-5)
    # the Eikonal term of a small network: its gradient to the table against finite differences
    mix = torch.randn(10, dtype=torch.double, generator=torch.Generator().manual_seed(3))

    def eikonal() -> torch.Tensor:
        (gradient,) = torch.autograd.grad((grid(points) @ mix).tanh().sum(), points, create_graph=True)
        return (gradient.norm(dim=1) - 1).square().sum()

    (analytic,) = torch.autograd.grad(eikonal(), grid.table)
    touched = analytic.abs().sum(1).nonzero()[:, 0]
    assert len(touched) > 50
    for row in touched[:: len(touched) // 12].tolist():
        step = torch.zeros_like(grid.table)
        step[row, 0] = 1e-6
        ends = []
        for sign in (1, -1):
            grid.table.data += sign * step
            ends.append(float(eikonal().detach()))
            grid.table.data -= sign * step
        assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(float(analytic[row, 0]), rel=1e-4, abs=1e-6)


def test_levels_open_coarse_first_by_forty_percent_of_the_steps_and_never_close():
    network = HashGrid(replace(TINY_HASH, levels=16, rows=64, first_levels=4), HALF)
    open_at = []
    for share in (0.0, 0.1, 0.2, 0.39, 0.4, 0.0):
        network.open_for(share)
        open_at.append(network.open)
    assert open_at == [4, 7, 10, 15, 16, 16]
    again = HashGrid(replace(TINY_HASH, levels=16, rows=64, first_levels=4), HALF)
    points = torch.rand(9, 3)
    closed = again(points)[:, 8:]
    assert closed.shape == (9, 24) and (closed == 0).all()
    again.load_state_dict(network.state_dict())
    assert again.open == 16 and torch.equal(again(points), network(points))


def test_finest_cells_are_two_millimetres_and_rows_taken_twice_add_their_gradients():
    for part, half in zip(FAST.parts, (1.0, 0.2, 0.15, 0.15)):
        assert isinstance(part.networks, HashNetworks)
        grid = HashGrid(replace(part.networks, rows=2**10), torch.full((3,), half))
        finest = 2 * half / float(grid.resolution[-1])
        assert finest == pytest.approx(part.networks.cell, rel=0.02)
        assert float(grid.resolution[0]) == 16
    generator = torch.Generator().manual_seed(0)
    table = torch.randn(6, 2, dtype=torch.double, generator=generator, requires_grad=True)
    index = torch.tensor([3, 3, 0, 5, 3])
    values = torch.randn(5, 2, dtype=torch.double, generator=generator)
    (ours,) = torch.autograd.grad((take_rows(table, index).sin() * values).sum(), table)
    (torchs,) = torch.autograd.grad((table[index].sin() * values).sum(), table)
    torch.testing.assert_close(ours, torchs)
    assert torch.autograd.gradgradcheck(lambda t: take_rows(t, index).sin(), table)


# --- all three: one interface, and they learn ----------------------------------------------------------------

SMALL = {
    "demo": replace(DEMO, rays=64, warm_up=5),
    "fast": replace(FAST, rays=64, warm_up=5, rays_per_frame=300, grid_rate=5e-3),
    "paper": replace(PAPER, rays=64, rays_per_frame=300, sections=24, shaded=24, network_rate=2e-3, warm_up=20),
}
SIZES = {
    "demo": TriPlaneNetworks(plane_size=16, color_size=16),
    "fast": HashNetworks(cell=0.004, levels=6, rows=2**12),
    "paper": PaperNetworks(width=48, feature=16, appearance=8, displacement=8),
}


@pytest.fixture(scope="module")
def hand(tiny_capture):
    capture = read_capture(tiny_capture)
    filmed = filmed_part(capture)

    def prepared(name):
        preset = SMALL[name]
        own = replace(preset.parts[2], iterations=60, networks=SIZES[name], cell=0.006, spacing=0.006)
        settings = replace(ray_settings(own, preset), per_frame=300)
        return preset, own, untrained(filmed, own, 4), part_rays(filmed, settings, np.random.default_rng(0)).rays

    prepared.subject = capture.subject
    return prepared


# 256 wide and 100k steps long in earnest, the paper's networks have only begun after 60 steps
@pytest.mark.parametrize(
    "name, left, gained", [("demo", 0.6, 3), ("fast", 0.6, 3), pytest.param("paper", 0.85, 0.5, marks=pytest.mark.slow)]
)
def test_each_preset_learns_the_painted_hand(hand, name, left, gained):
    preset, part, field, rays = hand(name)
    if not field.geometry.over_template:
        assert fit_template(field, 150, seed=0) < 0.008
    chosen, u = torch.arange(0, len(rays.ends), 3), torch.full((len(rays.ends[::3]),), 0.5)

    def now():
        loss, report = losses(field, rays, Batch(chosen, u, 0.002), part, preset)
        return float(loss.detach()), report()

    before, first = now()
    train_field(field, rays, FieldTraining(part=part, preset=preset, seed=3))
    after, last = now()
    assert after < left * before
    assert last.psnr > first.psnr + gained
    assert 0 < field.reference.abs().max() < 1


@pytest.mark.parametrize("name", ["demo", "fast", "paper"])
def test_normals_are_the_derivative_of_the_distance(hand, name):
    _, _, field, rays = hand(name)
    field = field.double()
    with torch.no_grad():
        for parameter in field.geometry.parameters():
            parameter += 0.02 * torch.randn(
                parameter.shape, dtype=torch.double, generator=torch.Generator().manual_seed(1)
            )
    points = rays.ends[:6, 5].double()
    _, gradient = field.with_gradient(points, create_graph=False)
    for axis in range(3):
        step = torch.zeros(3, dtype=torch.double)
        step[axis] = 1e-6
        with torch.no_grad():
            ahead, behind = (field.geometry(field.unit(points + step))[0], field.geometry(field.unit(points - step))[0])
        slope = (ahead - behind) / 2e-6
        if field.geometry.over_template:
            slope = slope + field.template.sample(points)[1][:, axis]
        torch.testing.assert_close(gradient[:, axis], slope, rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_rendering_by_density_teaches_displacement_and_width_and_the_fit_finds_the_hand(hand):
    preset, part, field, rays = hand("paper")
    loss, _ = losses(field, rays, Batch(torch.arange(64), torch.rand(64), 0.0), part, preset)
    loss.backward()
    assert isinstance(field.geometry, PaperGeometry)
    assert field.displacement.out.bias.grad.abs().max() > 0
    assert field.geometry.beta.grad is not None and field.geometry.beta.grad != 0
    assert all(torch.isfinite(p.grad).all() for p in field.parameters() if p.grad is not None)
    _, _, field, _ = hand("paper")
    points = field.low + torch.rand(2000, 3, generator=torch.Generator().manual_seed(7)) * (field.high - field.low)

    def off() -> float:
        with torch.no_grad():
            return float((field(points).distance - field.template(points)).abs().mean())

    sphere = off()
    fit_template(field, 200, seed=0)
    assert off() < 0.15 * sphere and off() < 0.006


def test_a_written_part_is_read_back_for_every_preset(hand, tmp_path):
    for name in ("demo", "fast", "paper"):
        _, part, field, rays = hand(name)
        for grid in grids_of(field):
            grid.open_for(0.2)
        run_folder.write_part(tmp_path / f"{name}.pt", field)
        again = run_folder.read_part(tmp_path / f"{name}.pt", hand.subject, 2, part)
        points = rays.ends[:20, 4]
        with torch.no_grad():
            assert torch.equal(again(points).distance, field(points).distance), name
