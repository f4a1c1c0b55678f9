"""The network of a bake against linear fits, and frames that are moved onto the texture that they agree on."""

import numpy as np
import onnxruntime
import pytest
import torch
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.sparse import csr_matrix

from avatar.gltf.avatar_file import ViewNetwork
from bake.cone import ViewCone, six_from_matrix, tangent_frame
from bake.network import (
    AMPLITUDE,
    RATE,
    SurfacePoints,
    adam,
    choose,
    distil,
    fit_linear,
    linear_residual,
    network_inputs,
    network_residual,
    one_cycle,
    write_onnx,
)
from bake.texture.frame_alignment import FARTHEST, WINDOWS, ShownVideo, aligned_frames, frame_shift, moved_colors
from bake.texture.texture_solve import Equations


def ball_points(count=6000, spread=0.1, seen=1.0, seed=0):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    axes = np.stack(tangent_frame(-normals), 1)
    metric = np.einsum("nki,nkj->nij", axes, axes) / (1.6**2 * spread)
    cone = ViewCone(-normals, six_from_matrix(metric), np.full(count, seen))
    return SurfacePoints(0.3 * normals, normals, np.full((count, 3), 0.5), cone)


def gloss(points, directions):
    """Brighter towards grazing view: even in the tangent, which no linear residual can follow."""
    facing = (directions * points).sum(1, keepdims=True) / 0.3
    return 0.3 + 0.5 * (1 - facing**2) * [1.0, 0.9, 0.8]


def plain(points, directions):
    return 0.5 + 0.3 * np.sin(9 * points)


def test_a_network_wins_where_the_residual_is_curved_and_nothing_is_shipped_without_need():
    found = distil(gloss, ball_points(), steps=400)
    assert found.default_view == "network" and found.network is not None and found.linear is not None
    assert found.decibels["network"] > found.decibels["off"] + 6
    assert found.decibels["network"] >= found.decibels["linear"] + 0.3
    found = distil(plain, ball_points(), steps=10)
    assert (found.network, found.linear, found.features, found.default_view) == (None, None, None, "off")
    assert found.decibels["off"] == float("inf")
    assert distil(gloss, ball_points(seen=0.0), steps=10).default_view == "off"
    rng = np.random.default_rng(0)
    features, tangent, truth = rng.random((5000, 4)), rng.normal(size=(5000, 3)), rng.normal(size=(4, 3, 3))
    found = fit_linear(features, tangent, linear_residual(truth, features, tangent))
    np.testing.assert_allclose(found, truth, atol=1e-3)


def test_steps_of_adam_are_those_of_torch_and_the_rate_rises_once():
    wanted = torch.linspace(-1, 2, 7)
    values = [torch.zeros(7, requires_grad=True) for _ in range(2)]
    theirs, moments = torch.optim.Adam([values[1]], lr=RATE), [(torch.zeros(7), torch.zeros(7))]
    for step in range(40):
        losses = [((value - wanted) ** 2 * (1 + step % 3)).sum() for value in values]
        adam(values[:1], torch.autograd.grad(losses[0], values[:1]), moments, step, RATE)
        theirs.zero_grad()
        losses[1].backward()
        theirs.step()
    assert abs(values[0].detach()).max() > 0.1
    torch.testing.assert_close(*values, atol=1e-6, rtol=1e-5)
    rates = [one_cycle(at) for at in np.linspace(0, 1, 101)]
    assert np.argmax(rates) == 30 and max(rates) == pytest.approx(RATE) and rates[0] == RATE / 25 and rates[-1] == 0


@pytest.mark.parametrize(
    "off, linear, network, mode",
    [
        (30.0, 35.0, 35.29, "linear"),
        (30.0, 35.0, 35.31, "network"),
        (30.0, 30.2, 30.1, "off"),
        (30.0, 29.0, 36.0, "network"),
    ],
)
def test_simplest_mode_within_three_tenths_of_a_decibel_is_shipped(off, linear, network, mode):
    network_given = random_network()
    found = choose({"off": off, "linear": linear, "network": network}, network_given, np.zeros((4, 3, 3)), lambda s: s)
    assert found.default_view == mode
    assert (found.network is not None) == (mode == "network") and (found.linear is None) == (mode == "off")


def test_features_are_bytes_and_the_same_each_time():
    points = ball_points()
    one, two = (distil(gloss, points, steps=60, seed=3) for _ in range(2))
    assert one.features is not None and two.features is not None
    first = one.features(points)
    assert first.dtype == np.uint8 and first.shape == (6000, 4)
    np.testing.assert_array_equal(first, two.features(points))
    np.testing.assert_array_equal(one.network.w1, two.network.w1)


def random_network(scale=1.0, seed=0):
    rng = np.random.default_rng(seed)
    shapes = ((16, 8), (16,), (3, 16), (3,))
    return ViewNetwork(*(scale * rng.normal(size=s).astype(np.float32) for s in shapes))


@pytest.mark.parametrize("scale", [1e-4, 1.0, 30.0])
def test_onnx_runtime_agrees_with_the_reference(tmp_path, scale):
    network = random_network(scale)
    write_onnx(tmp_path / "n.onnx", network)
    rng = np.random.default_rng(1)
    features, tangent = rng.integers(0, 256, (2000, 4)) / 255, rng.normal(size=(2000, 3))
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1)
    x = network_inputs(features, tangent)
    y = onnxruntime.InferenceSession(tmp_path / "n.onnx").run(None, {"x": x.astype(np.float32)})[0]
    residual = AMPLITUDE * x[:, 7:8] * y / (1 + np.abs(y))
    np.testing.assert_allclose(residual, network_residual(network, features, tangent), atol=1e-4)


