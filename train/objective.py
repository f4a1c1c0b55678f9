"""What one training step minimises: Eq. 10 of TotalSelfScan, section 3.4, over a batch of rays."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from train.deform import canonical_directions
from train.field import PartField, unit_normals
from train.loss import color_loss, displacement_loss, eikonal_loss, mask_loss
from train.preset import PartPreset, Preset
from train.rays import TrainingRays
from train.render import crossing, jittered, section_weights
from train.template import SurfaceCloud

# another term of the loss: takes canonical points (n, 3) and F_s there (n), the latter with its graph
Extra = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class RayTensors:
    """TrainingRays on the training device."""

    ends: Float[Tensor, "rays ends 3"]
    row: Int[Tensor, "rays ends"]
    direction: Float[Tensor, "rays 3"]
    frame: Int[Tensor, "rays"]
    color: Float[Tensor, "rays 3"]
    mask: Float[Tensor, "rays"]
    bones: Float[Tensor, "frames 52 4"] | None
    joints: Int[Tensor, "samples 4"]  # of the template samples, heaviest bone first
    weights: Float[Tensor, "samples 4"]


def ray_tensors(rays: TrainingRays, cloud: SurfaceCloud, device: torch.device) -> RayTensors:
    """The rays, ready for training."""
    put = lambda array: torch.as_tensor(np.ascontiguousarray(array)).to(device)
    return RayTensors(put(rays.ends), put(rays.row), put(rays.direction), put(rays.frame).long(), put(rays.color),
                      put(rays.mask), None if rays.bones is None else put(rays.bones),
                      put(cloud.skin.joints).long(), put(cloud.skin.weights))  # fmt: skip


def beta_at(iteration: int, part: PartPreset, preset: Preset) -> float:
    """Width of the surface: exponential from the first to the last value, then constant."""
    share = min(iteration / max(preset.beta_until * part.iterations, 1), 1.0)
    return part.beta[0] * (part.beta[1] / part.beta[0]) ** share


def directions_at(
    rays: RayTensors, chosen: Int[Tensor, "b"], row: Int[Tensor, "b k"]
) -> Float[Tensor, "b k 3"]:
    """View directions in the canonical frame at sections of the chosen rays; `row` is the sample each follows."""
    direction = rays.direction[chosen][:, None].expand(*row.shape, 3)
    if rays.bones is None:
        return direction
    quaternions = rays.bones[rays.frame[chosen][:, None, None], rays.joints[row]]
    turned = canonical_directions(
        direction.reshape(-1, 3), rays.weights[row].reshape(-1, 4), quaternions.reshape(-1, 4, 4)
    )
    return turned.view(*row.shape, 3)


@dataclass(frozen=True)
class StepReport:
    """Numbers of one step, for the log."""

    loss: float
    color: float  # mean absolute difference
    psnr: float  # dB, of the rays on the person
    slope: float  # mean |grad F_s|
    displacement: float  # mean |T_nr|, metres
    saturated: float  # share of shaded points whose correction is beyond 5 cm


def losses(
    field: PartField, rays: RayTensors, chosen: Int[Tensor, "b"], u: Float[Tensor, "b"], beta: float,
    part: PartPreset, preset: Preset, *, extra: Extra | None = None,
) -> tuple[Float[Tensor, ""], Callable[[], StepReport]]:  # fmt: skip
    """Eq. 10 over a batch of rays; with `extra` (L_g, Eq. 7) it is Eq. 13.

    F_s is evaluated at all section ends (values only). Normal, Eikonal and colour are evaluated in the
    `shaded` sections with the largest weights; their colours are scaled to the opacity of the whole ray.
    """
    ends = jittered(rays.ends[chosen], u)
    batch, count, _ = ends.shape
    frame = rays.frame[chosen]

    # T_nr (Eq. 3, 4) is smooth on the scale of a section: evaluate some ends, interpolate the others
    knots = torch.arange(0, count, preset.displaced_every, device=ends.device)
    unit = field.unit(ends[:, knots].reshape(-1, 3))
    moved = field.displacement(unit, frame.repeat_interleave(len(knots))).view(batch, len(knots), 3)
    place = torch.arange(count, device=ends.device) / preset.displaced_every
    left = place.floor().long().clamp_max(max(len(knots) - 2, 0))
    right = (left + 1).clamp_max(len(knots) - 1)
    ends = ends + torch.lerp(moved[:, left], moved[:, right], (place - left)[None, :, None])

    distance = field(ends.reshape(-1, 3)).distance.view(batch, count)
    rendered = section_weights(distance, beta)
    opacity = -torch.expm1(rendered.log_transmittance)

    top, section = rendered.weights.topk(min(preset.shaded, count - 1), dim=1)
    places = crossing(distance.detach(), ends)
    points = places.gather(1, section[..., None].expand(-1, -1, 3)).reshape(-1, 3)
    sample, gradient = field.with_gradient(points, create_graph=True)
    directions = directions_at(rays, chosen, rays.row[chosen].gather(1, section)).reshape(-1, 3)
    code = field.codes(frame.repeat_interleave(section.shape[1]))
    color = field.color(points, sample.feature, unit_normals(gradient), directions, code)
    color = color.view(batch, -1, 3)
    share = top / (top.sum(1, keepdim=True) + 1e-8)
    shown = (share[..., None] * color).sum(1) * opacity[:, None]

    observed, mask = rays.color[chosen], rays.mask[chosen]
    L_rgb = color_loss(shown, observed)
    L_nr = displacement_loss(moved.reshape(-1, 3))
    loss = (
        L_rgb
        + preset.mask_weight * mask_loss(rendered.log_transmittance, mask)
        + preset.eikonal_weight * eikonal_loss(gradient)
        + part.displacement_weight * L_nr
    )
    if extra is not None:
        loss = loss + extra(ends.reshape(-1, 3), distance.reshape(-1))

    def report() -> StepReport:
        on = mask > 0.5
        error = (shown - observed)[on].square().mean() if on.any() else torch.tensor(1.0)
        far = (sample.distance - field.template.sample(points.detach())[0]).abs() > 0.05
        return StepReport(
            loss.item(),
            L_rgb.item(),
            -10 * math.log10(max(error.item(), 1e-10)),
            gradient.norm(dim=-1).mean().item(),
            L_nr.item(),
            far.float().mean().item(),
        )

    return loss, report
