"""The stages of a training run (TotalSelfScan, 3.4): parts first, each from its own video; then one person."""

import concurrent.futures
import multiprocessing
import os
import platform
import shutil
import time
from pathlib import Path

import numpy as np
import torch

from avatar.errors import AssetError
from avatar.files import whole_folder
from avatar.progress import Progress
from train import run as run_folder
from train.capture import PARTS, Capture, read_capture
from train.compose import compose
from train.objective import ray_tensors
from train.parts import part_boxes
from train.preset import Preset
from train.rays import part_rays
from train.register import Registration, similarity_from_landmarks
from train.template import neck_height, surface_cloud, template_grid, visible_faces
from train.trainer import set_threads, train_field
from train.union import read_rays, write_rays

Array = np.ndarray


def train(
    capture_path: Path | str, out: Path | str, preset: Preset, *, device: str = "cpu", seed: int = 0,
    resume: bool = False,
) -> Path:  # fmt: skip
    """Train all parts, compose them, and write the run folder.

    Parts learn independently (stage 1), two at a time on a CPU with two cores, each on its own thread. Their
    checkpoints lie beside the run folder, in RUN.partial, until the run is complete.
    """
    out = Path(out)
    capture = read_capture(capture_path)
    partial = out.with_name(out.name + ".partial")
    if not resume:
        shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True, exist_ok=True)
    seconds: dict[str, float] = {}
    began = time.monotonic()

    landmarks = _register_landmarks(capture)
    _say(
        f"stage 1: {len(PARTS)} parts by volume rendering of signed distance (Eq. 10-12), preset {preset.name}"
    )
    facts = _train_parts(capture, preset, landmarks, partial, device, seed, resume)
    seconds |= {f"{name}": fact["seconds"] for name, fact in facts.items()}
    fields = [run_folder.read_part(partial / f"{name}.pt", capture.subject, i, preset.parts[i])
              for i, name in enumerate(PARTS)]  # fmt: skip

    set_threads(os.cpu_count() or 1)
    with whole_folder(out) as folder:
        rays = read_rays(partial / "body.rays", torch.device(device))
        surface, tables, composition = compose(
            capture, fields, preset, landmarks, seed, seconds, _say, rays=rays, checkpoint=partial / "union.ckpt",
            resume=resume,
        )  # fmt: skip
        shutil.copyfile(partial / "body.pt", folder / "body_stage1.pt")
        shutil.copyfile(partial / "union.ckpt", folder / "union.ckpt")
        run_folder.write_codes(folder / "codes.npz", fields)
        for name, field in zip(PARTS, fields):
            run_folder.write_part(folder / f"{name}.pt", field)
            shutil.copyfile(partial / f"{name}.ckpt", folder / f"{name}.ckpt")
        run_folder.write_surface(folder / "surface.npz", surface, tables)
        shutil.copyfile(capture.path / "subject.npz", folder / "subject.npz")
        seconds["all"] = time.monotonic() - began
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
                "canonical_pose": "hips opened 30 degrees about z (avatar.skeleton.BIG_POSE)",
                "seconds": {name: round(value, 1) for name, value in seconds.items()},
                "parts": facts,
                **composition,
            },
        )
    shutil.rmtree(partial, ignore_errors=True)
    _say(f"{out}: {len(surface.vertices)} surface vertices, {seconds['all']:.0f} s")
    return out


def _register_landmarks(capture: Capture) -> Registration:
    """Eq. 6: canonical_from_head, a similarity; AssetError where the landmarks do not fit the template."""
    video = capture.videos["head"]
    assert video.landmarks is not None and video.landmark_vertices is not None
    landmarks = similarity_from_landmarks(video.landmarks, capture.subject.vertices[video.landmark_vertices])
    _say(
        f"head frame by {len(video.landmarks)} landmarks (Eq. 6): residual {landmarks.residual * 1000:.1f} mm"
    )
    if landmarks.residual > 0.02:
        raise AssetError(
            f"{capture.path / 'head' / 'landmarks.json'}: landmarks should fit the template within 20 mm, "
            f"are {landmarks.residual * 1000:.0f} mm off"
        )
    return landmarks


