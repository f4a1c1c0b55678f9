"""The loop in which density fields learn: a budget of processor seconds, kept so that it can go on, its time left told.

The learning rate falls with the share of the budget that is spent, so that everybody's schedule ends when the time
does. A run is a folder: run.json says which system in which size it is, field.pt holds its weights, subject.npz its
template.
"""

import json
import shutil
import signal
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from avatar.psnr import decibels
from capture.folder import write_subject
from command.errors import AssetError
from command.interrupt import Stopped, deferred_stop
from command.progress import Progress
from experiments.rivals.density import DensityField, Frame, Scene, render
from files.input_file import read_json_object, unusable
from files.whole import check_folder, exclusive_lock, whole_folder, write_json
from train.loss import color_loss, color_norm_loss, mask_loss
from train.run import RIVAL
from train.session import FILE as SESSION
from train.trainer import Position, flushed_denormals, load_checkpoint, save_checkpoint
from train.weight_file import read_weights

WARM_UP = 10  # steps
SAVE_EVERY = 30.0  # seconds


@dataclass(frozen=True, kw_only=True)
class Budget:
    """How long a field learns, and from how much at once."""

    # of the processor, in steps; infinite: until the steps are taken
    seconds: float = float("inf")
    steps: int = 1_000_000
    rays: int = 1024  # of one frame, in a step
    rate: float = 4e-3  # of Adam at first
    last_rate: float = 0.2  # share of it in the end
    mask_weight: float = 0.1
    norm: bool = False  # L_rgb as Eq. 11 prints it
    seed: int = 0

    def spent(self, at: Position) -> float:
        """The share that is over."""
        return min(max(at.seconds / self.seconds, at.iteration / self.steps), 1.0)


def loss_of(field: DensityField, frame: Frame, u: Tensor, budget: Budget) -> tuple[Tensor, float]:
    """L_rgb + L_mask (Eq. 11) and the system's own term, and the PSNR on the person."""
    color, log_transmittance, extra = render(field, frame, u)
    L_rgb = (color_norm_loss if budget.norm else color_loss)(color, frame.color)
    loss = L_rgb + budget.mask_weight * mask_loss(log_transmittance, frame.mask)
    on = frame.mask > 0.5
    error = (color - frame.color)[on].square().mean().item() if on.any() else 1.0
    return loss if extra is None else loss + extra, decibels(max(error, 1e-10))


class Learning:
    """A field with its optimiser, its random state, and how far it is."""

    def __init__(self, field: DensityField, frames: list[Frame], budget: Budget):
        self.field, self.frames, self.budget, self.at = field, frames, budget, Position()
        self.optimiser = torch.optim.Adam(field.parameters(), lr=budget.rate, betas=(0.9, 0.99), eps=1e-15,
                                          fused=True)  # fmt: skip
        self.generator = torch.Generator().manual_seed(budget.seed)

    def step(self) -> float:
        """One step on rays of one frame; the PSNR on the person."""
        budget, frames = self.budget, self.frames
        warm = min((self.at.iteration + 1) / WARM_UP, 1.0)
        for group in self.optimiser.param_groups:
            group["lr"] = warm * budget.rate * budget.last_rate ** budget.spent(self.at)
        frame = frames[int(torch.randint(len(frames), (1,), generator=self.generator))]
        rays = torch.randint(len(frame.ends), (budget.rays,), generator=self.generator)
        u = torch.rand(budget.rays, generator=self.generator)
        loss, psnr = loss_of(self.field, frame.chosen(rays), u, budget)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.field.parameters(), 1.0)
        if torch.isfinite(loss) and torch.isfinite(norm):
            self.optimiser.step()
        else:
            self.at.skipped += 1
        self.at.iteration += 1
        return psnr

    def go_on(self, label: str, checkpoint: Path | None) -> None:
        """Learn until the budget is spent; a checkpoint is written every SAVE_EVERY seconds and at a signal."""
        kept = self.field, self.optimiser, self.generator, self.at
        if checkpoint is not None and checkpoint.exists():
            load_checkpoint(checkpoint, *kept)
        progress, saved, before = Progress(label, 100), time.monotonic(), self.at.seconds
        began, sitting = time.process_time(), self.budget.spent(self.at)
        with deferred_stop() as stop, flushed_denormals():
            while self.budget.spent(self.at) < 1 and not stop.asked:
                psnr = self.step()
                self.at.seconds = before + time.process_time() - began
                share = (self.budget.spent(self.at) - sitting) / max(1 - sitting, 1e-9)
                progress.update(100 * share, f"{self.at.iteration} steps, PSNR {psnr:.1f} dB")
                if checkpoint is not None and time.monotonic() - saved > SAVE_EVERY:
                    save_checkpoint(checkpoint, *kept)
                    saved = time.monotonic()
            if checkpoint is not None:
                save_checkpoint(checkpoint, *kept)
        if stop.asked:
            raise Stopped(stop.number or signal.SIGTERM)


