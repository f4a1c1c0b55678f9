"""What one training step minimises: Eq. 10 of TotalSelfScan, section 3.4, over a batch of rays."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatar.psnr import decibels
from train.deform import canonical_directions, posed_directions
from train.field import FieldSample, PartField, unit_normals
from train.light import LightTensors
from train.loss import color_loss, color_norm_loss, displacement_loss, eikonal_loss, mask_logit_loss, mask_loss
from train.preset import PartPreset, Preset
from train.rays import RayTensors
from train.render import crossing, density_weights, jittered, section_lengths, section_weights

# another term of the loss: takes canonical points (n, 3) and F_s there (n), the latter with its graph
Extra = Callable[[Tensor, Tensor], Tensor]


def beta_at(iteration: int, part: PartPreset, preset: Preset) -> float:
    """Width of the surface: exponential from the first to the last value, then constant."""
    share = min(iteration / max(preset.beta_until * part.iterations, 1), 1.0)
    return part.beta[0] * (part.beta[1] / part.beta[0]) ** share


def rho_at(iteration: int, part: PartPreset) -> float:
    """rho of L_mask (Eq. 11): 50, doubled after every tenth of the steps, at most 1600 (the authors' ladder)."""
    return 50.0 * 2 ** min(10 * iteration // part.iterations, 5)


def choose_rays(frame_counts: Int[Tensor, "frames"], preset: Preset, generator: torch.Generator) -> Int[Tensor, "b"]:
    """Indices of a batch of rays; `frame_counts` says how many rays each frame has, which lie in order of frame."""
    if not preset.one_frame:
        return torch.randint(int(frame_counts.sum()), (preset.rays,), generator=generator)
    filled = frame_counts.nonzero()[:, 0]
    frame = filled[torch.randint(len(filled), (1,), generator=generator)]
    first, count = int(frame_counts[:frame].sum()), int(frame_counts[frame])
    return first + torch.randint(count, (preset.rays,), generator=generator)


def directions_at(rays: RayTensors, chosen: Int[Tensor, "b"], row: Int[Tensor, "b k"]) -> Float[Tensor, "b k 3"]:
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
    # the sum of the terms, weighted
    loss: float
    color: float  # L_rgb
    mask: float  # L_mask
    eikonal: float  # L_E
    displacement: float  # L_nr, mean |T_nr|, metres
    # the extra term (L_g, Eq. 7), with its weight
    extra: float
    # dB, of the rays on the person
    psnr: float
    slope: float  # mean |grad F_s|


class Batch(NamedTuple):
    """Rays of one step, and how sharply they are drawn."""

    # indices into the part's rays
    chosen: Int[Tensor, "b"]
    # in [0, 1), each ray's jitter
    u: Float[Tensor, "b"]
    beta: float  # width of the surface, metres
    # the rho of L_mask as the paper prints it
    rho: float = 50.0


def section_colors(
    field: "FieldFunctions", rays: RayTensors, chosen: Int[Tensor, "b"], section: Int[Tensor, "b k"],
    points: Float[Tensor, "n 3"], sample: FieldSample, gradient: Float[Tensor, "n 3"],
) -> Float[Tensor, "b k 3"]:  # fmt: skip
    """What sections show at their points (b k of them), F_s and its gradient given: F_c itself, or, where the light is
    a factor, albedo lit at the posed normal.

    The lit normal is fixed here: how bright a pixel is moves no surface, which masks and texture place better.
    """
    frame, row = rays.frame[chosen], rays.row[chosen].gather(1, section)
    directions = directions_at(rays, chosen, row).reshape(-1, 3)
    of_section = frame.repeat_interleave(section.shape[1])
    color = field.color(points, sample.feature, unit_normals(gradient), directions, of_section).view(*section.shape, 3)
    if field.light is None or field.light_normal is None:
        return color
    normals = field.light_normal(points, gradient)
    if rays.bones is not None:
        quaternions = rays.bones[frame[:, None, None], rays.joints[row]]
        normals = posed_directions(normals, rays.weights[row].reshape(-1, 4), quaternions.reshape(-1, 4, 4))
    return field.light.lit(color, normals.view(*section.shape, 3), -rays.direction[chosen], frame)


class FieldFunctions(NamedTuple):
    """What volume rendering asks of a field, in the part's canonical frame; b rays or n points."""

    # T_nr(points, frames), metres
    displacement: Callable[[Tensor, Tensor], Tensor]
    # F_s(points), metres
    distance: Callable[[Tensor], Tensor]
    # as PartField.with_gradient
    gradient: Callable[..., tuple[FieldSample, Tensor]]
    # F_c(points, features, normals, directions, frames), sRGB
    color: Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]
    # section ends of rays (b, ends, 3), their frames, joints and weights, moved to the poses learned so far
    posed: Callable[[Tensor, Tensor, Tensor, Tensor], Tensor] | None = None
    # width of VolSDF's density, metres, where the geometry learns it
    density_width: Callable[[], Tensor] | None = None
    # what lights F_c, where it is albedo, and the normals it falls on (points, grad F_s)
    light: LightTensors | None = None
    light_normal: Callable[[Tensor, Tensor], Tensor] | None = None


def functions_of(field: PartField) -> FieldFunctions:
    """A part's field as volume rendering asks it."""

    def color(points: Tensor, feature: Tensor, normals: Tensor, directions: Tensor, frame: Tensor) -> Tensor:
        return field.color(points, feature, normals, directions, field.codes(frame))

    return FieldFunctions(
        displacement=lambda points, frame: field.displacement(field.unit(points), frame),
        distance=lambda points: field(points).distance,
        gradient=field.with_gradient,
        color=color,
        posed=field.poses,
        density_width=field.geometry.density_width,
        light=field.light,
        light_normal=field.light_normal,
    )


class Rendered(NamedTuple):
    """A batch of rays drawn through the field, with what the losses ask of it."""

    color: Float[Tensor, "b 3"]  # on black
    # opacity = 1 - exp of it
    log_transmittance: Float[Tensor, "b"]
    ends: Float[Tensor, "b ends 3"]  # canonical, after T_nr
    distance: Float[Tensor, "b ends"]  # F_s there
    # grad F_s at the points that were given a color, b k of them
    gradient: Float[Tensor, "n 3"]
    # T_nr where it was evaluated
    displacement: Float[Tensor, "m 3"]


def render_rays(
    field: FieldFunctions, rays: RayTensors, batch: Batch, preset: Preset, *, create_graph: bool = True
) -> Rendered:
    """Volume rendering of a batch of rays (Eq. 1-4).

    With VolSDF's density F_s, normal and color are evaluated once, where each section begins, and the density's width
    is the geometry's own. With NeuS's, F_s is evaluated at all section ends (values only). Normal, Eikonal and color
    are evaluated in the `shaded` sections with the largest weights; their colors are scaled to the opacity of the
    whole ray.
    """
    chosen = batch.chosen
    frame, ends = rays.frame[chosen], rays.ends[chosen]
    if field.posed is not None:
        row = rays.row[chosen]
        ends = field.posed(ends, frame, rays.joints[row], rays.weights[row])
    ends = jittered(ends, batch.u)
    size, count, _ = ends.shape

    # T_nr (Eq. 3, 4) is smooth on the scale of a section: evaluate some ends, interpolate the others
    knots = torch.arange(0, count, preset.displaced_every, device=ends.device)
    moved = field.displacement(ends[:, knots].reshape(-1, 3), frame.repeat_interleave(len(knots)))
    moved = moved.view(size, len(knots), 3)
    place = torch.arange(count, device=ends.device) / preset.displaced_every
    left = place.floor().long().clamp_max(max(len(knots) - 2, 0))
    right = (left + 1).clamp_max(len(knots) - 1)
    lengths = section_lengths(ends)
    ends = ends + torch.lerp(moved[:, left], moved[:, right], (place - left)[None, :, None])
    if preset.density == "volsdf":
        return _render_density(field, rays, chosen, ends[:, :-1], lengths, moved, create_graph=create_graph)

    distance = field.distance(ends.reshape(-1, 3)).view(size, count)
    rendered = section_weights(distance, batch.beta)
    opacity = -torch.expm1(rendered.log_transmittance)

    top, section = rendered.weights.topk(min(preset.shaded, count - 1), dim=1)
    places = crossing(distance.detach(), ends)
    points = places.gather(1, section[..., None].expand(-1, -1, 3)).reshape(-1, 3)
    sample, gradient = field.gradient(points, create_graph=create_graph)
    color = section_colors(field, rays, chosen, section, points, sample, gradient)
    share = top / (top.sum(1, keepdim=True) + 1e-8)
    shown = (share[..., None] * color).sum(1) * opacity[:, None]
    return Rendered(shown, rendered.log_transmittance, ends, distance, gradient, moved.reshape(-1, 3))


def _render_density(
    field: FieldFunctions, rays: RayTensors, chosen: Int[Tensor, "b"], points: Float[Tensor, "b k 3"],
    lengths: Float[Tensor, "b k"], moved: Float[Tensor, "b knots 3"], *, create_graph: bool,
) -> Rendered:  # fmt: skip
    """Volume rendering with VolSDF's density: all sections shaded, each where it begins; gradients reach T_nr."""
    if field.density_width is None:
        raise ValueError("density volsdf needs a geometry that learns the density's width (train/networks/paper.py)")
    size, count, _ = points.shape
    flat = points.reshape(-1, 3)
    sample, gradient = field.gradient(flat, create_graph=create_graph, attached=True)
    distance = sample.distance.view(size, count)
    rendered = density_weights(distance, lengths, field.density_width())
    sections = torch.arange(count, device=points.device).expand(size, -1)
    color = section_colors(field, rays, chosen, sections, flat, sample, gradient)
    shown = (rendered.weights[..., None] * color).sum(1)
    return Rendered(shown, rendered.log_transmittance, points, distance, gradient, moved.reshape(-1, 3))


def losses(
    field: PartField, rays: RayTensors, batch: Batch, part: PartPreset, preset: Preset, *, extra: Extra | None = None
) -> tuple[Float[Tensor, ""], Callable[[], StepReport]]:
    """Eq. 10 over a batch of rays; with `extra` (L_g, Eq. 7) it is Eq. 13. Every term is a mean over the batch."""
    drawn = render_rays(functions_of(field), rays, batch, preset)
    observed, mask = rays.color[batch.chosen], rays.mask[batch.chosen]
    L_rgb = (color_norm_loss if preset.color_loss == "norm" else color_loss)(drawn.color, observed)
    if preset.mask_loss == "lowest":
        L_mask = mask_logit_loss(drawn.distance.amin(1), mask, batch.rho)
    else:
        L_mask = mask_loss(drawn.log_transmittance, mask)
    L_E = eikonal_loss(drawn.gradient)
    L_nr = displacement_loss(drawn.displacement)
    loss = L_rgb + preset.mask_weight * L_mask + preset.eikonal_weight * L_E + part.displacement_weight * L_nr
    if field.poses is not None:
        loss = loss + preset.pose_weight * field.poses.prior()
    L_extra = None if extra is None else extra(drawn.ends.reshape(-1, 3), drawn.distance.reshape(-1))
    if L_extra is not None:
        loss = loss + L_extra

    def report() -> StepReport:
        """The step's numbers, computed where they are asked for."""
        on = mask > 0.5
        error = (drawn.color - observed)[on].square().mean() if on.any() else torch.tensor(1.0)
        return StepReport(
            loss=loss.item(), color=L_rgb.item(), mask=L_mask.item(), eikonal=L_E.item(), displacement=L_nr.item(),
            extra=0.0 if L_extra is None else L_extra.item(), psnr=decibels(max(error.item(), 1e-10)),
            slope=drawn.gradient.norm(dim=-1).mean().item(),
        )  # fmt: skip

    return loss, report
