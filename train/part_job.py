"""The training of one part from its video: what a worker process is given, does and leaves."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from avatar.files import whole_file
from avatar.progress import Reporter
from avatar.skeleton import PARTS
from capture.folder import Capture, CaptureSubject, PartVideo, read_capture, read_subject
from capture.repair.refine import poses_refined, with_refined, write_learned
from capture.template import SurfaceCloud, neck_height, surface_cloud, visible_faces
from train import run as run_folder
from train.checkpoint import Position
from train.clothes import THICK
from train.distributed import ONE_PROCESS, Ranks
from train.field import PartField
from train.light import VideoLight
from train.log import TrainingLog
from train.objective import RayTensors, StepReport, ray_tensors
from train.parts import part_boxes
from train.pose_correction import PoseCorrection
from train.prefit import fit_template
from train.preset import PartPreset, Preset
from train.preview import Preview, part_preview
from train.rays import Focus, part_rays
from train.single import part_names, part_presets, show_as_in_the_body_video, single_rays, single_template
from train.template_grid import template_grid
from train.trainer import Checkpoints, FieldTraining, Watch, peak_memory, train_field
from train.union import write_rays

Array = np.ndarray

# of the preparation, where a template fit follows the rays
RAYS_SHARE = 0.3


@dataclass(frozen=True, kw_only=True)
class PartJob:
    """The training of one part, for a worker process."""

    capture: str
    index: int  # into PARTS
    preset: Preset
    canonical_from_head: Array
    # gets the part, its checkpoints, logs and previews; holds the template and what was refined
    folder: str
    device: str
    threads: int
    # of its video, where it is a factor of its own
    light: VideoLight | None = None
    ranks: Ranks = ONE_PROCESS
    seed: int = 0
    resume: bool = False
    save_every: float = 120.0  # seconds between checkpoints
    # steps between previews; 0: none
    preview_every: int = 0

    @property
    def name(self) -> str:
        """What files and reports call it."""
        return part_names(self.preset)[self.index]

    @property
    def settings(self) -> PartPreset:
        """The part's own numbers."""
        return part_presets(self.preset)[self.index]


class Ready(NamedTuple):
    """A part before its first step."""

    field: PartField
    rays: RayTensors
    flagged: float  # share of the rays left out as ambiguous
    lost: float  # share of the person's pixels whose ray meets no template
    preview: Preview | None


def train_part(job: PartJob, reporter: Reporter) -> dict:
    """Train one part from its video and leave PART.pt and PART.ckpt; returns what run.json says of it."""
    name, folder, preset, part_preset = job.name, Path(job.folder), job.preset, job.settings
    checkpoint, done = folder / f"{name}.ckpt", folder / f"{name}.json"
    if job.resume and done.exists():
        return json.loads(done.read_text("utf-8"))
    torch.set_num_threads(job.threads)
    began, cpu = time.monotonic(), time.process_time()
    # one video at 1080p may be a gigabyte: a part reads only its own, and each picture when its rays are drawn
    parts = PARTS if preset.single else (name,)
    capture = with_refined(read_capture(job.capture, parts=parts, frames_on_demand=True), folder)
    capture = replace(capture, subject=read_subject(folder / "subject.npz", capture.subject.name))
    torch.manual_seed(job.seed * 4 + job.index)
    prefit = preset.prefit and not (job.resume and checkpoint.exists())
    rays_prepared = lambda share: reporter.prepare(share * (RAYS_SHARE if prefit else 1))
    ready = (single_ready if preset.single else part_ready)(job, capture, rays_prepared)
    field, rays, frames = ready.field, ready.rays, len(ready.field.appearance.weight)
    # a single network's rays are of four videos: as aligned
    if not preset.single and poses_refined(folder, name):
        field.poses = PoseCorrection(capture.videos[name], capture.subject).to(rays.ends.device)
    if prefit:
        fitted = lambda share: reporter.prepare(RAYS_SHARE + (1 - RAYS_SHARE) * share)
        off = fit_template(field, preset.prefit, seed=job.seed, done=fitted)
        reporter.say(f"{name}: F_s fitted to the template in {preset.prefit} steps, {off * 1000:.1f} mm off")
    if name == "body" and job.ranks.writes:
        # for stage 2 and Eq. 8
        write_rays(folder / "body.rays", rays)
    prepared, prepared_cpu = time.monotonic() - began, time.process_time() - cpu
    reporter.say(
        f"{name}: {len(rays.ends)} rays of {frames} frames, {ready.flagged:.1%} left out as ambiguous, "
        f"{ready.lost:.2%} of the person's pixels meet no template, prepared in {prepared:.0f} s"
    )
    last: dict[str, float] = {}

    def report(iteration: int, step: StepReport) -> None:
        last.update(vars(step))
        reporter.step(iteration, step_note(step))

    at = Position()
    log = TrainingLog(folder / "logs", name) if job.ranks.writes else None
    try:
        train_field(
            field, rays, FieldTraining(part=part_preset, preset=preset, seed=job.seed, ranks=job.ranks),
            checkpoints=Checkpoints(path=checkpoint, resume=job.resume, every=job.save_every),
            watch=Watch(report=report, log=log, preview=ready.preview), at=at,
        )  # fmt: skip
    finally:
        if log is not None:
            log.close()
    memory = peak_memory(job.device)
    facts = {
        "rays": len(rays.ends),
        "flagged": round(ready.flagged, 5),
        "lost": round(ready.lost, 5),
        "steps": part_preset.iterations,
        "skipped": at.skipped,
        "last": {key: round(value, 5) for key, value in last.items()},
        "seconds": round(prepared + at.seconds, 1),
        "seconds_preparing": round(prepared, 1),
        # of the last sitting, as is what it holds of preparing
        "cpu_seconds": round(time.process_time() - cpu, 1),
        "cpu_seconds_preparing": round(prepared_cpu, 1),
        "peak_memory_mb": megabytes(memory),
    }
    if preset.single:
        show_as_in_the_body_video(field, capture)
    if field.poses is not None:
        facts["poses_learned_deg"] = round(field.poses.degrees(), 3)
        _keep_poses(job, field, rays, capture.videos[name])
        reporter.say(
            f"{name}: poses learned with the field, {facts['poses_learned_deg']:.2f} degrees from the aligned ones"
        )
    if job.ranks.writes:
        field.light = None
        run_folder.write_part(folder / f"{name}.pt", field.cpu())
        # from now on resuming passes this part by
        with whole_file(done, "w") as file:
            json.dump(facts, file)
    psnr = f"PSNR {last['psnr']:.1f} dB, " if last else ""
    reporter.say(
        f"{name}: {part_preset.iterations} steps, {psnr}{at.skipped} skipped, {facts['seconds']:.0f} s, "
        f"{memory_text(memory)}"
    )
    return facts


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


