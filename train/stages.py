"""The stages of a training run (TotalSelfScan, 3.4): parts first, each from its own video; then one person."""

import io
import os
import platform
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from avatar.errors import AssetError
from avatar.files import whole_folder
from avatar.interrupt import prompt_stop
from avatar.progress import Progress, ProgressBoard, Reporter
from avatar.similarity import Registration, similarity_from_landmarks
from capture.folder import Capture, read_capture, write_subject
from capture.repair.refine import ROUNDS, RefineJob, copy_refined, refine_capture, with_learned, with_refined
from train import run as run_folder
from train.compose import compose
from train.distributed import Ranks, join_ranks
from train.hull import with_hair
from train.log import tensorboard_installed
from train.part_job import PartJob, megabytes, memory_text, step_note, train_part
from train.preset import Preset
from train.rigid import with_rigid_head
from train.session import Session, capture_digest, digest_of, exclusive_lock, open_session
from train.single import part_names, part_presets
from train.stored_preset import preset_json
from train.trainer import peak_memory
from train.union import read_rays
from train.workers import run_jobs

Array = np.ndarray

# time of what follows stage 1, as a share of it, for the time left; demo on two cores
AFTER = 0.2


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
            "numbers": digest_of(preset_json(preset)),
            "refine_poses": refine_poses,
            "single": preset.single,
        }
        session = None
        if ranks.writes:
            held.enter_context(exclusive_lock(out))
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
        facts = _train_parts(capture, preset, landmarks, session, ranks, device, seed, save_every, preview_every)
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
            resume=session.resumed, report=lambda step, report: progress.update(step, step_note(report)),
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
                "settings": preset_json(preset),
                "seed": seed,
                "device": device,
                "machine": f"{platform.machine()}, {os.cpu_count()} cores, torch {torch.__version__}",
                "capture": capture.facts,
                "body_licence": capture.facts.get("body_licence", "not stated by the capture"),
                "subject_licence": capture.facts.get("subject_licence", "not stated by the capture"),
                "canonical_pose": "hips opened 30 degrees about z (avatar.skeleton.BIG_POSE)",
                "seconds": {name: round(value, 1) for name, value in seconds.items()},
                "peak_memory_mb": {name: fact["peak_memory_mb"] for name, fact in facts.items()}
                | {"composition": megabytes(memory)},
                "parts": facts,
                "refined": refined,
                **composition,
            },
        )
    shutil.rmtree(partial, ignore_errors=True)
    _say(f"{out}: {len(surface.vertices)} surface vertices, {seconds['all']:.0f} s, {memory_text(memory)}")


def _register_landmarks(capture: Capture, say: Callable[[str], None]) -> Registration:
    """Eq. 6: canonical_from_head, a similarity; AssetError where the landmarks do not fit the template."""
    video = capture.videos["head"]
    assert video.landmarks is not None and video.landmark_vertices is not None
    landmarks = similarity_from_landmarks(video.landmarks, capture.subject.vertices[video.landmark_vertices])
    say(f"head frame by {len(video.landmarks)} landmarks (Eq. 6): residual {landmarks.residual * 1000:.1f} mm")
    if landmarks.residual > 0.02:
        raise AssetError(
            f"{capture.path / 'head' / 'landmarks.json'}: landmarks should fit the template within 20 mm, "
            f"are {landmarks.residual * 1000:.0f} mm off"
        )
    return landmarks


def _own_template(
    capture: Capture, landmarks: Registration, session: Session, ranks: Ranks, say: Callable[[str], None]
) -> Capture:
    """The capture with a rigid head and with standing hair joined to its template,
    written for workers and run folder.
    """
    subject = with_hair(with_rigid_head(capture.subject), with_refined(capture, session.partial), landmarks.transform)
    added = len(subject.rest) - len(capture.subject.rest)
    if added:
        say(f"hair stands off the template: {added} vertices carved from the masks join it")
    if ranks.writes:
        write_subject(session.partial / "subject.npz", subject)
    # no rank reads it before it is written
    ranks.tell(None)
    return replace(capture, subject=subject)


def _refine(
    capture: Capture, session: Session, ranks: Ranks, device: str, choice: str, say: Callable[[str], None]
) -> dict:
    """Refined poses and masks into the session's folder, two videos at a time; what was found."""
    found = None
    if ranks.writes:
        workers = min(2, os.cpu_count() or 1) if device == "cpu" and ranks.count == 1 else 1

        def run(jobs: Mapping[str, RefineJob], work: Callable[[RefineJob, Reporter], dict]) -> dict[str, dict]:
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


def _say(text: str) -> None:
    print(text, flush=True)