def learn_run(field: DensityField, scene: Scene, budget: Budget, out: Path, facts: dict[str, str]) -> None:
    """Learn and write the run folder `out`; an interrupted training lies in OUT.partial and is gone on with.

    `facts` name the system, its size and what it was trained on; they decide the result.

    Raises:
        AssetError: what was interrupted there was begun with other facts, or another process is at it.
    """
    check_folder(out)
    partial = out.with_name(out.name + ".partial")
    decides = json.loads(json.dumps({**facts, "budget": {k: str(v) for k, v in asdict(budget).items()}}))
    with exclusive_lock(out):
        partial.mkdir(exist_ok=True)
        if not (partial / SESSION).exists():
            write_json(partial / SESSION, decides)
        elif read_json_object(partial / SESSION, "an interrupted training") != decides:
            raise AssetError(f"{partial}: was begun with other settings; remove it to begin anew")
        learning = Learning(field, scene.frames, budget)
        learning.go_on(facts["system"], partial / "field.ckpt")
        field.settle(scene.body_frames)
        with whole_folder(out) as folder:
            torch.save({"state": field.state_dict()}, folder / "field.pt")
            write_subject(folder / "subject.npz", scene.person.subject)
            numbers = {"steps": learning.at.iteration, "skipped": learning.at.skipped,
                       "cpu_seconds": round(learning.at.seconds, 1), "frames": len(scene.frames),
                       "cpu_seconds_process": round(time.process_time(), 1)}  # fmt: skip
            write_json(folder / "run.json", {"format": RIVAL, "version": 1, **decides, **numbers})
        shutil.rmtree(partial)


def read_facts_of_rival(run: Path) -> dict:
    """run.json of a density field.

    Raises:
        AssetError: it is none.
    """
    facts = read_json_object(run / "run.json", "a rival's run")
    if facts.get("format") != RIVAL:
        raise AssetError(f"{run / 'run.json'}: format should be {RIVAL!r}, is {facts.get('format')!r}")
    return facts


def load_field(run: Path, field: DensityField) -> DensityField:
    """The weights of a run put into an untrained field of its size."""
    what = "the weights of a rival"
    content = read_weights(run / "field.pt", what)
    with unusable(f"{run / 'field.pt'}: expected {what}, found"):
        field.load_state_dict(content["state"])
    return field.eval().requires_grad_(False)


def on_one_frame(field: DensityField, scene: Scene, budget: Budget, enough: float = 30.0) -> dict[str, float]:
    """How soon the field shows the first frame to `enough` dB: the pooled PSNR of that frame's rays on the person."""
    learning, frame = Learning(field, scene.frames[:1], budget), scene.frames[0]
    on = (frame.mask > 0.5).nonzero()[:, 0]
    reached, began = 0.0, time.process_time()
    while reached < enough and budget.spent(learning.at) < 1:
        for _ in range(20):
            learning.step()
        learning.at.seconds = time.process_time() - began
        with torch.no_grad():
            pieces = [frame.chosen(rays) for rays in on.split(4096)]
            shown = torch.cat([render(field, piece, torch.full((len(piece.ends),), 0.5))[0] for piece in pieces])
            reached = decibels((shown - frame.color[on]).square().mean().item())
    return {"psnr_db": round(reached, 2), "steps": learning.at.iteration, "cpu_seconds": round(learning.at.seconds, 1)}
