"""Networks of the `paper` preset: the supplement's, layer by layer (TotalSelfScan, supplement, section 1).

    F_s   gamma_6(x) 39 -> 8 x 256, softplus(100), the input again before the fifth layer -> s, z (1 + 256)
    F_c   gamma_6(x) 39, gamma_4(d) 27, n 3, z 256, l 128 -> 4 x 256, ReLU, the input again before the third -> 3
    T_nr  gamma_6(x) 39, phi 128 -> 8 x 256, ReLU, the input again before the fifth layer -> 3

The supplement counts hidden layers and is silent on the start: F_s begins as a sphere (Atzmon and Lipman 2020, with
the weights normalised, as VolSDF does), T_nr at zero. Points are scaled to order one by the box's longest half side.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.utils.parametrizations import weight_norm

from train.deform import Displacement, positional_encoding
from train.networks import ColorInputs, Geometry, Layers, PartNetworks, frame_codes


@dataclass(frozen=True, kw_only=True)
class PaperNetworks:
    """Sizes of the `paper` networks, each from the supplement but the last three."""

    kind: ClassVar[str] = "paper"
    width: int = 256
    geometry_layers: Layers = 8
    color_layers: Layers = 4
    displacement_layers: Layers = 8
    point_frequencies: int = 6
    direction_frequencies: int = 4
    # numbers that F_s hands to F_c
    feature: int = 256
    appearance: int = 128  # numbers in a frame's code l_i
    displacement: int = 128  # numbers in a frame's code phi_i
    # F_s starts as a sphere of this radius, in longest half sides of the box
    radius: float = 0.5
    # width of the density at the start, metres; learned. At VolSDF's .1 a hand is a mist
    beta: float = 0.01
    lowest_beta: float = 1e-4

    def build(self, frames: int, half: Float[Tensor, "3"], displacement_reach: float) -> PartNetworks:
        """Untrained networks of a part with `frames` frames; `half` is its box's half size, metres."""
        geometry = PaperGeometry(self, half)
        appearance = frame_codes(frames, self.appearance)
        color = PaperColor(self, half)
        points = 3 + 6 * self.point_frequencies
        trunk = SkipLayers(
            [nn.Linear(size, self.width)
             for size in input_sizes(points + self.displacement, self.width, self.displacement_layers)],
            F.relu,
        )  # fmt: skip
        displacement = Displacement(
            frame_codes(frames, self.displacement), trunk, width=self.width,
            frequencies=self.point_frequencies, reach=displacement_reach,
        )  # fmt: skip
        return PartNetworks(geometry, appearance, color, displacement)


def input_sizes(inputs: int, width: int, layers: int) -> list[int]:
    """Input width of each hidden layer; the middle one also takes the network's own input."""
    sizes = [inputs] + [width] * (layers - 1)
    sizes[layers // 2] += inputs
    return sizes


class SkipLayers(nn.Module):
    """Hidden layers, the input joined again before the middle one."""

    def __init__(self, layers: list[nn.Module], activation):
        super().__init__()
        self.layers = nn.ModuleList(layers)
        self.activation = activation

    def forward(self, inputs: Float[Tensor, "n i"]) -> Float[Tensor, "n o"]:
        hidden = inputs
        for number, layer in enumerate(self.layers):
            if number == len(self.layers) // 2:
                hidden = torch.cat([hidden, inputs], -1)
            hidden = self.activation(layer(hidden))
        return hidden


class PaperGeometry(Geometry):
    """F_s, Eq. 1: the distance itself, from a network; and beta, the learned width of its density."""

    over_template = False
    aspect: Float[Tensor, "3"]  # the box's half sides, of the longest

    def __init__(self, networks: PaperNetworks, half: Float[Tensor, "3"]):
        super().__init__()
        self.scale = float(half.max())  # metres
        self.frequencies, self.lowest_beta = networks.point_frequencies, networks.lowest_beta
        self.register_buffer("aspect", half / half.max())
        width, inputs = networks.width, 3 + 6 * networks.point_frequencies
        layers: list[nn.Module] = []
        for number, size in enumerate(input_sizes(inputs, width, networks.geometry_layers)):
            layer = nn.Linear(size, width)
            nn.init.normal_(layer.weight, std=math.sqrt(2 / width))
            nn.init.zeros_(layer.bias)
            # the encoding's waves start without effect: a sphere has none
            with torch.no_grad():
                if number == 0:
                    layer.weight[:, 3:] = 0
                elif size > width:
                    layer.weight[:, width + 3 :] = 0
                    # two inputs of like size
                    layer.weight *= math.sqrt(0.5)
            layers.append(weight_norm(layer))
        self.trunk = SkipLayers(layers, partial(F.softplus, beta=100))
        out = nn.Linear(width, 1 + networks.feature)
        nn.init.normal_(out.weight, math.sqrt(math.pi / width), 1e-4)
        nn.init.constant_(out.bias, -networks.radius)
        self.out = weight_norm(out)
        self.beta = nn.Parameter(torch.tensor(networks.beta))

    def forward(self, unit: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n"], Float[Tensor, "n z"]]:
        result = self.out(self.trunk(positional_encoding(unit * self.aspect, self.frequencies)))
        return self.scale * result[:, 0], result[:, 1:]

    def density_width(self) -> Float[Tensor, ""]:
        """beta of the Laplace density, metres: |b| + a floor, so that no step can take it through zero."""
        return self.beta.abs() + self.lowest_beta


class PaperColor(nn.Module):
    """F_c, Eq. 2."""

    aspect: Float[Tensor, "3"]  # the box's half sides, of the longest

    def __init__(self, networks: PaperNetworks, half: Float[Tensor, "3"]):
        super().__init__()
        self.point_frequencies = networks.point_frequencies
        self.direction_frequencies = networks.direction_frequencies
        self.register_buffer("aspect", half / half.max())
        inputs = 3 + 6 * networks.point_frequencies + 3 + 6 * networks.direction_frequencies
        inputs += 3 + networks.feature + networks.appearance
        sizes = input_sizes(inputs, networks.width, networks.color_layers)
        self.trunk = SkipLayers([nn.Linear(size, networks.width) for size in sizes], F.relu)
        self.out = nn.Linear(networks.width, 3)

    def forward(self, at: ColorInputs) -> Float[Tensor, "n 3"]:
        """sRGB in [0, 1]."""
        inputs = [
            positional_encoding(at.unit * self.aspect, self.point_frequencies),
            positional_encoding(at.directions, self.direction_frequencies),
            *(at.normals, at.feature, at.code),
        ]
        return torch.sigmoid(self.out(self.trunk(torch.cat(inputs, -1))))
