"""LPIPS against its formula written out independently, with random weights in both forms of file."""

import numpy as np
import pytest
import torch

from bench.score.lpips import CONVOLUTIONS, read_perceptual
from bench.score.quality import evaluate
from command.errors import AssetError

RNG = np.random.default_rng(11)


def random_weights():
    """AlexNet's and the linear layers' state dictionaries, as torchvision and the lpips package name them."""
    generator = torch.Generator().manual_seed(4)
    alexnet, linear = {}, {}
    for layer, (index, into, out, kernel, *_) in enumerate(CONVOLUTIONS):
        shape = (out, into, kernel, kernel)
        spread = (into * kernel * kernel) ** -0.5
        alexnet[f"features.{index}.weight"] = torch.randn(shape, generator=generator) * spread
        alexnet[f"features.{index}.bias"] = torch.randn(out, generator=generator) * 0.1
        linear[f"lin{layer}.model.1.weight"] = torch.rand((1, out, 1, 1), generator=generator)
    return alexnet, linear


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lpips")
    alexnet, linear = random_weights()
    torch.save(alexnet | {"classifier.6.bias": torch.zeros(1000)}, folder / "alexnet.pth")
    torch.save(linear, folder / "alex.pth")
    whole = dict(linear)
    for layer, (index, *_) in enumerate(CONVOLUTIONS, start=1):
        for name in ("weight", "bias"):
            whole[f"net.slice{layer}.{index}.{name}"] = alexnet[f"features.{index}.{name}"]
    torch.save(whole, folder / "whole.pth")
    return folder


def correlate(image, weight, bias, stride, padding):
    """A convolution layer by its definition, double precision: channels first."""
    image = np.pad(image, ((0, 0), (padding, padding), (padding, padding)))
    kernel = weight.shape[-1]
    windows = np.lib.stride_tricks.sliding_window_view(image, (kernel, kernel), axis=(1, 2))
    return np.einsum("chwij,ocij->ohw", windows[:, ::stride, ::stride], weight) + bias[:, None, None]


def pooled(image):
    windows = np.lib.stride_tricks.sliding_window_view(image, (3, 3), axis=(1, 2))[:, ::2, ::2]
    return windows.max((-1, -2))


def lpips_by_definition(truth, image):
    alexnet, linear = random_weights()
    shift, scale = np.array([-0.03, -0.088, -0.188]), np.array([0.458, 0.448, 0.45])
    a, b = (((2 * x - 1 - shift) / scale).transpose(2, 0, 1) for x in (truth, image))
    total = 0.0
    for layer, (index, _, _, _, stride, padding, pool_first) in enumerate(CONVOLUTIONS):
        weight = alexnet[f"features.{index}.weight"].double().numpy()
        bias = alexnet[f"features.{index}.bias"].double().numpy()
        if pool_first:
            a, b = pooled(a), pooled(b)
        a, b = (np.maximum(correlate(x, weight, bias, stride, padding), 0) for x in (a, b))
        apart = a / np.linalg.norm(a, axis=0) - b / np.linalg.norm(b, axis=0)
        w = linear[f"lin{layer}.model.1.weight"].double().numpy().reshape(-1, 1, 1)
        total += (w * apart**2).sum(0).mean()
    return total


@pytest.mark.parametrize("names", [["alexnet.pth", "alex.pth"], ["whole.pth"]])
def test_lpips_is_its_formula(files, names):
    truth, image = RNG.random((2, 63, 70, 3))
    expected = lpips_by_definition(truth, image)
    network = read_perceptual([files / name for name in names])
    assert network.score(truth, image).value == pytest.approx(expected, rel=1e-4)
    assert expected > 0.01
    assert network.score(truth, truth).value == 0.0


def test_an_image_too_small_for_lpips_says_so(files):
    score = read_perceptual([files / "whole.pth"]).score(*RNG.random((2, 30, 90, 3)))
    assert score.value is None and "90 x 30 px" in score.reason


def test_weights_that_are_missing_misshapen_or_no_tensors_are_refused(files, tmp_path):
    with pytest.raises(AssetError, match=r"alexnet\.pth: no weight lin0\.model\.1\.weight"):
        read_perceptual([files / "alexnet.pth"])
    content = torch.load(files / "whole.pth", weights_only=True)
    torch.save(content | {"net.slice2.3.bias": torch.zeros(7)}, tmp_path / "short.pth")
    with pytest.raises(AssetError, match=r"slice2\.3\.bias should be \(192,\), is \(7,\)"):
        read_perceptual([tmp_path / "short.pth"])
    (tmp_path / "text.pth").write_text("no weights")
    with pytest.raises(AssetError, match=r"text\.pth: expected a state dictionary"):
        read_perceptual([tmp_path / "text.pth"])


def test_evaluation_gives_lpips_of_every_region_when_it_has_weights(oracle, files, monkeypatch):
    capture, avatar, _ = oracle
    result = evaluate(avatar, capture, lpips=[files / "whole.pth"])
    for region in ("head", "hands", "total"):
        scores = result["novel_pose"][region]
        assert 0 <= scores["lpips"] < 0.2 and "lpips" not in scores.get("reasons", {})