def part_ready(job: PartJob, capture: Capture, prepared: Callable[[float], None]) -> Ready:
    """A part's untrained field in its box, and the rays of its video."""
    name, preset, settings, device = job.name, job.preset, job.settings, torch.device(job.device)
    subject, part = capture.subject, part_boxes(capture.subject)[job.index]
    canonical_from_head = job.canonical_from_head if name == "head" else None
    video = capture.videos[name]
    visible, cell = visible_faces(subject), settings.cell
    cloud = surface_cloud(subject, job.index, visible, settings.spacing)
    if name == "body" and subject.behind_cloth is not None:
        cell = min(cell, 0.5 * THICK)
    template = template_grid(cloud, part.extent.low, part.extent.high, cell,
                             (subject, neck_height(subject)) if name == "head" else None)  # fmt: skip
    if subject.behind_cloth is not None:
        # or rays would look for surfaces behind the cloth, with a fourth of their sections on it
        cloud = surface_cloud(
            subject, job.index, visible & ~subject.behind_cloth[subject.faces].all(1), settings.spacing
        )
    field = run_folder.build_field(subject, job.index, settings, template, len(video.images)).to(device)
    field.light = None if job.light is None else job.light.tensors(device)
    rays = part_rays(
        video, subject, cloud, part, settings.band, ends=preset.sections + 2, per_frame=preset.rays_per_frame,
        canonical_from_head=canonical_from_head, rng=np.random.default_rng([job.seed, job.index]),
        background=settings.background, prepared=prepared,
        focus=None if settings.focus == 0 else Focus(template, settings.focus),
    )  # fmt: skip
    preview = _preview(job, video, subject, cloud, canonical_from_head)
    return Ready(field, ray_tensors(rays, cloud, device), rays.flagged, rays.lost, preview)


def single_ready(job: PartJob, capture: Capture, prepared: Callable[[float], None]) -> Ready:
    """The single network (ablation), untrained, and the rays of all four videos; its preview is the body's."""
    device = torch.device(job.device)
    frames = sum(len(video.images) for video in capture.videos.values())
    rays, cloud, flagged, lost = single_rays(capture, job.preset, job.canonical_from_head, job.seed, device, prepared)
    template = single_template(capture, cloud, job.settings.cell)
    field = run_folder.build_field(capture.subject, 0, job.settings, template, frames).to(device)
    preview = _preview(job, capture.videos["body"], capture.subject, cloud, None)
    return Ready(field, rays, flagged, lost, preview)


def _preview(
    job: PartJob, video: PartVideo, subject: CaptureSubject, cloud: SurfaceCloud, canonical_from_head: Array | None
) -> Preview | None:
    if not (job.preview_every and job.ranks.writes):
        return None
    path = Path(job.folder) / "preview" / f"{job.name}.png"
    return part_preview(path, video, subject, cloud, part_boxes(subject)[job.index], job.settings.band, job.preset,
                        canonical_from_head, torch.device(job.device), job.preview_every)  # fmt: skip


def step_note(step: StepReport) -> str:
    return (
        f"loss {step.loss:.4f}  PSNR {step.psnr:.1f} dB  |grad| {step.slope:.2f}  "
        f"T_nr {step.displacement * 1000:.1f} mm"
    )


def megabytes(memory: int | None) -> int | None:
    return None if memory is None else round(memory / 1e6)


def memory_text(memory: int | None) -> str:
    return "peak memory unknown here" if memory is None else f"peak memory {memory / 1e9:.2f} GB"
