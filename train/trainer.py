"""The loop of stage 1 (TotalSelfScan, section 3.4): one part learns its field from its video."""

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path

import torch

from avatar.interrupt import Stopped, deferred_stop
from train.checkpoint import Position, load_checkpoint, save_checkpoint
from train.distributed import ONE_PROCESS, Ranks
from train.field import PartField
from train.log import TrainingLog
from train.networks.hash import HashGrid, open_levels
from train.networks.triplane import TriPlane
from train.objective import Batch, Extra, RayTensors, StepReport, beta_at, choose_rays, losses, rho_at
from train.preset import PartPreset, Preset
from train.preview import Preview

REPORT_EVERY = 10  # steps between rows of the log


def rate_at(iteration: int, part: PartPreset, preset: Preset) -> float:
    """Learning rate against its first value: linear warm-up, exponential decay."""
    warm = min((iteration + 1) / max(preset.warm_up, 1), 1.0)
    return warm * preset.last_rate ** (iteration / part.iterations)


def optimiser_of(field: PartField, preset: Preset) -> torch.optim.Adam:
    """Adam, one rate each for grids, displacement and the rest; no weight decay, cells never seen stay as they are."""
    grids = [table for module in field.modules() if isinstance(module, TriPlane | HashGrid)
             for table in module.parameters(recurse=False)]  # fmt: skip
    moves = list(field.displacement.parameters())
    poses = [] if field.poses is None else list(field.poses.parameters())
    taken = {id(p) for p in grids + moves + poses}
    others = [p for p in field.parameters() if id(p) not in taken]
    groups = [
        {"params": grids, "lr": preset.grid_rate},
        {"params": moves, "lr": preset.displacement_rate},
        {"params": others, "lr": preset.network_rate},
    ]
    if field.poses is not None:
        rate = preset.pose_rate * field.poses.pixel
        groups.append({"params": poses, "lr": rate, "begin": preset.pose_begin, "betas": (0.99, 0.999)})
    first, second, epsilon = preset.adam
    return torch.optim.Adam(groups, betas=(first, second), eps=epsilon, fused=True)


@dataclass(frozen=True, kw_only=True)
class FieldTraining:
    """What one field learns by."""

    part: PartPreset
    preset: Preset
    seed: int
    # stage 2's term L_g (Eq. 7)
    extra: Extra | None = None
    ranks: Ranks = ONE_PROCESS


@dataclass(frozen=True, kw_only=True)
class Checkpoints:
    """Where a training is kept, so that it can go on."""

    # None: nowhere
    path: Path | None = None
    # go on from the file, where there is one
    resume: bool = False
    every: float = 120.0  # seconds
    # steps after which training stops as if asked to
    stop_after: int | None = None


@dataclass(frozen=True, kw_only=True)
class Watch:
    """Who is shown how training goes."""

    # takes the step and its numbers
    report: Callable[[int, StepReport], None] | None = None
    log: TrainingLog | None = None
    preview: Preview | None = None


UNSAVED, UNWATCHED = Checkpoints(), Watch()


