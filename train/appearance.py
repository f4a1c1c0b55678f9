"""Appearance composition: the parts take on the body video's light (TotalSelfScan, 3.3, Eq. 8)."""

import torch
from jaxtyping import Float
from torch import Tensor

from train.fused import FusedField


def match_appearance(
    field: FusedField,
    index: int,
    points: Float[Tensor, "n 3"],
    directions: Float[Tensor, "n 3"],
    *,
    steps: int,
    rate: float = 1e-2,
    batch: int = 1024,
    seed: int = 0,
) -> tuple[float, float]:
    """Eq. 8: the code of part `index` for which it shows the overlap as the body does.

        min over l of |C_body(x, d, l_body) - C_part(x, d, l)|

    `points` lie on the surface inside the overlap and `directions` are the ones they were seen from, over all
    frames. The code starts at the mean of the part's trained codes and is pulled towards it: the colour network
    has only seen codes near there. Sets the part's reference code; returns the difference before and after.
    """
    part = field.field(index)
    start = part.reference.clone()
    spread = part.appearance.weight.detach().std(0).clamp_min(1e-3)
    target = field.part_color(0, points, directions)
    code = start.clone().requires_grad_()
    optimiser = torch.optim.Adam([code], lr=rate)
    generator = torch.Generator().manual_seed(seed)

    def difference(code: Tensor) -> float:
        return float((field.part_color(index, points, directions, code.detach()) - target).abs().mean())

    before = difference(start)
    for _ in range(steps):
        chosen = torch.randint(len(points), (min(batch, len(points)),), generator=generator)
        shown = field.part_color(index, points[chosen], directions[chosen], code)
        loss = (shown - target[chosen]).abs().mean() + 1e-3 * ((code - start) / spread).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    after = difference(code)
    if after < before:
        part.reference.copy_(code.detach())
        return before, after
    return before, before
