"""Networks of the `preview` preset, which learn nothing: the template's surface in the colors that the videos show."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from train.deform import Displacement, trilinear
from train.networks import ColorInputs, Geometry, PartNetworks, frame_codes


@dataclass(frozen=True, kw_only=True)
class SeenNetworks:
    kind: ClassVar[str] = "seen"
    cell: float = 0.01  # metres between colors

    def build(self, frames: int, half: Float[Tensor, "3"], displacement_reach: float) -> PartNetworks:
        """Networks of a part with `frames` frames; `half` is its box's half size, metres. All colors are black."""
        nodes = [max(2, int(torch.ceil(2 * side / self.cell)) + 1) for side in half]
        displacement = Displacement(
            frame_codes(frames, 1), nn.Linear(4, 1), width=1, frequencies=0, reach=displacement_reach
        )
        return PartNetworks(TemplateItself(), frame_codes(frames, 1), SeenColor(nodes), displacement)


class TemplateItself(Geometry):
    """F_s is the template's distance: the correction is zero, and so is its gradient."""

    def forward(self, unit: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n"], Float[Tensor, "n 1"]]:
        zero = 0 * unit[:, :1]
        return zero[:, 0], zero


class SeenColor(nn.Module):
    """F_c is a color of the place alone: trilinear between the nodes of a grid over the part's box."""

    values: Float[Tensor, "3 x y z"]  # sRGB in [0, 1], or albedo where a light is known

    def __init__(self, nodes: list[int]):
        super().__init__()
        self.register_buffer("values", torch.zeros(3, *nodes))

    def places(self) -> Float[Tensor, "nodes 3"]:
        """The nodes in the unit box, in the order of `values`."""
        axes = [torch.linspace(-1, 1, count) for count in self.values.shape[1:]]
        return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)

    def forward(self, at: ColorInputs) -> Float[Tensor, "n 3"]:
        """sRGB in [0, 1]; beyond the unit box the border repeats."""
        return trilinear(self.values, at.unit)
