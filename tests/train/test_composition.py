"""Eq. 9's weights, skin look-ups, template grids, encodings; the preset that learns nothing, as the videos show it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree
from tiny import TINY, tiny, tiny_training

from avatar.skeleton import PARTS
from avatar.skinning import SkinWeights, blended_rotations
from capture.folder import read_capture
from capture.light.seen_colors import seen_colors
from capture.template.parts import Box, Part
from capture.template.surface import SurfaceCloud
from command.errors import AssetError
from geometry.harmonic import fill_reached
from train.command import TrainOptions
from train.deform import canonical_directions, inverse_transforms
from train.fused import part_weight
from train.networks import ColorInputs
from train.networks.seen import SeenNetworks
from train.preset import HEAD, PREVIEW, shortened
from train.run import read_run
from train.skin import harmonic_fill
from train.template_grid import TemplateGrid, template_grid

BOX = Box(np.array([0.5, -0.3, -0.3]), np.array([1.5, 0.3, 0.3]))
HAND = Part("hand_left", BOX, BOX, 0.1)


def test_eq9_weight_rises_linearly_over_the_overlap_and_is_continuous_everywhere():
    x = torch.tensor([0.4, 0.5, 0.525, 0.55, 0.6, 0.9])
    points = torch.stack([x, torch.zeros(6), torch.zeros(6)], 1)
    expected = torch.tensor([0, 0, 0.25, 0.5, 1.0, 1.0])
    torch.testing.assert_close(part_weight(points, HAND), expected, rtol=0, atol=1e-6)
    points = torch.rand(20000, 3, generator=torch.Generator().manual_seed(0)) * 2 - 0.5
    step = 1e-3 * torch.randn(20000, 3, generator=torch.Generator().manual_seed(1)).clamp(-1, 1)
    jump = (part_weight(points + step, HAND) - part_weight(points, HAND)).abs()
    assert jump.max() <= 1e-3 / 0.1 + 1e-5


def _sphere_cloud() -> SurfaceCloud:
    d = np.random.default_rng(0).normal(size=(60000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    skin = SkinWeights(np.zeros((len(d), 4), int), np.tile(np.float32([1, 0, 0, 0]), (len(d), 1)))
    gap, area = np.full(len(d), 0.003), np.full(len(d), 0.04 * np.pi / len(d))
    return SurfaceCloud(0.1 * d, d, skin, np.zeros(len(d), int), KDTree(0.1 * d), 0.003, gap, area)


def test_a_grid_of_a_sphere_is_its_distance_and_unseen_vertices_take_their_neighbours_color(tiny_capture):
    grid = template_grid(_sphere_cloud(), np.full(3, -0.15), np.full(3, 0.15), 0.005)
    points = 0.14 * (torch.rand(5000, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1)
    near = (points.norm(dim=1) - 0.1).abs() < 0.015
    exact = points.norm(dim=1) - 0.1
    assert (grid(points) - exact)[near].abs().max() < 5e-4
    assert (torch.sign(grid(points)) == torch.sign(exact))[exact.abs() > 1e-3].all()
    capture = read_capture(tiny_capture)
    for video in capture.videos.values():
        video.masks[:] = False
    assert (seen_colors(capture, {}) == 0.5).all()


def test_template_gradient_is_the_derivative_of_its_own_values():
    torch.manual_seed(0)
    grid = TemplateGrid(torch.randn(5, 6, 7), torch.tensor([-1.0, 0.0, 2.0]), 0.5)
    inside = torch.tensor([-1.0, 0.0, 2.0]) + torch.rand(300, 3) * 0.5 * torch.tensor([4.0, 5.0, 6.0])
    outside = inside + torch.tensor([5.0, 0.3, -4.0])
    for points, bound in ((inside, 1e-3), (outside, 2e-3)):  # at the border `sample` stops 1e-4 cells short
        points = points.clone().requires_grad_()
        value, gradient = grid.sample(points.detach())
        same = grid(points)
        torch.testing.assert_close(same, value, rtol=0, atol=bound)
        if bound == 1e-3:
            (auto,) = torch.autograd.grad(same.sum(), points)
            close = (auto - gradient).abs().amax(1) < 1e-2
            assert close.float().mean() > 0.98  # cells' faces have two derivatives


def test_canonical_directions_equal_the_numpy_rule():
    rng = np.random.default_rng(0)
    q = rng.normal(size=(52, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    from avatar.rotation import matrix_from_quaternion

    transforms = np.tile(np.eye(4), (52, 1, 1))
    transforms[:, :3, :3] = matrix_from_quaternion(q)
    weights = np.sort(rng.dirichlet(np.ones(4), 200), axis=1)[:, ::-1].astype(np.float32)
    skin = SkinWeights(rng.integers(0, 52, (200, 4)), weights)
    d = rng.normal(size=(200, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    expected = np.einsum("nij,ni->nj", blended_rotations(skin, transforms), d)
    found = canonical_directions(
        torch.tensor(d), torch.tensor(weights).double(), torch.tensor(q)[torch.tensor(skin.joints)]
    )
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-6)


def test_inverse_transforms_invert_and_flag_what_has_no_inverse():
    transforms = np.tile(np.eye(4), (52, 1, 1))
    transforms[1, :3, :3] = np.diag([-1.0, -1, 1])  # half a turn: blended half and half it flattens space
    transforms[0, :3, 3] = transforms[1, :3, 3] = [0.3, -0.2, 0.1]
    half = np.float32([0.5, 0.5, 0, 0])
    skin = SkinWeights(np.tile([0, 1, 2, 3], (2, 1)), np.stack([half, np.float32([0.9, 0.1, 0, 0])]))
    rows, ok = inverse_transforms(skin, transforms)
    assert ok.tolist() == [False, True] and np.isfinite(rows).all()
    M = 0.9 * transforms[0] + 0.1 * transforms[1]
    np.testing.assert_allclose(rows[1], np.linalg.inv(M)[:3], atol=1e-6)


def test_harmonic_fill_of_a_strip_is_linear_and_reaches_everything_connected():
    count = 11
    faces = np.array([[i, i + 1, i + 1] for i in range(count - 1)])
    joints = np.tile([3, 7, 0, 0], (count, 1))
    weights = np.zeros((count, 4), np.float32)
    weights[0, 0], weights[-1, 1], weights[1:-1, 0] = 1, 1, 1
    known = np.zeros(count, bool)
    known[[0, -1]] = True
    filled = harmonic_fill(SkinWeights(joints, weights), known, faces)
    share = np.where(filled.joints == 7, filled.weights, 0).sum(1)
    np.testing.assert_allclose(share, np.linspace(0, 1, count), atol=1e-6)
    faces = np.array([[0, 1, 2], [1, 2, 3], [4, 5, 6]])
    values = fill_reached(np.eye(7)[:, :1] * 5, np.arange(7) == 0, faces)
    np.testing.assert_allclose(values[:, 0], [5, 5, 5, 5, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize("count", [0, 1])
def test_lookups_of_nothing_are_nothing(count):
    grid = TemplateGrid(torch.zeros(3, 3, 3), torch.zeros(3), 0.1)
    assert grid(torch.zeros(count, 3)).shape == (count,)


SMALL = tiny(PREVIEW, networks=PREVIEW.parts[0].networks, iterations=0, light=False)


@pytest.fixture(scope="module")
def painted(tiny_capture, tmp_path_factory):
    return read_run(tiny_training(tiny_capture, tmp_path_factory.mktemp("painted") / "run", preset=SMALL))


@pytest.mark.slow
def test_a_preview_is_a_run_like_any_other_whose_surface_is_the_template(painted, tiny_capture):
    subject = read_capture(tiny_capture, parts=()).subject
    assert painted.preset.name == "preview" and set(painted.provenance["parts"]) == set(painted.preset.names)
    assert all(part["steps"] == 0 for part in painted.provenance["parts"].values())
    body = subject.vertices[subject.part == 0]
    distance = painted.field.distance(torch.as_tensor(body, dtype=torch.float32))
    assert distance.abs().median() < 0.002


@pytest.mark.slow
def test_a_run_like_another_has_its_template_and_light_and_other_numbers_are_refused(painted, tiny_capture, tmp_path):
    like = ["--like", str(painted.path), "--refine-poses", "off"]
    again = read_run(tiny_training(tiny_capture, tmp_path / "again", *like, preset=SMALL))
    assert again.lights == painted.lights and "hair carved" not in again.provenance["seconds"]
    for name in ("vertices", "faces", "hair"):
        np.testing.assert_array_equal(getattr(again.subject, name), getattr(painted.subject, name))
    with pytest.raises(AssetError, match=r"expected the same .* as here, its seed differs"):
        tiny_training(tiny_capture, tmp_path / "other", *like, "--seed", "7", preset=SMALL)
    with pytest.raises(AssetError, match="poses are refined before"):
        tiny_training(tiny_capture, tmp_path / "other", *like[:2], "--refine-poses", "on", preset=SMALL)


@pytest.mark.slow
def test_a_head_is_learned_beside_a_body_and_hands_that_are_not(painted, tiny_capture, tmp_path):
    preset = replace(SMALL, name="head", parts=(SMALL.parts[0], TINY.parts[1], *SMALL.parts[2:]))
    assert preset.learned == HEAD.learned == (1,) and not preset.meets
    assert [part.iterations for part in shortened(HEAD, 7).parts] == [0, 7, 0, 0]
    run = read_run(tiny_training(tiny_capture, tmp_path / "run", preset=preset))
    assert [run.provenance["parts"][name]["steps"] for name in PARTS] == [0, TINY.parts[1].iterations, 0, 0]
    assert run.bake_source.with_templates is not None and painted.bake_source.with_templates is None
    assert not (run.path / "body_stage1.pt").exists()
    # the body's field is the template's in both, the head's has moved
    points = torch.as_tensor(run.subject.vertices, dtype=torch.float32)
    moved = (run.field.distance(points) - painted.field.distance(points)).abs().numpy()
    body, head = (run.subject.part == PARTS.index(name) for name in ("body", "head"))
    assert np.median(moved[body]) < 1e-6 < 1e-4 < np.median(moved[head])


@pytest.mark.slow
def test_a_preview_shows_the_colors_of_the_videos(painted, tiny_capture):
    capture = read_capture(tiny_capture)
    colors = seen_colors(capture, {})
    assert np.isfinite(colors).all() and colors.min() >= 0 and colors.max() <= 1
    body = capture.subject.part == 0
    points = torch.as_tensor(capture.subject.vertices[body], dtype=torch.float32)
    shown = painted.field.color(points, torch.zeros_like(points) + torch.tensor([0.0, 0.0, -1.0]))
    video = capture.videos["body"]
    filmed = np.concatenate([image[mask] for image, mask in zip(video.images, video.masks)]) / 255
    assert np.abs(shown.mean(0).numpy() - filmed.mean(0)).max() < 0.1
    assert np.abs(shown.numpy() - colors[body]).mean() < 0.03


def test_of_people_fitted_here_the_heads_video_paints_nothing_under_the_chin(tiny_capture):
    made = read_capture(tiny_capture)
    made.videos["head"].images[:] = [0, 204, 0]
    here = replace(made, facts={**made.facts, "source": "video"})
    subject, chin = made.subject, made.chin
    low = (subject.part == PARTS.index("head")) & (subject.vertices[:, 1] < chin - 0.005)
    green = np.linalg.norm(seen_colors(made, {}) - [0, 0.8, 0], axis=1) < 0.02
    painted = np.linalg.norm(seen_colors(here, {}) - [0, 0.8, 0], axis=1) < 0.02
    # what neither video shows is filled from its neighbours
    assert (low & green).sum() > 100 and (low & painted).sum() < 0.3 * (low & green).sum()
    high = subject.vertices[:, 1] > chin + 0.02
    assert (painted & high).sum() > 0.9 * (green & high).sum() > 500


def test_a_color_grid_is_linear_between_its_nodes_and_a_preset_that_learns_nothing_takes_no_steps(tmp_path):
    color = SeenNetworks(cell=0.5).build(3, torch.tensor([1.0, 0.5, 0.5]), 0.01).color
    places = color.places()
    color.values.copy_(places.T.reshape(color.values.shape))
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    nothing = torch.zeros(50, 1)
    torch.testing.assert_close(color(ColorInputs(points, nothing, points, points, nothing)), points, rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match="--iterations: the preset preview learns nothing"):
        TrainOptions(capture=tmp_path, out=tmp_path / "run", preset="preview", iterations=10)
