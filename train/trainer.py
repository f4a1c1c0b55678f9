"""The loop of stage 1 (TotalSelfScan, section 3.4): one part learns its field from its video."""

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from pathlib import Path

import torch

from command.interrupt import Stopped, deferred_stop
from files.input_file import unusable
from files.whole import whole_file
from train.distributed import ONE_PROCESS, Ranks
from train.field import PartField
from train.log import TrainingLog
from train.networks import FeatureGrid
from train.objective import Batch, Extra, StepReport, beta_at, choose_rays, losses, rho_at
from train.preset import PartPreset, Preset
from train.rays import RayTensors
from train.weight_file import read_weights

REPORT_EVERY = 10  # steps between rows of the log


def rate_at(iteration: int, part: PartPreset, preset: Preset) -> float:
    """Learning rate against its first value: linear warm-up, at most a tenth of all steps, and exponential decay."""
    warm = min((iteration + 1) / max(min(preset.warm_up, part.iterations / 10), 1), 1.0)
    return warm * preset.last_rate ** (iteration / part.iterations)


def grids_of(field: PartField) -> list[FeatureGrid]:
    return [module for module in field.modules() if isinstance(module, FeatureGrid)]


def optimiser_of(field: PartField, preset: Preset) -> torch.optim.Adam:
    """Adam, one rate each for grids, displacement and the rest; no weight decay, cells never seen stay as they are."""
    grids = [table for grid in grids_of(field) for table in grid.parameters(recurse=False)]
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


UNSAVED, UNWATCHED = Checkpoints(), Watch()


@dataclass
class Position:
    iteration: int = 0
    # steps that were not finite
    skipped: int = 0
    seconds: float = 0.0  # training, over all sittings


def save_checkpoint(
    path: Path, field: torch.nn.Module, optimiser: torch.optim.Optimizer, generator: torch.Generator, position: Position
) -> None:
    """Write weights, optimiser, random state and position, whole or not at all."""
    state = {
        "field": field.state_dict(),
        "optimiser": optimiser.state_dict(),
        "generator": generator.get_state(),
        "position": vars(position),
    }
    with whole_file(path) as file:
        torch.save(state, file)


def load_checkpoint(
    path: Path, field: torch.nn.Module, optimiser: torch.optim.Optimizer, generator: torch.Generator, position: Position
) -> None:
    """Put a checkpoint back, all in place.

    Raises:
        AssetError: the file is broken, or of another network.
    """
    what = "a checkpoint of this training"
    state = read_weights(path, what)
    with unusable(f"{path}: expected {what}, found"):
        field.load_state_dict(state["field"])
        optimiser.load_state_dict(state["optimiser"])
        generator.set_state(state["generator"])
        position.__init__(**state["position"])


def train_field(
    field: PartField, rays: RayTensors, training: FieldTraining, *, checkpoints: Checkpoints = UNSAVED,
    watch: Watch = UNWATCHED,
) -> Position:  # fmt: skip
    """Train a field in place; how far it came.

    A step whose loss or gradient is not finite changes nothing and is counted; more than 1 % of such steps is
    an error. A checkpoint (weights, optimiser, random state) is written every so many seconds, at the end,
    after `stop_after` steps, and at Ctrl-C or SIGTERM, which then raise `Stopped`; resuming from it equals never
    having stopped, bit for bit on one thread.
    """
    at, steps = Position(), _Steps(field, rays, training)
    path, kept = checkpoints.path, (field, steps.optimiser, steps.generator, at)
    if checkpoints.resume and path is not None and path.exists():
        load_checkpoint(path, *kept)
    if watch.log is not None:
        watch.log.begin(at.iteration)
    began = time.monotonic() - at.seconds
    saved = time.monotonic()

    def save() -> None:
        at.seconds = time.monotonic() - began
        if path is not None and training.ranks.writes:
            save_checkpoint(path, *kept)

    with deferred_stop() as stop, flushed_denormals():
        while at.iteration < training.part.iterations:
            finite, describe, stopping = steps.take(at.iteration, stop.asked)
            if not finite:
                at.skipped += 1
                if at.skipped > max(0.01 * training.part.iterations, 1):
                    raise FloatingPointError(f"{at.skipped} of {at.iteration + 1} steps were not finite, more than 1 %")
            at.iteration += 1
            _show(steps, watch, describe, at.iteration, time.monotonic() - began)
            if stopping or at.iteration == checkpoints.stop_after:
                save()
                if stopping:
                    raise Stopped(stop.number or signal.SIGTERM)
                return at
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
    return at


class _Steps:
    """What takes the steps of a training: the optimiser, the random state, and where the ladders stand."""

    def __init__(self, field: PartField, rays: RayTensors, training: FieldTraining):
        self.field, self.rays, self.training = field, rays, training
        self.optimiser = optimiser_of(field, training.preset)
        self.first_rates = [group["lr"] for group in self.optimiser.param_groups]
        self.parameters = [p for group in self.optimiser.param_groups for p in group["params"]]
        self.generator = torch.Generator(device="cpu").manual_seed(training.seed)
        self.weight = training.ranks.weight(training.preset.rays)
        self.frame_counts = torch.bincount(rays.frame).cpu()
        # against its first value, as the last step had it
        self.rate = 0.0

    def take(self, iteration: int, stop: bool) -> tuple[bool, Callable[[], StepReport], bool]:
        """One step: whether it was finite, what describes it, and whether any rank wants to `stop`."""
        part, preset, ranks = self.training.part, self.training.preset, self.training.ranks
        self.rate = rate_at(iteration, part, preset)
        for group, rate in zip(self.optimiser.param_groups, self.first_rates):
            waits = iteration < group.get("begin", 0.0) * part.iterations
            group["lr"] = 0.0 if waits else rate * self.rate
        # stage 2 stays where the ladders ended
        rung = iteration if self.training.extra is None else part.iterations
        for grid in grids_of(self.field):
            grid.open_for(rung / part.iterations)
        chosen = choose_rays(self.frame_counts, preset, self.generator)
        u = torch.rand(preset.rays, generator=self.generator)
        chosen, u = (ranks.share(drawn).to(self.rays.ends.device) for drawn in (chosen, u))
        batch = Batch(chosen, u, beta_at(rung, part, preset), rho_at(rung, part))
        loss, describe = losses(self.field, self.rays, batch, part, preset, extra=self.training.extra)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        loss, stopping = ranks.combine(self.parameters, self.weight, loss, stop)
        norm = torch.nn.utils.clip_grad_norm_(self.parameters, preset.clip)
        finite = bool(torch.isfinite(loss) and torch.isfinite(norm))
        if finite:
            self.optimiser.step()
        return finite, describe, stopping


def _show(steps: _Steps, watch: Watch, describe: Callable[[], StepReport], iteration: int, seconds: float) -> None:
    """Log and report a step that was taken, where it is its turn."""
    training, log = steps.training, watch.log
    last = iteration == training.part.iterations
    if (log is not None or watch.report is not None) and (iteration % REPORT_EVERY == 0 or last):
        ranks = training.ranks
        step = StepReport(*ranks.mean(astuple(describe()), steps.weight, steps.rays.ends.device))
        if log is not None and ranks.writes:
            log.row(iteration, seconds, steps.rate, vars(step))
        if watch.report is not None:
            watch.report(iteration, step)


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
