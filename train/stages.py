"""The stages of a training run (TotalSelfScan, 3.4): parts first, each from its own video; then one person."""

import io
import json
import os
import platform
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from avatar.errors import AssetError
from avatar.files import whole_file, whole_folder
from avatar.progress import Progress, ProgressBoard
from train import run as run_folder
from train.capture import Capture, PartVideo, Subject, read_capture, read_subject, write_subject
from train.checkpoint import Position
from train.compose import compose
from train.distributed import Ranks, join_ranks
from train.field import PartField
from train.hull import with_hair
from train.interrupt import prompt_stop
from train.log import TrainingLog, tensorboard_installed
from train.objective import RayTensors, StepReport, ray_tensors
from train.parts import part_boxes
from train.pose_correction import PoseCorrection
from train.prefit import fit_template
from train.preset import PartPreset, Preset
from train.preview import Preview, part_preview
from train.rays import part_rays
from train.refine import (
    ROUNDS,
    RefineJob,
    copy_refined,
    poses_refined,
    refine_capture,
    with_learned,
    with_refined,
    write_learned,
)
from train.register import Registration, similarity_from_landmarks
from train.rigid import with_rigid_head
from train.session import Session, alone, capture_digest, digest_of, open_session
from train.single import part_names, part_presets, show_as_in_the_body_video, single_rays, single_template
from train.template import SurfaceCloud, neck_height, surface_cloud, template_grid, visible_faces
from train.trainer import peak_memory, train_field
from train.union import read_rays, write_rays
from train.workers import Tell, run_jobs

Array = np.ndarray

AFTER = 0.2  # time of what follows stage 1, as a share of it, for the time left; demo on two cores


@dataclass(frozen=True)
class PartJob:
    """What the training of one part is told; a worker process gets it whole."""

    capture: str
    index: int  # into PARTS
    preset: Preset
    canonical_from_head: Array
    folder: str  # RUN.partial
    device: str
    seed: int
    resume: bool
    threads: int
    save_every: float  # seconds between checkpoints
    preview_every: int  # steps between previews; 0: none
    ranks: Ranks

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
    preview: Preview | None


def train(
    capture_path: Path | str, out: Path | str, preset: Preset, *, device: str = "cpu", seed: int = 0,
    resume: bool = False, force: bool = False, save_every: float = 120.0, preview_every: int = 250,
    refine_poses: str = "auto",
) -> Path:  # fmt: skip
    """Train all parts, compose them, and write the run folder.

    Parts learn independently (stage 1), two at a time on a CPU with two cores, each on its own thread; under
    torchrun one after the other, each on all ranks. Checkpoints, logs and previews lie beside the run folder, in
    RUN.partial, until the run is complete. A signal raises `Stopped` once they are saved.
    """
    with prompt_stop(), ExitStack() as held:
        ranks, device = join_ranks(device)
        say: Callable[[str], None] = _say if ranks.writes else lambda text: None
        capture, out = read_capture(capture_path), Path(out)
        settings = {
            "capture": capture_digest(capture.path),
            "preset": preset.name,
            "iterations": [part.iterations for part in preset.parts],
            "seed": seed,
            "numbers": digest_of(run_folder.preset_facts(preset)),
            "refine_poses": refine_poses,
            "single": preset.single,
        }
        session = None
        if ranks.writes:
            held.enter_context(alone(out))
            session = open_session(out, settings, resume=resume, force=force, say=say)
        session = ranks.tell(session)
        if session is None:
            return out
        began = time.monotonic()
        if ranks.writes and not tensorboard_installed():
            say("logs: CSV only; `pip install tensorboard` adds events for TensorBoard")

        landmarks = _register_landmarks(capture, say)
        say(
            f"stage 1: {', '.join(part_names(preset))} by volume rendering of signed distance (Eq. 10-12), "
            f"preset {preset.name}"
        )
        say(f"logs, previews and checkpoints: {session.partial}")
        refined = _refine(capture, session, ranks, device, refine_poses, say)
        capture = _own_template(capture, landmarks, session, ranks, say)
        facts = _train_parts(
            capture, preset, landmarks, session, ranks, device, seed, save_every, preview_every
        )
        if ranks.writes:
            _compose(capture, preset, landmarks, session, device, seed, facts, refined, began)
    return out


