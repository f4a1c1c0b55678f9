"""The weights of the parts where two of them overlap (TotalSelfScan, 3.3, Eq. 9)."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from capture.template.parts import Part


def part_weight(points: Float[Tensor, "n 3"], part: Part) -> Float[Tensor, "n"]:
    """Eq. 9's share of a part: d / d_s with d the depth inside its box, 0 outside, 1 from d_s on."""
    assert part.blend_box is not None
    low = torch.as_tensor(part.blend_box.low, dtype=points.dtype, device=points.device)
    high = torch.as_tensor(part.blend_box.high, dtype=points.dtype, device=points.device)
    depth = torch.minimum(points - low, high - points).amin(-1)
    return (depth / part.overlap).clamp(0, 1)


def eq9_shares(points: Float[Tensor, "n 3"], parts: Sequence[Part]) -> Float[Tensor, "n p"]:
    """Eq. 9: weight of each of the parts, the body first, at canonical points; rows sum to 1."""
    weights = [part_weight(points, part) for part in parts[1:]]
    rest = torch.ones(len(points), dtype=points.dtype, device=points.device)
    for weight in weights:
        rest = rest - weight
    return torch.stack([rest, *weights], -1)