def train_field(
    field: PartField, rays: RayTensors, training: FieldTraining, *, checkpoints: Checkpoints = UNSAVED,
    watch: Watch = UNWATCHED, at: Position | None = None,
) -> int:  # fmt: skip
    """Train a field in place; returns the number of steps skipped because they were not finite.

    A step whose loss or gradient is not finite changes nothing and is counted; more than 1 % of such steps is
    an error. A checkpoint (weights, optimiser, random state) is written every so many seconds, at the end,
    after `stop_after` steps, and at Ctrl-C or SIGTERM, which then raise `Stopped`; resuming from it equals never
    having stopped, bit for bit on one thread. `at` counts the steps for the caller.
    """
    part, preset, ranks, extra = training.part, training.preset, training.ranks, training.extra
    log, preview, report = watch.log, watch.preview, watch.report
    modules = {"field": field}
    optimiser = optimiser_of(field, preset)
    first_rates = [group["lr"] for group in optimiser.param_groups]
    parameters = [p for group in optimiser.param_groups for p in group["params"]]
    generator = torch.Generator(device="cpu").manual_seed(training.seed)
    at = Position() if at is None else at
    if checkpoints.resume and checkpoints.path is not None and checkpoints.path.exists():
        load_checkpoint(checkpoints.path, modules, optimiser, generator, at)
    if log is not None:
        log.begin(at.iteration)
    device, weight = rays.ends.device, ranks.weight(preset.rays)
    frame_counts = torch.bincount(rays.frame).cpu()
    began = time.monotonic() - at.seconds
    saved = time.monotonic()

    def save() -> None:
        at.seconds = time.monotonic() - began
        if checkpoints.path is not None and ranks.writes:
            save_checkpoint(checkpoints.path, modules, optimiser, generator, at)

    with deferred_stop() as stop, flushed_denormals():
        while at.iteration < part.iterations:
            # stage 2 stays where the ladders ended
            rung = at.iteration if extra is None else part.iterations
            scale, beta = rate_at(at.iteration, part, preset), beta_at(rung, part, preset)
            for group, rate in zip(optimiser.param_groups, first_rates):
                waits = at.iteration < group.get("begin", 0.0) * part.iterations
                group["lr"] = 0.0 if waits else rate * scale
            open_levels(field, rung / part.iterations)
            chosen = choose_rays(frame_counts, preset, generator)
            u = torch.rand(preset.rays, generator=generator)
            chosen, u = ranks.share(chosen).to(device), ranks.share(u).to(device)
            batch = Batch(chosen, u, beta, rho_at(rung, part))
            loss, describe = losses(field, rays, batch, part, preset, extra=extra)
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            loss, stopping = ranks.combine(parameters, weight, loss, stop.asked)
            norm = torch.nn.utils.clip_grad_norm_(parameters, preset.clip)
            if torch.isfinite(loss) and torch.isfinite(norm):
                optimiser.step()
            else:
                at.skipped += 1
                if at.skipped > max(0.01 * part.iterations, 1):
                    raise FloatingPointError(f"{at.skipped} of {at.iteration + 1} steps were not finite, more than 1 %")
            at.iteration += 1
            last = at.iteration == part.iterations
            if (log is not None or report is not None) and (at.iteration % REPORT_EVERY == 0 or last):
                step = StepReport(*ranks.mean(astuple(describe()), weight, device))
                if log is not None and ranks.writes:
                    log.row(at.iteration, time.monotonic() - began, scale, vars(step))
                if report is not None:
                    report(at.iteration, step)
            if preview is not None and (at.iteration % preview.every == 0 or last):
                image = preview.draw(field, beta, preset)
                if log is not None:
                    log.image(at.iteration, image)
            if stopping or at.iteration == checkpoints.stop_after:
                save()
                if stopping:
                    raise Stopped(stop.number or signal.SIGTERM)
                return at.skipped
            if time.monotonic() - saved > checkpoints.every:
                save()
                saved = time.monotonic()
        with torch.no_grad():
            field.reference.copy_(field.appearance.weight.mean(0))
            field.displacement.settle()
        save()
    # after the last step: all is saved, but the caller goes no further
    if stop.number is not None:
        raise Stopped(stop.number)
    return at.skipped


@contextmanager
def flushed_denormals() -> Iterator[None]:
    """Denormals are zero inside: softplus(100 x) makes them by the million, and each costs a hundred cycles.

    Never outside: a k-d tree splits beside equal points at the next float, and beside 0 that is a denormal; flushed,
    the tree never ends.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def peak_memory(device: str) -> int | None:
    """Most memory that this process (or, on CUDA, its tensors) ever held, bytes; None where it cannot be asked."""
    if device.startswith("cuda"):
        return torch.cuda.max_memory_allocated(device)
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
