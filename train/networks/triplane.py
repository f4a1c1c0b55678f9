"""Networks of the `demo` preset: features on three planes and small MLPs, the fastest to learn on a CPU."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from train.deform import Displacement
from train.encoding import positional_encoding
from train.networks import PartNetworks, frame_codes


@dataclass(frozen=True, kw_only=True)
class TriPlaneNetworks:
    """Sizes of the `demo` networks."""

    plane_size: int = 160  # texels of a geometry plane's side
    plane_channels: int = 8
    color_size: int = 256  # texels of a colour plane's side
    color_channels: int = 8
    width: int = 64
    # numbers that F_s hands to F_c
    feature: int = 15
    appearance: int = 8  # of a frame's code l_i
    displacement: int = 8  # of a frame's code phi_i
    reach: float = 0.06  # correction of the template at most, metres


def build(networks: TriPlaneNetworks, frames: int, half: Float[Tensor, "3"], displacement_reach: float) -> PartNetworks:
    """Untrained networks of a part with `frames` frames; `half` is its box's half size, metres."""
    geometry = TriPlaneGeometry(networks)
    planes = TriPlane(networks.color_channels, networks.color_size)
    appearance = frame_codes(frames, networks.appearance)
    color = TriPlaneColor(planes, networks)
    code, width = frame_codes(frames, networks.displacement), networks.width
    inputs = 3 + 6 * 4 + networks.displacement
    trunk = nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
    displacement = Displacement(code, trunk, width=width, frequencies=4, reach=displacement_reach)
    return PartNetworks(geometry, appearance, color, displacement)


class TriPlane(nn.Module):
    """Features of a point: bilinear look-ups on three axis-aligned planes, side by side."""

    def __init__(self, channels: int, size: int, *, start: float = 1e-2):
        super().__init__()
        self.planes = nn.Parameter(start * torch.randn(3, channels, size, size))

    def forward(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n d"]:
        """Beyond the unit box the border repeats."""
        at = torch.stack([unit[:, [0, 1]], unit[:, [0, 2]], unit[:, [1, 2]]])[:, :, None]
        sampled = F.grid_sample(self.planes, at, mode="bilinear", padding_mode="border", align_corners=True)
        return sampled[..., 0].permute(2, 0, 1).flatten(1)


class TriPlaneGeometry(nn.Module):
    """reach tanh(mlp): the correction's last layer starts at zero, so an untrained part is its template."""

    over_template = True

    def __init__(self, networks: TriPlaneNetworks):
        super().__init__()
        self.reach = networks.reach
        self.planes = TriPlane(networks.plane_channels, networks.plane_size)
        width = networks.width
        self.trunk = nn.Sequential(
            nn.Linear(3 * networks.plane_channels + 27, width), nn.Softplus(beta=100),
            nn.Linear(width, width), nn.Softplus(beta=100),
        )  # fmt: skip
        self.correction = nn.Linear(width, 1)
        self.feature = nn.Linear(width, networks.feature)
        nn.init.zeros_(self.correction.weight)
        nn.init.zeros_(self.correction.bias)

    def forward(self, unit: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n"], Float[Tensor, "n z"]]:
        hidden = self.trunk(torch.cat([self.planes(unit), positional_encoding(unit, 4)], -1))
        return self.reach * torch.tanh(self.correction(hidden)[:, 0]), self.feature(hidden)


class TriPlaneColor(nn.Module):
    """F_c with planes of its own: texture is finer than shape."""

    def __init__(self, planes: TriPlane, networks: TriPlaneNetworks):
        super().__init__()
        self.planes = planes
        width = networks.width
        inputs = 39 + networks.feature + 3 + 9 + networks.appearance + 3 * networks.color_channels
        self.network = nn.Sequential(
            nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 3)
        )

    def forward(
        self,
        unit: Float[Tensor, "n 3"],
        feature: Float[Tensor, "n z"],
        normals: Float[Tensor, "n 3"],
        directions: Float[Tensor, "n 3"],
        code: Float[Tensor, "n l"],
    ) -> Float[Tensor, "n 3"]:
        """sRGB in [0, 1]."""
        inputs = [
            positional_encoding(unit, 6),
            feature,
            normals,
            positional_encoding(directions, 1),
            code,
            self.planes(unit),
        ]
        return torch.sigmoid(self.network(torch.cat(inputs, -1)))
