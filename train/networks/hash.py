"""Networks of the `fast` preset: a hash grid of features (Mueller et al. 2022) and small MLPs, for a GPU.

    feature_l(x) = sum over the 8 corners c of the cell of x in level l:  w_c(x) table[h_l(c)]

Everything is torch, so one code path serves CPU and CUDA, and the interpolation is differentiable twice, as analytic
normals in a loss ask. Levels open one after the other, coarse first: shape settles before texture can fake it.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from train.deform import Displacement
from train.networks import FeatureGrid, Layers, PartNetworks, SmallColor, TemplateCorrection, drawn, frame_codes, layers


@dataclass(frozen=True, kw_only=True)
class HashNetworks:
    kind: ClassVar[str] = "hash"
    cell: float  # finest level, metres
    levels: Layers = 16
    channels: int = 2  # per level
    rows: int = 2**19  # a level's table has at most so many
    coarsest: int = 16  # cells along the box's longest side
    first_levels: int = 4  # open from the start
    # share of the steps after which all levels are open
    opened: float = 0.4
    width: int = 64
    # numbers that F_s hands to F_c
    feature: int = 15
    appearance: int = 16  # numbers in a frame's code l_i
    displacement: int = 16  # numbers in a frame's code phi_i
    reach: float = 0.06  # correction of the template at most, metres

    def build(self, frames: int, half: Float[Tensor, "3"], displacement_reach: float) -> PartNetworks:
        """Untrained networks of a part with `frames` frames; `half` is its box's half size, metres."""
        geometry = HashGeometry(self, half)
        appearance = frame_codes(frames, self.appearance)
        color = SmallColor(None, width=self.width, feature=self.feature, appearance=self.appearance)
        width = self.width
        trunk = layers([3 + 6 * 4 + self.displacement, width, width, width])
        displacement = Displacement(
            frame_codes(frames, self.displacement), trunk, width=width, frequencies=4, reach=displacement_reach
        )
        return PartNetworks(geometry, appearance, color, displacement)


class _Take(torch.autograd.Function):
    """table[index], differentiable any number of times: its adjoint adds rows, and the adjoint of that takes them.

    Torch's own backward of indexing sorts the indices on CUDA; index_add_ adds as they come.
    """

    @staticmethod
    def forward(ctx, table: Tensor, index: Tensor) -> Tensor:
        ctx.save_for_backward(index)
        ctx.rows = len(table)
        return table[index]

    @staticmethod
    def backward(ctx, *gradients):
        (index,) = ctx.saved_tensors
        return _Add.apply(gradients[0], index, ctx.rows), None


class _Add(torch.autograd.Function):
    """Rows summed into a table of zeros: the adjoint of `_Take`."""

    @staticmethod
    def forward(ctx, values: Tensor, index: Tensor, rows: int) -> Tensor:
        ctx.save_for_backward(index)
        table = torch.zeros(rows, values.shape[-1], dtype=values.dtype, device=values.device)
        return table.index_add_(0, index, values.contiguous())

    @staticmethod
    def backward(ctx, *gradients):
        (index,) = ctx.saved_tensors
        return _Take.apply(gradients[0], index), None, None


def take_rows(table: Float[Tensor, "rows features"], index: Int[Tensor, "n"]) -> Float[Tensor, "n features"]:
    """table[index], with a gradient fit for CUDA."""
    return _Take.apply(table, index)  # pyright: ignore[reportReturnType]


