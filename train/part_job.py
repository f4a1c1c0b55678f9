"""The training of one part from its video: what a worker process is given, does and leaves."""

import json
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from torch import Tensor

from avatar.skeleton import PARTS
from capture.fit.refine import poses_refined, with_refined, write_learned
from capture.folder import Capture, CaptureSubject, PartVideo, read_capture, read_subject
from capture.template.clothes import THICK
from capture.template.parts import part_boxes
from capture.template.surface import SurfaceCloud, neck_height, surface_cloud, visible_faces
from command.progress import Reporter
from files.input_file import read_json_object
from files.whole import whole_file
from train import run as run_folder
from train.distributed import ONE_PROCESS, Ranks
from train.field import PartField
from train.light import VideoLight
from train.log import TrainingLog
from train.objective import StepReport
from train.pose_correction import PoseCorrection
from train.prefit import fit_template
from train.preset import PartPreset, Preset
from train.rays import FilmedPart, RaySettings, RayTensors, part_rays
from train.template_grid import TemplateGrid, template_grid
from train.trainer import Checkpoints, FieldTraining, Position, Watch, peak_memory, train_field
from train.union import write_rays

# a part breaks off where more than this share of its template lies farther than so many metres from what is learned:
# `bake` would take its template (bake.broken_parts); looked at every so many steps
BROKEN_SHARE, BROKEN_OFF, LOOK_EVERY = 0.1, 0.03, 50


class Untrained(NamedTuple):
    """A part before its first step."""

    field: PartField
    rays: RayTensors
    flagged: float  # share of the rays left out as ambiguous
    lost: float  # share of the person's pixels whose ray meets no template
    template: Float[Tensor, "n 3"]  # points of the part's template


@dataclass(frozen=True, kw_only=True)
class PartJob:
    capture: str
    index: int  # into the preset's parts
    preset: Preset
    canonical_from_head: Array
    # gets the part, its checkpoints and logs; holds the template and what was refined
    folder: str
    device: str
    threads: int
    # its video's, where light is a factor of its own
    light: VideoLight | None = None
    ranks: Ranks = ONE_PROCESS
    seed: int = 0
    resume: bool = False
    save_every: float = 120.0  # seconds between checkpoints
    # videos that it learns from; None: the part's own
    videos: tuple[str, ...] | None = None
    # what makes the part; None: `part_untrained`
    make: Callable[["PartJob", Capture], Untrained] | None = None

    @property
    def name(self) -> str:
        return self.preset.names[self.index]

    @property
    def settings(self) -> PartPreset:
        """The part's own numbers."""
        return self.preset.parts[self.index]

    def read_capture(self) -> Capture:
        """The part's videos as refined, each picture read when its rays are drawn, on the training's template.

        One video at 1080p may be a gigabyte: a part reads only its own.
        """
        videos, folder = self.videos or (self.name,), Path(self.folder)
        capture = with_refined(read_capture(self.capture, parts=videos, frames_on_demand=True), folder)
        return replace(capture, subject=read_subject(folder / "subject.npz", capture.subject.name))


