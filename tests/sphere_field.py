"""Fields whose template is a ball, and whether two fields are equal."""

from collections.abc import Mapping

import torch

from train.field import PartField
from train.networks.triplane import TriPlaneNetworks
from train.template_grid import TemplateGrid

SMALL = TriPlaneNetworks(plane_size=16, color_size=16, width=32)


def sphere_field(radius: float, moved: tuple[float, float, float] = (0, 0, 0), frames: int = 3) -> PartField:
    """F_s = |x| - radius in cells of a centimetre, and T_nr = `moved` everywhere, metres."""
    axis = torch.arange(-0.2, 0.2001, 0.01)
    grid = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1)
    half = torch.full((3,), 0.2)
    template = TemplateGrid(grid.norm(dim=-1) - radius, -half, 0.01)
    field = PartField(template, -half, half, SMALL.build(frames, half, 0.03))
    with torch.no_grad():
        field.displacement.out.bias.copy_(torch.atanh(torch.tensor(moved) / field.displacement.reach))
    field.displacement.settle()
    return field


def turned_head(scale: float) -> torch.Tensor:
    """head_from_canonical of Eq. 5: a turn by 37 degrees in a frame so many times as large."""
    c, s = 0.8, 0.6
    head_from_canonical = torch.eye(4)
    head_from_canonical[:3, :3] = scale * torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return head_from_canonical


Weights = Mapping[str, torch.Tensor]


def assert_same_bits(weights: Weights, others: Weights) -> None:
    """Each of these weights is to the last bit the one of that name among the others."""
    for name, value in weights.items():
        assert torch.equal(value, others[name]), name