SIZE = 96
PIXEL = 0.005  # metres
WIDE, FAR = WINDOWS[0] / PIXEL, FARTHEST / PIXEL


def picture(seed, blur=1.5):
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(SIZE, SIZE, 3)), (blur, blur, 0))
    return np.clip(0.5 + 0.2 * noise / noise.std(), 0, 1)


def beside(image, shift):
    """The picture with what lay at x now at x + shift."""
    grid = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij"), -1) - shift
    return np.stack([map_coordinates(image[..., c], np.moveaxis(grid, -1, 0), order=1) for c in range(3)], -1)


def disc():
    rows, columns = np.mgrid[:SIZE, :SIZE] - SIZE / 2
    return np.hypot(rows, columns) < 40


def smooth_shift():
    """Two pixels, turning slowly over the picture."""
    angle = np.linspace(0, 1.5, SIZE)
    return np.stack([2 * np.sin(angle)[None].repeat(SIZE, 0), 2 * np.cos(angle)[None].repeat(SIZE, 0)], -1)


def test_a_smooth_shift_is_undone_and_a_single_picture_moves_no_farther_than_believed():
    drawn, known = picture(0), disc()
    frame = beside(drawn, smooth_shift())
    shift = frame_shift(drawn, frame, known, WIDE, FAR)
    inner = gaussian_filter(known.astype(float), 4) > 0.95
    assert np.abs(shift - smooth_shift())[inner].max() < 0.5
    assert np.abs(shift - smooth_shift())[inner].mean() < 0.1
    moved, whole = moved_colors(frame, known, shift)
    both = inner & whole
    assert np.abs(moved - drawn)[both].mean() < 0.25 * np.abs(frame - drawn)[both].mean()
    shift = frame_shift(picture(0), picture(7), disc(), WIDE, FAR)
    assert np.linalg.norm(shift, axis=-1).max() <= FAR + 1e-9
    nobody = frame_shift(picture(0), picture(7), np.zeros((SIZE, SIZE), bool), WIDE, FAR)
    assert (nobody == 0).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1)])
def test_a_frame_of_a_single_row_or_column_stays_where_it_is(shape):
    rows, columns = shape
    drawn, frame = (picture(seed)[:rows, :columns] for seed in (0, 7))
    assert (frame_shift(drawn, frame, np.ones(shape, bool), WIDE, FAR) == 0).all()


def test_what_slides_by_itself_is_moved_by_a_narrow_window_alone():
    """A disc of 9 pixels shows three pixels beside the rest."""
    drawn, away = picture(0), np.hypot(*(np.mgrid[:SIZE, :SIZE] - SIZE / 2))
    own = np.exp(-0.5 * (away / 9) ** 2)[..., None] * [3.0, 0.0]
    frame = beside(drawn, own)
    off = [np.abs(frame_shift(drawn, frame, disc(), window, FAR) - own)[away < 6].mean() for window in (12.0, 4.0)]
    assert off[1] < 0.3 < 0.5 < off[0]


@pytest.mark.parametrize("case", ["same", "one color", "noise"])
def test_what_tells_nothing_moves_nothing(case):
    drawn = np.full((SIZE, SIZE, 3), 0.5) if case == "one color" else picture(0)
    rng = np.random.default_rng(1)
    frame = drawn + {"same": 0, "one color": 0.002, "noise": 0.02}[case] * rng.normal(size=drawn.shape)
    shift = frame_shift(drawn, frame, disc(), WIDE, FAR)
    assert np.isfinite(shift).all()
    assert np.abs(shift).max() < {"same": 1e-9, "one color": 0.2, "noise": 0.1}[case]


def test_equations_are_moved_onto_the_atlas_frame_by_frame():
    image, known = picture(0), disc()
    pixels = np.flatnonzero(known).astype(np.int32)
    rng = np.random.default_rng(2)
    given = np.full((len(pixels), 3), 0.5, np.float32)
    true = image[known].astype(np.float32)
    weight = rng.uniform(0.1, 1, 2 * len(pixels)).astype(np.float32)
    rows = np.arange(2 * len(pixels))
    matrix = csr_matrix((weight, (rows, np.tile(np.arange(len(pixels)), 2))))
    frames = [beside(image, smooth_shift()), image]
    wanted = np.concatenate([frame[known] - 0.5 for frame in frames]) * weight[:, None]
    equations = Equations(matrix, wanted.astype(np.float32))
    before = wanted.copy()
    shown = ShownVideo([pixels, pixels, pixels[:0]], SIZE, PIXEL)
    after, moved = aligned_frames(equations, shown, given, true - given, WINDOWS[0])
    assert moved == pytest.approx(0.5 * 2 * PIXEL, rel=0.1)  # half of the frames, by two pixels
    right = matrix @ (true - given)
    first = slice(0, len(pixels))
    assert np.abs(after.wanted - right)[first].mean() < 0.3 * np.abs(before - right)[first].mean()
    np.testing.assert_allclose(after.wanted[len(pixels) :], before[len(pixels) :], atol=1e-4)
    np.testing.assert_array_equal(equations.wanted, np.float32(before))