def _compose(
    capture: Capture, preset: Preset, landmarks: Registration, session: Session, device: str, seed: int,
    facts: dict[str, dict], refined: dict, began: float,
) -> None:  # fmt: skip
    """From trained parts to the run folder; under torchrun the work of one rank."""
    out, partial = session.out, session.partial
    capture = with_learned(with_refined(capture, partial), partial)
    seconds = {name: fact["seconds"] for name, fact in facts.items()}
    names, settings = part_names(preset), part_presets(preset)
    fields = [run_folder.read_part(partial / f"{name}.pt", capture.subject, i, settings[i])
              for i, name in enumerate(names)]  # fmt: skip
    torch.set_num_threads(os.cpu_count() or 1)
    progress = Progress("body, stage 2", preset.union.iterations)
    with whole_folder(out) as folder:
        rays = None if preset.single else read_rays(partial / "body.rays", torch.device(device))
        surface, tables, composition = compose(
            capture, fields, preset, landmarks, seed, seconds, _say, rays=rays, checkpoint=partial / "union.ckpt",
            resume=session.resumed, report=lambda step, report: progress.update(step, _note(report)),
        )  # fmt: skip
        if not preset.single:
            shutil.copyfile(partial / "body.pt", folder / "body_stage1.pt")
        run_folder.write_codes(folder / "codes.npz", dict(zip(names, fields)))
        for name, field in zip(names, fields):
            run_folder.write_part(folder / f"{name}.pt", field)
        copy_refined(partial, folder)
        for name in ("logs", "preview"):
            if (partial / name).is_dir():
                shutil.copytree(partial / name, folder / name)
        run_folder.write_surface(folder / "surface.npz", surface, tables)
        shutil.copyfile(partial / "subject.npz", folder / "subject.npz")
        seconds["all"] = time.monotonic() - began
        memory = peak_memory(device)
        run_folder.write_json(
            folder / "run.json",
            {
                "subject": capture.subject.name,
                "preset": preset.name,
                "settings": run_folder.preset_facts(preset),
                "seed": seed,
                "device": device,
                "machine": f"{platform.machine()}, {os.cpu_count()} cores, torch {torch.__version__}",
                "capture": capture.facts,
                "body_licence": capture.facts.get("body_licence", "not stated by the capture"),
                "subject_licence": capture.facts.get("subject_licence", "not stated by the capture"),
                "canonical_pose": "hips opened 30 degrees about z (avatar.skeleton.BIG_POSE)",
                "seconds": {name: round(value, 1) for name, value in seconds.items()},
                "peak_memory_mb": {name: fact["peak_memory_mb"] for name, fact in facts.items()}
                | {"composition": _megabytes(memory)},
                "parts": facts,
                "refined": refined,
                **composition,
            },
        )
    shutil.rmtree(partial, ignore_errors=True)
    _say(f"{out}: {len(surface.vertices)} surface vertices, {seconds['all']:.0f} s, {_memory_text(memory)}")


def _register_landmarks(capture: Capture, say: Callable[[str], None]) -> Registration:
    """Eq. 6: canonical_from_head, a similarity; AssetError where the landmarks do not fit the template."""
    video = capture.videos["head"]
    assert video.landmarks is not None and video.landmark_vertices is not None
    landmarks = similarity_from_landmarks(video.landmarks, capture.subject.vertices[video.landmark_vertices])
    say(
        f"head frame by {len(video.landmarks)} landmarks (Eq. 6): residual {landmarks.residual * 1000:.1f} mm"
    )
    if landmarks.residual > 0.02:
        raise AssetError(
            f"{capture.path / 'head' / 'landmarks.json'}: landmarks should fit the template within 20 mm, "
            f"are {landmarks.residual * 1000:.0f} mm off"
        )
    return landmarks


def _own_template(
    capture: Capture, landmarks: Registration, session: Session, ranks: Ranks, say: Callable[[str], None]
) -> Capture:
    """The capture with a rigid head and with standing hair joined to its template, written for workers and run folder."""
    subject = with_hair(with_rigid_head(capture.subject), with_refined(capture, session.partial), landmarks.transform)
    added = len(subject.rest) - len(capture.subject.rest)
    if added:
        say(f"hair stands off the template: {added} vertices carved from the masks join it")
    if ranks.writes:
        write_subject(session.partial / "subject.npz", subject)
    ranks.tell(None)  # no rank reads it before it is written
    return replace(capture, subject=subject)


