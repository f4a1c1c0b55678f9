"""LPIPS (Zhang et al. 2018), AlexNet version 0.1, from weights that the user supplies: none are shipped.

    d = sum over 5 layers of the mean over pixels of  w_l . (f_l(x) / |f_l(x)| - f_l(y) / |f_l(y)|)^2

f_l are AlexNet's features after each ReLU, w_l the trained linear layers. Either one file, made by

    python -c "import lpips, torch; torch.save(lpips.LPIPS(net='alex').state_dict(), 'lpips-alex.pth')"

or two: torchvision's `alexnet-owt-7be5be79.pth` and the lpips package's `weights/v0.1/alex.pth`.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from bench.score.metrics import Score, check_images
from command.errors import AssetError
from files.input_file import unusable
from train.weight_file import read_weights

# index in torchvision's `features`, in channels, out channels, kernel, stride, padding, max-pooled before
CONVOLUTIONS = (
    (0, 3, 64, 11, 4, 2, False),
    (3, 64, 192, 5, 1, 2, True),
    (6, 192, 384, 3, 1, 1, True),
    (8, 384, 256, 3, 1, 1, False),
    (10, 256, 256, 3, 1, 1, False),
)
# ImageNet's mean and deviation for colors in [-1, 1]
SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)
# pixels of a side: below it a pooling layer has nothing left
SMALLEST = 31
WHAT = "a state dictionary of LPIPS"


class Perceptual(nn.Module):
    """The network; call it with two images for their distance."""

    def __init__(self) -> None:
        super().__init__()
        self.convolutions = nn.ModuleList(
            nn.Conv2d(into, out, kernel, stride, padding) for _, into, out, kernel, stride, padding, _ in CONVOLUTIONS
        )
        self.linear = nn.ParameterList(torch.zeros(out) for _, _, out, *_ in CONVOLUTIONS)
        self.register_buffer("shift", torch.tensor(SHIFT)[:, None, None])
        self.register_buffer("scale", torch.tensor(SCALE)[:, None, None])

    def features(self, images: Float[Tensor, "n 3 height width"]) -> list[Float[Tensor, "n channels _ _"]]:
        """Unit feature vectors of the five layers; colors in [0, 1]."""
        x = (2 * images - 1 - self.get_buffer("shift")) / self.get_buffer("scale")
        out = []
        for convolution, (*_, pooled) in zip(self.convolutions, CONVOLUTIONS, strict=True):
            x = torch.relu(convolution(nn.functional.max_pool2d(x, 3, 2) if pooled else x))
            out.append(x / (x.square().sum(1, keepdim=True).sqrt() + 1e-10))
        return out

    @torch.no_grad()
    def score(self, truth: Float[np.ndarray, "height width 3"], image: Float[np.ndarray, "_ _ 3"]) -> Score:
        """LPIPS of two images in [0, 1]: 0 is equal."""
        check_images(truth, image)
        if min(truth.shape[:2]) < SMALLEST:
            size = f"{truth.shape[1]} x {truth.shape[0]}"
            return Score(None, f"image of {size} px is smaller than LPIPS takes ({SMALLEST})")
        pair = torch.as_tensor(np.stack([truth, image]).clip(0, 1), dtype=torch.float32).permute(0, 3, 1, 2)
        total = 0.0
        for features, weight in zip(self.features(pair), self.linear, strict=True):
            squared = (features[0] - features[1]).square()
            total += float((weight[:, None, None] * squared).sum(0).mean())
        return Score(total)


def read_perceptual(paths: Sequence[Path]) -> Perceptual:
    """The network with its weights from one or two files (see the module).

    Raises:
        AssetError: a file is not a state dictionary of tensors, or a weight is absent or misshapen.
    """
    found: dict[str, Tensor] = {}
    for path in paths:
        content = read_weights(path, WHAT)
        with unusable(f"{path}: expected {WHAT}, found"):
            found |= {str(name): value for name, value in dict(content).items()}
    names, network = " and ".join(str(path) for path in paths), Perceptual()
    own = network.state_dict()
    for layer, (index, _, out, *_) in enumerate(CONVOLUTIONS):
        for name in ("weight", "bias"):
            into, keys = own[f"convolutions.{layer}.{name}"], [f"features.{index}.{name}"]
            into.copy_(weight_of(found, [*keys, f"net.slice{layer + 1}.{index}.{name}"], tuple(into.shape), names))
        keys = [f"lin{layer}.model.1.weight", f"lins.{layer}.model.1.weight"]
        own[f"linear.{layer}"].copy_(weight_of(found, keys, (1, out, 1, 1), names).reshape(out))
    return network.eval().requires_grad_(False)


def weight_of(found: dict[str, Tensor], keys: Sequence[str], shape: tuple[int, ...], names: str) -> Tensor:
    """The first of `keys` that is there, of the right shape."""
    for key in keys:
        if key in found:
            value = found[key]
            shown = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
            if shown != shape:
                raise AssetError(f"{names}: {key} should be {shape}, is {shown}")
            if not bool(torch.isfinite(value).all()):
                raise AssetError(f"{names}: {key} holds numbers that are not finite")
            return value
    raise AssetError(f"{names}: no weight {' or '.join(keys)}; LPIPS takes AlexNet and its linear layers")