def _train_parts(
    capture: Capture,
    preset: Preset,
    landmarks: Registration,
    partial: Path,
    device: str,
    seed: int,
    resume: bool,
) -> dict[str, dict]:
    """Stage 1 for every part; heavier parts first so that two workers end together."""
    jobs = [(str(capture.path), index, preset, landmarks.transform, str(partial), device, seed, resume)
            for index in (1, 0, 2, 3)]  # fmt: skip
    workers = min(2, os.cpu_count() or 1) if device == "cpu" else 1
    if workers == 1:
        facts = [train_part(*job, threads=os.cpu_count() or 1) for job in jobs]
    else:
        context = multiprocessing.get_context("spawn")  # a forked torch may hang
        with concurrent.futures.ProcessPoolExecutor(workers, mp_context=context) as pool:
            pending = [pool.submit(train_part, *job) for job in jobs]
            try:
                facts = [future.result() for future in pending]
            except BaseException:
                pool.shutdown(wait=True, cancel_futures=True)
                raise
    return {PARTS[job[1]]: fact for job, fact in zip(jobs, facts)}


def train_part(
    capture_path: str, index: int, preset: Preset, canonical_from_head: Array, partial: str, device: str,
    seed: int, resume: bool, threads: int = 1,
) -> dict:  # fmt: skip
    """Train one part from its video and leave PART.pt and PART.ckpt in `partial`; returns what run.json says of it."""
    set_threads(threads)
    name, part_preset = PARTS[index], preset.parts[index]
    began, cpu = time.monotonic(), time.process_time()
    capture = read_capture(capture_path)
    subject, video = capture.subject, capture.videos[name]
    part = part_boxes(subject)[index]
    torch.manual_seed(seed * 4 + index)
    cloud = surface_cloud(subject, index, visible_faces(subject), part_preset.spacing)
    template = template_grid(cloud, part.extent.low, part.extent.high, part_preset.cell,
                             (subject, neck_height(subject)) if name == "head" else None)  # fmt: skip
    field = run_folder.build_field(subject, index, part_preset, template, len(video.images)).to(device)
    rays = part_rays(
        video, subject, cloud, part, part_preset.band, ends=preset.sections + 2, per_frame=preset.rays_per_frame,
        background=preset.background, canonical_from_head=canonical_from_head if name == "head" else None,
        rng=np.random.default_rng([seed, index]),
    )  # fmt: skip
    tensors = ray_tensors(rays, cloud, torch.device(device))
    if name == "body":
        write_rays(Path(partial) / "body.rays", tensors)  # for stage 2 and Eq. 8
    prepared = time.monotonic() - began
    _say(
        f"{name}: {len(rays.ends)} rays of {len(video.images)} frames, {rays.flagged:.1%} left out as ambiguous, "
        f"prepared in {prepared:.0f} s"
    )
    progress = Progress(name, part_preset.iterations)
    last = {}

    def report(iteration: int, step) -> None:
        last.update(step.__dict__)
        progress.update(
            iteration,
            f"loss {step.loss:.4f}  colour {step.color:.4f}  PSNR {step.psnr:.1f} dB  |grad| {step.slope:.2f}"
            f"  T_nr {step.displacement * 1000:.1f} mm",
        )

    checkpoint = Path(partial) / f"{name}.ckpt"
    skipped = train_field(
        field, tensors, part_preset, preset, seed=seed, checkpoint=checkpoint,
        resume=resume, report=report,
    )  # fmt: skip
    run_folder.write_part(Path(partial) / f"{name}.pt", field.cpu())
    seconds = time.monotonic() - began
    psnr = f"PSNR {last['psnr']:.1f} dB" if last else "already trained"
    _say(f"{name}: {part_preset.iterations} steps, {psnr}, {skipped} skipped, {seconds:.0f} s")
    return {
        "rays": len(rays.ends),
        "flagged": round(rays.flagged, 5),
        "steps": part_preset.iterations,
        "skipped": skipped,
        "last": {key: round(value, 5) for key, value in last.items()},
        "seconds": round(seconds, 1),
        "seconds_preparing": round(prepared, 1),
        "cpu_seconds": round(time.process_time() - cpu, 1),
    }


def _say(text: str) -> None:
    print(text, flush=True)
