"""Networks of the `demo` preset: features on three planes and small MLPs, the fastest to learn on a CPU."""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from train.deform import Displacement, positional_encoding
from train.networks import FeatureGrid, PartNetworks, SmallColor, TemplateCorrection, drawn, frame_codes, layers


@dataclass(frozen=True, kw_only=True)
class TriPlaneNetworks:
    kind: ClassVar[str] = "triplane"
    plane_size: int = 160  # texels of a geometry plane's side
    plane_channels: int = 8
    color_size: int = 256  # texels of a color plane's side
    color_channels: int = 8
    width: int = 64
    # numbers that F_s hands to F_c
    feature: int = 15
    appearance: int = 8  # numbers in a frame's code l_i
    displacement: int = 8  # numbers in a frame's code phi_i
    reach: float = 0.06  # correction of the template at most, metres

    def build(self, frames: int, half: Float[Tensor, "3"], displacement_reach: float) -> PartNetworks:
        """Untrained networks of a part with `frames` frames; `half` is its box's half size, metres."""
        geometry = TriPlaneGeometry(self)
        planes = TriPlane(self.color_channels, self.color_size)
        appearance = frame_codes(frames, self.appearance)
        color = SmallColor(planes, width=self.width, feature=self.feature, appearance=self.appearance,
                           planes_give=3 * self.color_channels)  # fmt: skip
        code, width = frame_codes(frames, self.displacement), self.width
        trunk = layers([3 + 6 * 4 + self.displacement, width, width])
        displacement = Displacement(code, trunk, width=width, frequencies=4, reach=displacement_reach)
        return PartNetworks(geometry, appearance, color, displacement)


class TriPlane(FeatureGrid):
    """Features of a point: bilinear look-ups on three axis-aligned planes, side by side."""

    def __init__(self, channels: int, size: int):
        super().__init__()
        self.planes = nn.Parameter(drawn(3, channels, size, size, by=lambda values: values.normal_(std=1e-2)))

    def forward(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n d"]:
        """Beyond the unit box the border repeats."""
        at = torch.stack([unit[:, [0, 1]], unit[:, [0, 2]], unit[:, [1, 2]]])[:, :, None]
        sampled = F.grid_sample(self.planes, at, mode="bilinear", padding_mode="border", align_corners=True)
        return sampled[..., 0].permute(2, 0, 1).flatten(1)


class TriPlaneGeometry(TemplateCorrection):
    """Planes and the encoded point, two layers."""

    def __init__(self, networks: TriPlaneNetworks):
        super().__init__()
        self.planes = TriPlane(networks.plane_channels, networks.plane_size)
        width = networks.width
        trunk = layers([3 * networks.plane_channels + 27, width, width], partial(nn.Softplus, beta=100))
        self.add_layers(trunk, width=width, feature=networks.feature, reach=networks.reach)

    def encoded(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n d"]:
        return torch.cat([self.planes(unit), positional_encoding(unit, 4)], -1)
