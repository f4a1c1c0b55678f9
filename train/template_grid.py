"""The template's distance grid as a module: where a part field starts."""

import torch
from jaxtyping import Float
from numpy import ndarray as Array
from torch import Tensor

from capture.folder import CaptureSubject
from capture.template.grid import distance_grid
from capture.template.surface import SurfaceCloud
from train.deform import trilinear


class TemplateGrid(torch.nn.Module):
    """Trilinear signed distance of the template in a box; outside it, the distance at the border plus the way there.

    Value and gradient come from the same interpolant. The gradient is a constant of the training.
    """

    values: Float[Tensor, "x y z"]  # signed distance, metres
    low: Float[Tensor, "3"]  # place of values[0, 0, 0], canonical

    def __init__(self, values: Float[Tensor, "x y z"], low: Float[Tensor, "3"], cell: float):
        super().__init__()
        self.register_buffer("values", values)
        self.register_buffer("low", low)
        self.cell = cell
        # central differences at the nodes, made when they are first asked for
        self.slopes: Float[Tensor, "3 x y z"] | None = None

    def sample(self, points: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n"], Float[Tensor, "n 3"]]:
        """Distance and its gradient; no graph."""
        with torch.no_grad():
            return sampled(self.values, self.low, self.cell, points)

    def smooth_gradient(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Gradient by differences over two cells, trilinear between its nodes; no graph.

        Unlike the interpolant's own it does not jump from cell to cell.
        """
        if self.slopes is None or self.slopes.device != points.device:
            self.slopes = torch.stack(torch.gradient(self.values, spacing=self.cell)).to(points.device)
        shape = torch.tensor(self.values.shape, dtype=points.dtype, device=points.device)
        unit = ((points.detach() - self.low) / self.cell / (shape - 1) * 2 - 1).clamp(-1, 1)
        return trilinear(self.slopes, unit)

    def forward(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n"]:
        """The value, differentiable once: torch's own interpolation, eight times as fast as `sample`."""
        return interpolated(self.values, self.low, self.cell, points)


def sampled(
    values: Float[Tensor, "x y z"], low: Float[Tensor, "3"], cell: float, points: Float[Tensor, "n 3"]
) -> tuple[Float[Tensor, "n"], Float[Tensor, "n 3"]]:
    """Trilinear values of a grid and their gradient; outside its box the border's plus the way there."""
    shape = torch.tensor(values.shape, device=points.device)
    at = (points - low) / cell
    inside = torch.minimum(at.clamp_min(0), (shape - 1 - 1e-4).to(at.dtype))
    beyond = (at - inside) * cell
    corner = inside.floor().long()
    f = inside - corner
    strides = torch.tensor([values.shape[1] * values.shape[2], values.shape[2], 1])
    strides = strides.to(points.device)
    base = (corner * strides).sum(-1)
    flat = values.reshape(-1)
    v = [flat[base + (strides * torch.tensor(o, device=base.device)).sum()] for o in _CORNERS]
    fx, fy, fz = f.unbind(-1)
    # interpolate along z, then y, then x, keeping the differences for the gradient
    z00, z01, z10, z11 = (v[2 * i] + fz * (v[2 * i + 1] - v[2 * i]) for i in range(4))
    d00, d01, d10, d11 = (v[2 * i + 1] - v[2 * i] for i in range(4))
    y0, y1 = z00 + fy * (z01 - z00), z10 + fy * (z11 - z10)
    gx = y1 - y0
    gy = (z01 - z00) + fx * ((z11 - z10) - (z01 - z00))
    dz0, dz1 = d00 + fy * (d01 - d00), d10 + fy * (d11 - d10)
    gz = dz0 + fx * (dz1 - dz0)
    gradient = torch.stack([gx, gy, gz], -1) / cell
    away = beyond.norm(dim=-1)
    out = away > 0
    gradient = torch.where(out[:, None], beyond / away.clamp_min(1e-12)[:, None], gradient)
    return y0 + fx * gx + away, gradient


def interpolated(
    values: Float[Tensor, "x y z"], low: Float[Tensor, "3"], cell: float, points: Float[Tensor, "n 3"]
) -> Float[Tensor, "n"]:
    """The values of `sampled`, differentiable once."""
    shape = torch.tensor(values.shape, dtype=points.dtype, device=points.device)
    unit = (points - low) / cell / (shape - 1) * 2 - 1
    inside = unit.clamp(-1, 1)
    beyond = (unit - inside) * (shape - 1) * (0.5 * cell)
    sampled = trilinear(values[None], inside)[:, 0]
    # the square root's slope at zero is infinite; a hundredth of a millimetre hides it
    return sampled + (beyond.square().sum(-1) + 1e-10).sqrt() - 1e-5


_CORNERS = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]


def template_grid(
    cloud: SurfaceCloud, low: Float[Array, "3"], high: Float[Array, "3"], cell: float,
    closed: tuple[CaptureSubject, float] | None = None,
) -> TemplateGrid:  # fmt: skip
    """Distances to the template on a grid of cells of so many metres, as a tensor."""
    grid = distance_grid(cloud, low, high, cell, closed)
    return TemplateGrid(torch.from_numpy(grid.values), torch.from_numpy(grid.low), cell)
