import numpy as np
import onnxruntime
import pytest

from avatar.gltf.avatar_file import ViewNetwork
from bake.cone import ViewCone, six_from_matrix, tangent_frame
from bake.network import (
    AMPLITUDE,
    SurfacePoints,
    choose,
    distil,
    fit_linear,
    linear_residual,
    network_inputs,
    network_residual,
    write_onnx,
)


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


def test_network_wins_where_the_residual_is_curved():
    found = distil(gloss, ball_points(), steps=400)
    assert found.default_view == "network" and found.network is not None and found.linear is not None
    assert found.decibels["network"] > found.decibels["off"] + 6
    assert found.decibels["network"] >= found.decibels["linear"] + 0.3


def test_nothing_is_shipped_without_view_dependence():
    found = distil(plain, ball_points(), steps=10)
    assert (found.network, found.linear, found.features, found.default_view) == (None, None, None, "off")
    assert found.decibels["off"] == float("inf")


def test_nothing_is_shipped_where_nothing_was_seen():
    assert distil(gloss, ball_points(seen=0.0), steps=10).default_view == "off"


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


def test_linear_fit_recovers_the_matrices():
    rng = np.random.default_rng(0)
    features, tangent, truth = rng.random((5000, 4)), rng.normal(size=(5000, 3)), rng.normal(size=(4, 3, 3))
    found = fit_linear(features, tangent, linear_residual(truth, features, tangent))
    np.testing.assert_allclose(found, truth, atol=1e-3)


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
