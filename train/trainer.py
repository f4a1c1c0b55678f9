"""Stage 1 of TotalSelfScan, section 3.4: one part learns its field from its video."""

import math
import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from avatar.errors import AssetError
from avatar.files import whole_file
from train.deform import canonical_directions
from train.field import PartField, unit_normals
from train.loss import color_loss, displacement_loss, eikonal_loss, mask_loss
from train.preset import PartPreset, Preset
from train.rays import TrainingRays
from train.render import crossing, jittered, section_weights
from train.template import SurfaceCloud

Array = np.ndarray


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


def rate_at(iteration: int, part: PartPreset, preset: Preset) -> float:
    """Learning rate against its first value: linear warm-up, exponential decay."""
    warm = min((iteration + 1) / max(preset.warm_up, 1), 1.0)
    return warm * preset.last_rate ** (iteration / part.iterations)


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
    part: PartPreset, preset: Preset,
) -> tuple[Float[Tensor, ""], Callable[[], StepReport]]:  # fmt: skip
    """Eq. 10 over a batch of rays.

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


def optimiser_of(field: PartField, preset: Preset) -> torch.optim.Adam:
    """Adam, one rate each for planes, displacement and the rest; no weight decay, cells never seen stay as they are."""
    planes = [field.planes.planes, field.color_planes.planes]
    moves = list(field.displacement.parameters())
    taken = {id(p) for p in planes + moves}
    others = [p for p in field.parameters() if id(p) not in taken]
    groups = [
        {"params": planes, "lr": preset.plane_rate},
        {"params": moves, "lr": preset.displacement_rate},
        {"params": others, "lr": preset.network_rate},
    ]
    return torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)


def train_field(
    field: PartField,
    rays: RayTensors,
    part: PartPreset,
    preset: Preset,
    *,
    seed: int,
    checkpoint: Path | None = None,
    resume: bool = False,
    stop_after: int | None = None,
    report: Callable[[int, StepReport], None] | None = None,
) -> int:
    """Train a field in place; returns the number of steps skipped because they were not finite.

    A step whose loss or gradient is not finite changes nothing and is counted; more than 1 % of such steps is
    an error. Ctrl-C and `stop_after` write `checkpoint` (weights, optimiser, random state) and stop; resuming
    from it equals never having stopped, bit for bit on one thread.
    """
    optimiser = optimiser_of(field, preset)
    first_rates = [group["lr"] for group in optimiser.param_groups]
    generator = torch.Generator(device="cpu").manual_seed(seed)
    iteration = skipped = 0
    if resume and checkpoint is not None and checkpoint.exists():
        iteration, skipped = _load_checkpoint(checkpoint, field, optimiser, generator)

    asked_to_stop = []
    previous = _on_interrupt(lambda: asked_to_stop.append(True))
    parameters = [p for group in optimiser.param_groups for p in group["params"]]
    device = rays.ends.device
    try:
        while iteration < part.iterations:
            scale = rate_at(iteration, part, preset)
            for group, rate in zip(optimiser.param_groups, first_rates):
                group["lr"] = rate * scale
            chosen = torch.randint(len(rays.ends), (preset.rays,), generator=generator).to(device)
            u = torch.rand(preset.rays, generator=generator).to(device)
            loss, describe = losses(field, rays, chosen, u, beta_at(iteration, part, preset), part, preset)
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            norm = torch.nn.utils.clip_grad_norm_(parameters, preset.clip)
            if torch.isfinite(loss) and torch.isfinite(norm):
                optimiser.step()
            else:
                skipped += 1
                if skipped > max(0.01 * part.iterations, 1):
                    raise FloatingPointError(
                        f"{skipped} of {iteration + 1} steps were not finite, more than 1 %"
                    )
            iteration += 1
            if report is not None and (iteration % 50 == 0 or iteration == part.iterations):
                report(iteration, describe())
            if asked_to_stop or iteration == stop_after:
                if checkpoint is not None:
                    _save_checkpoint(checkpoint, field, optimiser, generator, iteration, skipped)
                if asked_to_stop:
                    raise KeyboardInterrupt
                return skipped
    finally:
        if previous is not None:
            signal.signal(signal.SIGINT, previous)
    with torch.no_grad():
        field.reference.copy_(field.appearance.weight.mean(0))
        field.displacement.settle()
    if checkpoint is not None:
        _save_checkpoint(checkpoint, field, optimiser, generator, iteration, skipped)
    return skipped


def _on_interrupt(act: Callable[[], None]):
    """Run `act` at Ctrl-C instead of raising in the middle of a step; a second Ctrl-C raises."""

    def handler(number, frame):
        act()
        signal.signal(signal.SIGINT, signal.default_int_handler)

    try:
        return signal.signal(signal.SIGINT, handler)
    except ValueError:  # not the main thread: the caller's handler stays
        return None


def _save_checkpoint(path: Path, field, optimiser, generator, iteration: int, skipped: int) -> None:
    state = {
        "field": field.state_dict(),
        "optimiser": optimiser.state_dict(),
        "generator": generator.get_state(),
        "iteration": iteration,
        "skipped": skipped,
    }
    with whole_file(path) as file:
        torch.save(state, file)


def _load_checkpoint(path: Path, field, optimiser, generator) -> tuple[int, int]:
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        field.load_state_dict(state["field"])
        optimiser.load_state_dict(state["optimiser"])
        generator.set_state(state["generator"])
        return int(state["iteration"]), int(state["skipped"])
    except (OSError, KeyError, RuntimeError, ValueError, EOFError) as error:
        raise AssetError(
            f"{path}: expected a checkpoint of this training, found: {str(error)[:200]}"
        ) from None


def set_threads(count: int) -> None:
    """Threads of torch, and denormals flushed to zero: softplus(100 x) makes them by the million."""
    torch.set_flush_denormal(True)
    torch.set_num_threads(count)


def cpu_seconds() -> tuple[float, float]:
    """Wall and process CPU seconds, for the time table."""
    times = os.times()
    return time.monotonic(), times.user + times.system
