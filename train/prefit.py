"""The start of a geometry network that knows nothing of the template: it learns the template's distance first."""

import torch
from jaxtyping import Float
from torch import Tensor

from train.field import PartField

COUNT, RATE = 2048, 5e-4  # points of a step; of Adam, a tenth in the end


def fit_template(field: PartField, steps: int, *, seed: int) -> float:
    """Fit F_s to the template's signed distance, mean |F_s - template|; returns the last step's, metres.

    Half of the points of a step lie anywhere in the part's box, half are the ones of as many again that lie
    closest to the template. Without this start, volume rendering of a sphere finds no person in time.
    """
    optimiser = torch.optim.Adam(field.geometry.parameters(), lr=RATE)
    generator = torch.Generator().manual_seed(seed)
    last = float("nan")
    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = RATE * 0.1 ** (step / steps)
        places = _points(field, generator)
        with torch.no_grad():
            wanted, _ = field.template.sample(places)
        loss = (field(places).distance - wanted).abs().mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        last = loss.detach()
    return float(last)


def _points(field: PartField, generator: torch.Generator) -> Float[Tensor, "count 3"]:
    share = torch.rand(5 * COUNT // 2, 3, generator=generator).to(field.low.device)
    points = field.low + share * (field.high - field.low)
    anywhere, others = points[: COUNT // 2], points[COUNT // 2 :]
    with torch.no_grad():
        near = field.template(others).abs().topk(COUNT - COUNT // 2, largest=False).indices
    return torch.cat([anywhere, others[near]])