def _refine(
    capture: Capture, session: Session, ranks: Ranks, device: str, choice: str, say: Callable[[str], None]
) -> dict:
    """Refined poses and masks into the session's folder, two videos at a time; what was found."""
    found = None
    if ranks.writes:
        workers = min(2, os.cpu_count() or 1) if device == "cpu" and ranks.count == 1 else 1

        def run(jobs: Mapping[str, RefineJob], work: Callable[[RefineJob, Tell], dict]) -> dict[str, dict]:
            board = ProgressBoard(dict.fromkeys(jobs, ROUNDS), workers)
            try:
                return run_jobs(jobs, work, board, workers) if jobs else {}
            finally:
                board.close()

        found = refine_capture(capture, session.partial, choice, say, run)
    return ranks.tell(found) or {}


def _train_parts(
    capture: Capture, preset: Preset, landmarks: Registration, session: Session, ranks: Ranks, device: str,
    seed: int, save_every: float, preview_every: int,
) -> dict[str, dict]:  # fmt: skip
    """Stage 1 for every part; heavier parts first so that two workers end together."""
    cores = os.cpu_count() or 1
    order = (0,) if preset.single else (1, 0, 2, 3)
    workers = min(2, cores, len(order)) if device == "cpu" and ranks.count == 1 else 1
    threads = 1 if workers > 1 else max(cores // ranks.count, 1)
    jobs = {
        part_names(preset)[index]: PartJob(
            str(capture.path), index, preset, landmarks.transform, str(session.partial), device, seed,
            session.resumed, threads, save_every, preview_every, ranks,
        )
        for index in order
    }  # fmt: skip
    totals = {name: job.settings.iterations for name, job in jobs.items()}
    stream = None if ranks.writes else io.StringIO()
    board = ProgressBoard(totals, workers, after=AFTER, stream=stream)
    try:
        return run_jobs(jobs, train_part, board, workers)
    finally:
        board.close()


def train_part(job: PartJob, tell: Tell) -> dict:
    """Train one part from its video and leave PART.pt and PART.ckpt; returns what run.json says of it."""
    name, folder, preset, part_preset = job.name, Path(job.folder), job.preset, job.settings
    checkpoint, done = folder / f"{name}.ckpt", folder / f"{name}.json"
    if job.resume and done.exists():
        return json.loads(done.read_text("utf-8"))
    torch.set_num_threads(job.threads)
    began, cpu = time.monotonic(), time.process_time()
    capture = with_refined(read_capture(job.capture), folder)
    capture = replace(capture, subject=read_subject(folder / "subject.npz", capture.subject.name))
    torch.manual_seed(job.seed * 4 + job.index)
    ready = (single_ready if preset.single else part_ready)(job, capture, tell)
    field, rays, frames = ready.field, ready.rays, len(ready.field.appearance.weight)
    if not preset.single and poses_refined(folder, name):
        field.poses = PoseCorrection(capture.videos[name], capture.subject).to(rays.ends.device)
    if preset.prefit and not (job.resume and checkpoint.exists()):
        off = fit_template(field, preset.prefit, seed=job.seed)
        tell.say(f"{name}: F_s fitted to the template in {preset.prefit} steps, {off * 1000:.1f} mm off")
    if name == "body" and job.ranks.writes:
        write_rays(folder / "body.rays", rays)  # for stage 2 and Eq. 8
    prepared = time.monotonic() - began
    tell.say(
        f"{name}: {len(rays.ends)} rays of {frames} frames, {ready.flagged:.1%} left out as ambiguous, "
        f"prepared in {prepared:.0f} s"
    )
    last: dict[str, float] = {}

    def report(iteration: int, step: StepReport) -> None:
        last.update(vars(step))
        tell.step(iteration, _note(step))

    at = Position()
    log = TrainingLog(folder / "logs", name) if job.ranks.writes else None
    try:
        train_field(
            field, rays, part_preset, preset, seed=job.seed, checkpoint=checkpoint,
            resume=job.resume, save_every=job.save_every, report=report, log=log, preview=ready.preview,
            ranks=job.ranks, at=at,
        )  # fmt: skip
    finally:
        if log is not None:
            log.close()
    memory = peak_memory(job.device)
    facts = {
        "rays": len(rays.ends),
        "flagged": round(ready.flagged, 5),
        "steps": part_preset.iterations,
        "skipped": at.skipped,
        "last": {key: round(value, 5) for key, value in last.items()},
        "seconds": round(prepared + at.seconds, 1),
        "seconds_preparing": round(prepared, 1),
        "cpu_seconds": round(time.process_time() - cpu, 1),  # of the last sitting
        "peak_memory_mb": _megabytes(memory),
    }
    if preset.single:
        show_as_in_the_body_video(field, capture)
    if field.poses is not None:
        facts["poses_learned_deg"] = round(field.poses.degrees(), 3)
        _keep_poses(job, field, rays, capture.videos[name])
        tell.say(f"{name}: poses learned with the field, {facts['poses_learned_deg']:.2f} degrees from the aligned ones")
    if job.ranks.writes:
        run_folder.write_part(folder / f"{name}.pt", field.cpu())
        with whole_file(done, "w") as file:  # from now on resuming passes this part by
            json.dump(facts, file)
    psnr = f"PSNR {last['psnr']:.1f} dB, " if last else ""
    tell.say(
        f"{name}: {part_preset.iterations} steps, {psnr}{at.skipped} skipped, {facts['seconds']:.0f} s, "
        f"{_memory_text(memory)}"
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


def part_ready(job: PartJob, capture: Capture, tell: Tell) -> Ready:
    """A part's untrained field in its box, and the rays of its video."""
    name, preset, settings, device = job.name, job.preset, job.settings, torch.device(job.device)
    subject, part = capture.subject, part_boxes(capture.subject)[job.index]
    canonical_from_head = job.canonical_from_head if name == "head" else None
    video = capture.videos[name]
    cloud = surface_cloud(subject, job.index, visible_faces(subject), settings.spacing)
    template = template_grid(cloud, part.extent.low, part.extent.high, settings.cell,
                             (subject, neck_height(subject)) if name == "head" else None)  # fmt: skip
    field = run_folder.build_field(subject, job.index, settings, template, len(video.images)).to(device)
    rays = part_rays(
        video, subject, cloud, part, settings.band, ends=preset.sections + 2, per_frame=preset.rays_per_frame,
        canonical_from_head=canonical_from_head, rng=np.random.default_rng([job.seed, job.index]),
        background=settings.background,
    )  # fmt: skip
    preview = _preview(job, video, subject, cloud, canonical_from_head)
    return Ready(field, ray_tensors(rays, cloud, device), rays.flagged, preview)


def single_ready(job: PartJob, capture: Capture, tell: Tell) -> Ready:
    """The single network (ablation), untrained, and the rays of all four videos; its preview is the body's."""
    device = torch.device(job.device)
    frames = sum(len(video.images) for video in capture.videos.values())
    rays, cloud, flagged = single_rays(capture, job.preset, job.canonical_from_head, job.seed, device)
    template = single_template(capture, cloud, job.settings.cell)
    field = run_folder.build_field(capture.subject, 0, job.settings, template, frames).to(device)
    preview = _preview(job, capture.videos["body"], capture.subject, cloud, None)
    return Ready(field, rays, flagged, preview)


def _preview(
    job: PartJob, video: PartVideo, subject: Subject, cloud: SurfaceCloud, canonical_from_head: Array | None
) -> Preview | None:
    if not (job.preview_every and job.ranks.writes):
        return None
    path = Path(job.folder) / "preview" / f"{job.name}.png"
    return part_preview(path, video, subject, cloud, part_boxes(subject)[job.index], job.settings.band, job.preset,
                        canonical_from_head, torch.device(job.device), job.preview_every)  # fmt: skip


def _note(step: StepReport) -> str:
    return (
        f"loss {step.loss:.4f}  PSNR {step.psnr:.1f} dB  |grad| {step.slope:.2f}  "
        f"T_nr {step.displacement * 1000:.1f} mm"
    )


def _megabytes(memory: int | None) -> int | None:
    return None if memory is None else round(memory / 1e6)


def _memory_text(memory: int | None) -> str:
    return "peak memory unknown here" if memory is None else f"peak memory {memory / 1e9:.2f} GB"


def _say(text: str) -> None:
    print(text, flush=True)
