"""Networks of the `fast` preset: a hash grid of features (Mueller et al. 2022) and small MLPs, for a GPU.

    feature_l(x) = sum over the 8 corners c of the cell of x in level l:  w_c(x) table[h_l(c)]

Everything is torch, so one code path serves CPU and CUDA, and the interpolation is differentiable twice, as analytic
normals in a loss ask. Levels open one after the other, coarse first: shape settles before texture can fake it.
"""

import math
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from train.deform import Displacement
from train.encoding import positional_encoding
from train.networks import PartNetworks, frame_codes


@dataclass(frozen=True, kw_only=True)
class HashNetworks:
    """Sizes of the `fast` networks."""

    cell: float  # finest level, metres
    levels: int = 16
    channels: int = 2  # per level
    rows: int = 2**19  # of a level's table at most
    coarsest: int = 16  # cells along the box's longest side
    first_levels: int = 4  # open from the start
    # share of the steps after which all levels are open
    opened: float = 0.4
    width: int = 64
    # numbers that F_s hands to F_c
    feature: int = 15
    appearance: int = 16  # of a frame's code l_i
    displacement: int = 16  # of a frame's code phi_i
    reach: float = 0.06  # correction of the template at most, metres


def build(networks: HashNetworks, frames: int, half: Float[Tensor, "3"], displacement_reach: float) -> PartNetworks:
    """Untrained networks of a part with `frames` frames; `half` is its box's half size, metres."""
    geometry = HashGeometry(networks, half)
    appearance = frame_codes(frames, networks.appearance)
    color = HashColor(networks)
    width = networks.width
    trunk = nn.Sequential(
        nn.Linear(3 + 6 * 4 + networks.displacement, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(),
        nn.Linear(width, width), nn.ReLU(),
    )  # fmt: skip
    displacement = Displacement(
        frame_codes(frames, networks.displacement),
        trunk,
        width=width,
        frequencies=4,
        reach=displacement_reach,
    )
    return PartNetworks(geometry, appearance, color, displacement)


class _Take(torch.autograd.Function):
    """table[index], differentiable any number of times: its adjoint adds rows, and the adjoint of that takes them.

    Torch's own backward of indexing sorts the indices on CUDA; index_add_ adds as they come.
    """

    @staticmethod
    def forward(ctx: Any, table: Tensor, index: Tensor) -> Tensor:
        ctx.save_for_backward(index)
        ctx.rows = len(table)
        return table[index]

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> Any:
        (index,) = ctx.saved_tensors
        return _Add.apply(gradients[0], index, ctx.rows), None


class _Add(torch.autograd.Function):
    """Rows summed into a table of zeros: the adjoint of `_Take`."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, index: Tensor, rows: int) -> Tensor:
        ctx.save_for_backward(index)
        table = torch.zeros(rows, values.shape[-1], dtype=values.dtype, device=values.device)
        return table.index_add_(0, index, values.contiguous())

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> Any:
        (index,) = ctx.saved_tensors
        return _Take.apply(gradients[0], index), None, None


def take_rows(table: Float[Tensor, "rows features"], index: Int[Tensor, "n"]) -> Float[Tensor, "n features"]:
    """table[index], with a gradient fit for CUDA."""
    return _Take.apply(table, index)  # pyright: ignore[reportReturnType]


class HashGrid(nn.Module):
    """Multi-resolution features of a box; levels whose cells fit their table are stored plainly, others hashed."""

    corners: Int[Tensor, "8 3"]
    aspect: Float[Tensor, "3"]  # the box's sides, of the longest
    # cells along the longest side
    resolution: Float[Tensor, "levels"]
    last_cell: Int[Tensor, "levels 3"]
    # of a plainly stored level
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
        points = torch.tensor([[math.ceil(r * float(a)) + 1 for a in aspect] for r in resolution])
        wanted = points.prod(1)
        rows = wanted.clamp_max(networks.rows)
        put = self.register_buffer
        put("corners", torch.tensor([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]), False)
        put("aspect", aspect.float(), False)
        put("resolution", torch.tensor(resolution, dtype=torch.float32), False)
        put("last_cell", points - 2, False)
        put(
            "strides",
            torch.stack([torch.ones_like(wanted), points[:, 0], points[:, 0] * points[:, 1]], 1),
            False,
        )
        put("plain", (wanted <= networks.rows).long(), False)
        put("rows", rows, False)
        put("first_row", torch.cumsum(rows, 0) - rows, False)
        self.opened, self.first_levels = networks.opened, min(networks.first_levels, levels)
        # levels that count; the others give zeros
        self.open = self.first_levels
        self.table = nn.Parameter(1e-4 * (2 * torch.rand(int(rows.sum()), networks.channels) - 1))

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
        """Row of each corner in the one table."""
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


def open_levels(network: nn.Module, share: float) -> None:
    """Open the levels of every hash grid in a network for `share` of the training done."""
    for module in network.modules():
        if isinstance(module, HashGrid):
            module.open_for(share)


class HashGeometry(nn.Module):
    """reach tanh(mlp(hash grid)): the last layer starts at zero, so an untrained part is its template."""

    over_template = True

    def __init__(self, networks: HashNetworks, half: Float[Tensor, "3"]):
        super().__init__()
        self.reach = networks.reach
        self.grid = HashGrid(networks, half)
        width = networks.width
        self.trunk = nn.Sequential(nn.Linear(3 + networks.levels * networks.channels, width), nn.Softplus(beta=100))
        self.correction = nn.Linear(width, 1)
        self.feature = nn.Linear(width, networks.feature)
        nn.init.zeros_(self.correction.weight)
        nn.init.zeros_(self.correction.bias)

    def forward(self, unit: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n"], Float[Tensor, "n z"]]:
        hidden = self.trunk(torch.cat([unit, self.grid(unit)], -1))
        return self.reach * torch.tanh(self.correction(hidden)[:, 0]), self.feature(hidden)


class HashColor(nn.Module):
    """F_c: two layers."""

    def __init__(self, networks: HashNetworks):
        super().__init__()
        width = networks.width
        inputs = 39 + networks.feature + 3 + 9 + networks.appearance
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
        inputs = [positional_encoding(unit, 6), feature, normals, positional_encoding(directions, 1), code]
        return torch.sigmoid(self.network(torch.cat(inputs, -1)))