class HashGrid(FeatureGrid):
    """Multi-resolution features of a box; levels whose cells fit their table are stored plainly, others hashed."""

    corners: Int[Tensor, "8 3"]
    aspect: Float[Tensor, "3"]  # the box's sides, of the longest
    # cells along the longest side
    resolution: Float[Tensor, "levels"]
    last_cell: Int[Tensor, "levels 3"]
    # rows between neighbours of a plainly stored level
    strides: Int[Tensor, "levels 3"]
    plain: Int[Tensor, "levels"]  # 1 or 0
    rows: Int[Tensor, "levels"]
    first_row: Int[Tensor, "levels"]

    def __init__(self, networks: HashNetworks, half: Float[Tensor, "3"]):
        super().__init__()
        levels = networks.levels
        finest = max(2 * float(half.max()) / networks.cell, networks.coarsest)
        growth = (finest / networks.coarsest) ** (1 / max(levels - 1, 1))
        resolution = [math.floor(networks.coarsest * growth**level + 1e-6) for level in range(levels)]
        aspect = (half / half.max()).double()
        points = torch.tensor([[math.ceil(r * float(a)) + 1 for a in aspect] for r in resolution], device="cpu")
        wanted = points.prod(1)
        rows = wanted.clamp_max(networks.rows)
        put = self.register_buffer
        put("corners", torch.tensor([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]), False)
        put("aspect", aspect.float(), False)
        put("resolution", torch.tensor(resolution, dtype=torch.float32), False)
        put("last_cell", points - 2, False)
        put("strides", torch.stack([torch.ones_like(wanted), points[:, 0], points[:, 0] * points[:, 1]], 1), False)
        put("plain", (wanted <= networks.rows).long(), False)
        put("rows", rows, False)
        put("first_row", torch.cumsum(rows, 0) - rows, False)
        self.opened, self.first_levels = networks.opened, min(networks.first_levels, levels)
        # levels that count; the others give zeros
        self.open = self.first_levels
        small = lambda values: values.uniform_(-1e-4, 1e-4)
        self.table = nn.Parameter(drawn(int(rows.sum()), networks.channels, by=small))

    def forward(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n d"]:
        """Beyond the unit box the border repeats."""
        levels = self.open
        place = 0.5 * (unit.clamp(-1, 1) + 1) * self.aspect.to(unit.dtype)
        at = place[:, None] * self.resolution[:levels, None].to(unit.dtype)
        # a point on the far border belongs to the last cell; rounding must not put it into one beyond
        cell = at.detach().floor().long()
        cell = torch.minimum(cell, self.last_cell[:levels])
        into = (at - cell)[:, :, None]
        wx, wy, wz = torch.where(self.corners == 1, into, 1 - into).unbind(-1)
        index = self._rows(cell[:, :, None] + self.corners, levels)
        features = take_rows(self.table, index.flatten()).view(*index.shape, self.table.shape[1])
        features = ((wx * wy * wz)[..., None] * features).sum(2).flatten(1)
        closed = len(self.resolution) - levels
        return torch.nn.functional.pad(features, (0, closed * self.table.shape[1]))

    def _rows(self, corner: Int[Tensor, "n levels 8 3"], levels: int) -> Int[Tensor, "n levels 8"]:
        plainly = (corner * self.strides[:levels, None]).sum(-1)
        x, y, z = corner.unbind(-1)
        hashed = (x ^ (y * 2654435761) ^ (z * 805459861)) % self.rows[:levels, None]
        return torch.where(self.plain[:levels, None] == 1, plainly, hashed) + self.first_row[:levels, None]

    def open_for(self, share: float) -> None:
        """Open the levels that count when `share` of the training is done; none is ever closed again."""
        levels = len(self.resolution)
        more = int((levels - self.first_levels) * min(share / self.opened, 1.0) + 1e-9)
        self.open = max(self.open, self.first_levels + more)

    def get_extra_state(self) -> Tensor:
        return torch.tensor(self.open)

    def set_extra_state(self, state: Tensor) -> None:
        self.open = int(state)


class HashGeometry(TemplateCorrection):
    """The point and its grid's features, one layer."""

    def __init__(self, networks: HashNetworks, half: Float[Tensor, "3"]):
        super().__init__()
        self.grid = HashGrid(networks, half)
        width = networks.width
        trunk = nn.Sequential(nn.Linear(3 + networks.levels * networks.channels, width), nn.Softplus(beta=100))
        self.add_layers(trunk, width=width, feature=networks.feature, reach=networks.reach)

    def encoded(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n d"]:
        return torch.cat([unit, self.grid(unit)], -1)