def train_part(job: PartJob, reporter: Reporter) -> dict:
    """Train one part from its video and leave PART.pt and PART.ckpt; returns what run.json says of it."""
    name, folder, steps = job.name, Path(job.folder), job.settings.iterations
    done = folder / f"{name}.json"
    if job.resume and done.exists():
        return read_json_object(done, "what training a part found")
    torch.set_num_threads(job.threads)
    began, cpu = time.monotonic(), time.process_time()
    capture = job.read_capture()
    torch.manual_seed(job.seed * 4 + job.index)
    part = _untrained(job, capture, reporter)
    field, rays = part.field, part.rays
    prepared, prepared_cpu = time.monotonic() - began, time.process_time() - cpu
    reporter.say(
        f"{name}: {len(rays.ends)} rays of {len(field.appearance.weight)} frames, {part.flagged:.1%} left out as "
        f"ambiguous, {part.lost:.2%} of the person's pixels meet no template, prepared in {prepared:.0f} s"
    )
    at, last = _trained(job, part, reporter)
    memory = peak_memory(job.device)
    facts = {
        "rays": len(rays.ends),
        "flagged": round(part.flagged, 5),
        "lost": round(part.lost, 5),
        "steps": steps,
        "skipped": at.skipped,
        "last": {key: round(value, 5) for key, value in last.items()},
        "seconds": round(prepared + at.seconds, 1),
        "seconds_preparing": round(prepared, 1),
        # the last sitting's, as is what it holds of preparing
        "cpu_seconds": round(time.process_time() - cpu, 1),
        "cpu_seconds_preparing": round(prepared_cpu, 1),
        "peak_memory_mb": megabytes(memory),
    }
    if field.poses is not None:
        degrees = facts["poses_learned_deg"] = round(field.poses.degrees(), 3)
        _keep_poses(job, field, rays, capture.videos[name])
        reporter.say(f"{name}: poses learned with the field, {degrees:.2f} degrees from the aligned ones")
    if job.ranks.writes:
        field.light = None
        run_folder.write_part(folder / f"{name}.pt", field.cpu())
        # from now on resuming passes this part by
        with whole_file(done, "w") as file:
            json.dump(facts, file)
    psnr = f"PSNR {last['psnr']:.1f} dB, " if last else ""
    reporter.say(f"{name}: {steps} steps, {psnr}{at.skipped} skipped, {facts['seconds']:.0f} s, {memory_text(memory)}")
    return facts


def _untrained(job: PartJob, capture: Capture, reporter: Reporter) -> Untrained:
    """The part with its rays, its poses where they are learned too, and F_s fitted to the template where it must be."""
    name, folder, preset = job.name, Path(job.folder), job.preset
    prefit = preset.prefit and not (job.resume and (folder / f"{name}.ckpt").exists())
    part = (job.make or part_untrained)(job, capture)
    if poses_refined(folder, name):
        part.field.poses = PoseCorrection(capture.videos[name], capture.subject).to(part.rays.ends.device)
    if prefit:
        off = fit_template(part.field, preset.prefit, seed=job.seed)
        reporter.say(f"{name}: F_s fitted to the template in {preset.prefit} steps, {off * 1000:.1f} mm off")
    if name == "body" and job.ranks.writes:
        # for stage 2 and Eq. 8
        write_rays(folder / "body.rays", part.rays)
    return part


def _trained(job: PartJob, part: Untrained, reporter: Reporter) -> tuple[Position, dict[str, float]]:
    """The part trained in place: how far it is, and the numbers of its last step."""
    last: dict[str, float] = {}
    points, whole = part.template.to(part.rays.ends.device), True

    def report(iteration: int, step: StepReport) -> None:
        """Show a step, and say so where the part begins to break off from its template."""
        nonlocal whole
        last.update(vars(step))
        reporter.step(iteration, step_note(step))
        if iteration % LOOK_EVERY == 0 or iteration == job.settings.iterations:
            share = share_off(part.field, points)
            if whole != (share <= BROKEN_SHARE):
                whole = not whole
                reporter.say(f"{job.name}: step {iteration}: " + ("it is whole again" if whole else
                    f"it breaks off: {share:.0%} of its template is more than {BROKEN_OFF * 100:.0f} cm from what is "
                    "learned; as it is, bake would keep the template"))  # fmt: skip

    folder = Path(job.folder)
    with closing(TrainingLog(folder / "logs", job.name)) as log:
        at = train_field(
            part.field, part.rays, FieldTraining(part=job.settings, preset=job.preset, seed=job.seed, ranks=job.ranks),
            checkpoints=Checkpoints(path=folder / f"{job.name}.ckpt", resume=job.resume, every=job.save_every),
            watch=Watch(report=report, log=log if job.ranks.writes else None),
        )  # fmt: skip
    return at, last


