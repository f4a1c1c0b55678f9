"""Appearance composition: the parts take on the body video's light (TotalSelfScan, 3.3, Eq. 8)."""

import torch
from jaxtyping import Float
from torch import Tensor

from train.fused import FusedField
from train.objective import directions_at
from train.preset import Preset
from train.rays import RayTensors
from train.render import crossing
from train.union import in_overlap

BATCH = 1024  # points
MOST_RAYS = 6000


@torch.no_grad()
def overlap_rays(fused: FusedField, index: int, rays: RayTensors) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"]]:
    """R of Eq. 8: where rays of the body's video, all frames, meet the surface in the body's overlap with a part.

    Points and unit directions are canonical, each ray's direction turned by the skin where it meets the surface.
    At most MOST_RAYS are tried, spread evenly over the frames.
    """
    on = (rays.mask > 0.5).nonzero()[:, 0]
    middle = rays.ends[on, rays.ends.shape[1] // 2]
    # a ray's ends lie within centimetres of each other, the weight falls over at least 5: this misses few
    on = on[in_overlap(fused.shares(middle), index)]
    on = on[:: -(-len(on) // MOST_RAYS) or 1]
    ends = rays.ends[on]
    distance = fused.distance(ends.reshape(-1, 3)).view(ends.shape[:2])
    enters = (distance[:, :-1] > 0) & (distance[:, 1:] <= 0)
    section = enters.int().argmax(1, keepdim=True)  # the first that enters
    points = crossing(distance, ends).gather(1, section[..., None].expand(-1, -1, 3))[:, 0]
    directions = directions_at(rays, on, rays.row[on].gather(1, section))[:, 0]
    hit = enters.any(1) & in_overlap(fused.shares(points), index)
    return points[hit], torch.nn.functional.normalize(directions[hit], dim=1)


def match_appearance(
    field: FusedField, index: int, points: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"], preset: Preset,
    seed: int,
) -> tuple[float, float]:  # fmt: skip
    """Eq. 8: the code of part `index` for which it shows the overlap as the body does.

        min over l of |C_body(x, d, l_body) - C_part(x, d, l)|

    `points` lie on the surface inside the overlap and `directions` are those that the body's video saw them from
    (`overlap_rays`); there C is the color, of the body with its mean code. The code starts at the mean of the part's
    trained codes and is pulled towards it: the color network
    has only seen codes near there. Sets the part's reference code; returns the difference before and after.
    """
    part = field.field(index)
    start = part.reference.clone()
    spread = part.appearance.weight.detach().std(0, unbiased=False).clamp_min(1e-3)
    target = field.part_color(0, points, directions)
    code = start.clone().requires_grad_()
    optimiser = torch.optim.Adam([code], lr=preset.appearance_rate)
    generator = torch.Generator().manual_seed(seed)

    def difference(code: Tensor) -> float:
        return float((field.part_color(index, points, directions, code.detach()) - target).abs().mean())

    before = difference(start)
    count = preset.appearance_steps
    for step in range(count):
        optimiser.param_groups[0]["lr"] = preset.appearance_rate * preset.appearance_last_rate ** (step / count)
        chosen = torch.randint(len(points), (min(BATCH, len(points)),), generator=generator).to(points.device)
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
