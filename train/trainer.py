"""The loop of stage 1 (TotalSelfScan, section 3.4): one part learns its field from its video."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import torch

from avatar.errors import AssetError
from avatar.files import whole_file
from train.field import PartField
from train.networks.triplane import TriPlane
from train.objective import Extra, RayTensors, StepReport, beta_at, losses
from train.preset import PartPreset, Preset


def rate_at(iteration: int, part: PartPreset, preset: Preset) -> float:
    """Learning rate against its first value: linear warm-up, exponential decay."""
    warm = min((iteration + 1) / max(preset.warm_up, 1), 1.0)
    return warm * preset.last_rate ** (iteration / part.iterations)


def optimiser_of(field: PartField, preset: Preset) -> torch.optim.Adam:
    """Adam, one rate each for grids, displacement and the rest; no weight decay, cells never seen stay as they are."""
    grids = [m.planes for m in field.modules() if isinstance(m, TriPlane)]
    moves = list(field.displacement.parameters())
    taken = {id(p) for p in grids + moves}
    others = [p for p in field.parameters() if id(p) not in taken]
    groups = [
        {"params": grids, "lr": preset.grid_rate},
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
    extra: Extra | None = None,
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
            loss, describe = losses(
                field, rays, chosen, u, beta_at(iteration, part, preset), part, preset, extra=extra
            )
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
