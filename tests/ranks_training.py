"""A dozen steps of one small field in float64, by as many processes as torchrun starts; rank 0 writes the weights.

usage: python tests/ranks_training.py OUT.pt, the project and tests/ on PYTHONPATH
"""

import sys
from dataclasses import replace

import torch

from train.distributed import join_ranks, leave_ranks
from train.field import PartField
from train.networks.triplane import TriPlaneNetworks
from train.preset import DEMO
from train.rays import RayTensors
from train.template_grid import TemplateGrid
from train.trainer import FieldTraining, Watch, train_field

STEPS, RAYS = 12, 63  # an odd batch: shares of 32 and 31


def small_field() -> PartField:
    """A ball of 10 cm as the template, planes of 8 texels."""
    torch.manual_seed(1)
    axis = torch.arange(9) * 0.05 - 0.2
    grid = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).norm(dim=-1) - 0.1
    low, high = torch.full((3,), -0.2), torch.full((3,), 0.2)
    networks = TriPlaneNetworks(plane_size=8, color_size=8).build(2, 0.5 * (high - low), 0.01)
    return PartField(TemplateGrid(grid, low, 0.05), low, high, networks)


def small_rays() -> RayTensors:
    """500 rays through the ball, along z, half of them of each frame; painted by their place."""
    generator = torch.Generator().manual_seed(2)
    place = (torch.rand(500, 2, generator=generator) - 0.5) * 0.3
    z = torch.linspace(0.15, -0.15, DEMO.sections + 2)
    ends = torch.cat([place[:, None].expand(-1, len(z), 2), z[None, :, None].expand(500, -1, 1)], 2)
    mask = place.norm(dim=1) < 0.11
    color = mask[:, None] * (0.5 + 0.4 * torch.sin(20 * torch.cat([place, place[:, :1]], 1)))
    return RayTensors(
        ends, torch.zeros(ends.shape[:2], dtype=torch.long), torch.tensor([[0, 0, -1.0]]).expand(500, 3),
        torch.arange(500) // 250, color, mask, None, torch.zeros(1, 4, dtype=torch.long), torch.ones(1, 4),
    )  # fmt: skip


def main(out: str) -> None:
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    ranks, _ = join_ranks("cpu")
    part = replace(DEMO.parts[0], iterations=STEPS)
    preset = replace(DEMO, rays=RAYS, warm_up=2)
    field, losses = small_field(), []
    before = {name: value.clone() for name, value in field.state_dict().items()}
    training = FieldTraining(part=part, preset=preset, seed=3, ranks=ranks)
    train_field(field, small_rays(), training, watch=Watch(report=lambda i, step: losses.append(step.loss)))
    if ranks.writes:
        torch.save({"before": before, "after": field.state_dict(), "loss": losses[-1], "count": ranks.count}, out)
    leave_ranks()


if __name__ == "__main__":
    main(sys.argv[1])