@torch.no_grad()
def share_off(field: PartField, points: Float[Tensor, "n 3"]) -> float:
    """The share of `points` of a part's template (canonical) that lie farther than BROKEN_OFF from its surface."""
    return float((field(points).distance.abs() > BROKEN_OFF).float().mean())


def _keep_poses(job: PartJob, field: PartField, rays: RayTensors, video: PartVideo) -> None:
    """Write the poses that were learned, and the body's rays under them for stage 2; the field forgets them."""
    assert field.poses is not None
    poses, field.poses = field.poses, None
    if not job.ranks.writes:
        return
    if job.name == "body":
        ends = poses.moved(rays.ends, rays.frame, rays.row, rays.joints, rays.weights)
        write_rays(Path(job.folder) / "body.rays", replace(rays, ends=ends))
    write_learned(Path(job.folder), job.name, poses.corrected(video))


def part_untrained(job: PartJob, capture: Capture) -> Untrained:
    """A part's untrained field in its box, and the rays of its video."""
    name, settings, device = job.name, job.settings, torch.device(job.device)
    subject, part, video = capture.subject, part_boxes(capture.subject)[job.index], capture.videos[name]
    visible = visible_faces(subject)
    field, cloud = template_field(subject, job.index, settings, len(video.images), visible)
    field.to(device)
    if subject.behind_cloth is not None:
        # or rays would look for surfaces behind the cloth, with a fourth of their sections on it
        shown = visible & ~subject.behind_cloth[subject.faces].all(1)
        cloud = surface_cloud(subject, job.index, shown, settings.spacing)
    field.light = None if job.light is None else job.light.tensors(device)
    filmed = FilmedPart(part, video, subject, cloud, job.canonical_from_head if name == "head" else None)
    generator = np.random.default_rng([job.seed, job.index])
    chosen = ray_settings(settings, job.preset)
    # no more of a frame than its share of what the steps ask for; body's serve stage 2 and Eq. 8 as well
    asked = max(job.preset.rays * settings.iterations // len(video.images), 1000)
    if name != "body":
        chosen = replace(chosen, per_frame=min(chosen.per_frame, asked))
    own = torch.from_numpy(cloud.points[cloud.part == job.index][::8].astype(np.float32))
    return Untrained(field, *part_rays(filmed, chosen, generator, device), own)


def template_field(
    subject: CaptureSubject, index: int, settings: PartPreset, frames: int, visible: Bool[Array, "faces"]
) -> tuple[PartField, SurfaceCloud]:
    """The untrained field of part `index`, and the samples of the template's `visible` faces that it was made of."""
    template, cloud = template_distance(subject, index, settings, visible)
    return run_folder.build_field(subject, index, settings, template, frames), cloud


def template_distance(
    subject: CaptureSubject, index: int, settings: PartPreset, visible: Bool[Array, "faces"]
) -> tuple[TemplateGrid, SurfaceCloud]:
    """Distance of the template's `visible` faces in the box of part `index`, and the samples that it is of."""
    name, extent, cell = PARTS[index], part_boxes(subject)[index].extent, settings.cell
    cloud = surface_cloud(subject, index, visible, settings.spacing)
    if name == "body" and subject.behind_cloth is not None:
        cell = min(cell, 0.5 * THICK)
    closed = (subject, neck_height(subject)) if name == "head" else None
    return template_grid(cloud, extent.low, extent.high, cell, closed), cloud


def ray_settings(part: PartPreset, preset: Preset) -> RaySettings:
    return RaySettings(
        band=part.band, ends=preset.sections + 2, per_frame=preset.rays_per_frame, background=part.background
    )


def step_note(step: StepReport) -> str:
    return (
        f"loss {step.loss:.4f}  PSNR {step.psnr:.1f} dB  |grad| {step.slope:.2f}  "
        f"T_nr {step.displacement * 1000:.1f} mm"
    )


def megabytes(memory: int | None) -> int | None:
    return None if memory is None else round(memory / 1e6)


def memory_text(memory: int | None) -> str:
    return "peak memory unknown here" if memory is None else f"peak memory {memory / 1e9:.2f} GB"
