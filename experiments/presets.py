"""Accuracy against seconds: one part of one person trained by each preset, scored on frames it never saw.

    python -m experiments.presets out/presets --capture out/cap/white_m --part head --presets demo fast paper
    --iterations 1500 3000 200

Every HELD_OUT-th frame of the part's video trains nothing; its rays are drawn with the means of the trained codes,
and PSNR is pooled over those on the person. The clock runs while the part trains, not while it is prepared or
scored. A preset's schedule is shortened to the given steps; the hours of its own steps are extrapolated.
"""

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from avatar.psnr import decibels
from avatar.similarity import similarity_from_landmarks
from avatar.skeleton import PARTS
from bench.ladder.machine import commit, cpu_name
from bench.report.writer import markdown_table
from capture.folder import read_capture
from command.errors import AssetError
from files.whole import whole_file, write_json, write_text
from train.field import PartField
from train.objective import Batch, beta_at, functions_of, render_rays
from train.part_job import PartJob, part_untrained
from train.prefit import fit_template
from train.preset import PRESETS, PartPreset, Preset
from train.rays import RayTensors
from train.trainer import FieldTraining, Watch, peak_memory, train_field

HELD_OUT = 8  # each so-many-th frame, from the fourth on
SCORED = 8192  # held-out rays at most
BATCH = 1024  # rays drawn at once
# scores of one training, evenly spread in the logarithm of its steps
CHECKPOINTS = 10
RAY_FIELDS = ("ends", "row", "direction", "frame", "color", "mask")  # of RayTensors, one row a ray


def taken(rays: RayTensors, chosen: Bool[Tensor, "rays"]) -> RayTensors:
    """Some of the rays; bones and template samples stay as they are."""
    return replace(rays, **{name: getattr(rays, name)[chosen] for name in RAY_FIELDS})


def split(rays: RayTensors, seed: int) -> tuple[RayTensors, RayTensors]:
    """Rays to train on, and a seeded choice of those of the held-out frames that see the person."""
    held = rays.frame % HELD_OUT == 3
    scored = (held & (rays.mask > 0.5)).nonzero()[:, 0]
    order = torch.randperm(len(scored), generator=torch.Generator().manual_seed(seed))[:SCORED]
    kept = torch.zeros_like(held)
    kept[scored[order.to(scored.device)]] = True
    if not (bool(kept.any()) and bool((~held).any())):
        raise AssetError(f"{int(rays.frame.max()) + 1} frames are too few to hold out each {HELD_OUT}th of them")
    return taken(rays, ~held), taken(rays, kept)


@torch.no_grad()
def held_out_psnr(
    field: PartField, rays: RayTensors, trained: Bool[Tensor, "frames"], beta: float, preset: Preset
) -> float:
    """PSNR over the held-out rays, dB. The rows of their frames' codes get the mean of the trained ones: training
    never reads them."""
    for table in (field.appearance.weight, field.displacement.code.weight):
        table[~trained] = table[trained].mean(0)
    squared = 0.0
    for part in torch.arange(len(rays.frame), device=rays.frame.device).split(BATCH):
        middle = torch.full((len(part),), 0.5, device=part.device)
        color = render_rays(functions_of(field), rays, Batch(part, middle, beta), preset, create_graph=False).color
        squared += float((color - rays.color[part]).square().sum())
    return decibels(max(squared / (3 * len(rays.frame)), 1e-10))


def checkpoints(iterations: int) -> list[int]:
    """Steps at which to score: multiples of ten (the trainer reports at those) and the last."""
    spread = np.geomspace(max(iterations / 50, 1), iterations, CHECKPOINTS)
    return sorted({min(10 * math.ceil(step / 10), iterations) for step in spread})


def one_preset(
    capture_path: Path,
    part_name: str,
    preset: Preset,
    iterations: int | None,
    device: str,
    seed: int,
    folder: Path,
) -> dict[str, Any]:
    """Train the part and score it on the way."""
    capture, index = read_capture(capture_path), PARTS.index(part_name)
    own = preset.parts[index]
    settings: PartPreset = replace(own, iterations=iterations or own.iterations)
    preset = replace(preset, parts=tuple(settings if i == index else p for i, p in enumerate(preset.parts)))
    head = capture.videos["head"]
    assert head.landmarks is not None and head.landmark_vertices is not None
    canonical_from_head = similarity_from_landmarks(
        head.landmarks, capture.subject.vertices[head.landmark_vertices]
    ).transform
    threads = torch.get_num_threads()
    job = PartJob(
        capture=str(capture_path), index=index, preset=preset, canonical_from_head=canonical_from_head,
        folder=str(folder), device=device, threads=threads, seed=seed,
    )  # fmt: skip
    torch.set_num_threads(threads)
    torch.manual_seed(seed * 4 + index)
    ready = part_untrained(job, capture)
    field = ready.field
    fitted = time.monotonic()
    if preset.prefit:
        fit_template(field, preset.prefit, seed=seed)
    fitted = time.monotonic() - fitted
    training, held = split(ready.rays, seed)
    trained = torch.zeros(len(field.appearance.weight), dtype=torch.bool, device=training.frame.device)
    trained[training.frame.unique()] = True

    due, points, away = checkpoints(settings.iterations), [], 0.0
    began = time.monotonic()

    def report(iteration: int, _step: object) -> None:
        nonlocal away
        if iteration not in due:
            return
        if device == "cuda":
            torch.cuda.synchronize()
        now = time.monotonic()
        psnr = held_out_psnr(field, held, trained, beta_at(iteration, settings, preset), preset)
        seconds = now - began - away
        points.append({"iteration": iteration, "seconds": round(seconds, 2), "psnr_db": round(psnr, 3)})
        print(f"{preset.name}: {iteration} steps, {seconds:.1f} s, {psnr:.2f} dB", flush=True)
        away += time.monotonic() - now

    by = FieldTraining(part=settings, preset=preset, seed=seed)
    skipped = train_field(field, training, by, watch=Watch(report=report)).skipped
    per_step = points[-1]["seconds"] / settings.iterations
    memory = peak_memory(device)
    return {
        "preset": preset.name,
        "iterations": settings.iterations,
        "own_iterations": own.iterations,
        "skipped": skipped,
        "held_out_rays": len(held.frame),
        "parameters": sum(p.numel() for p in field.parameters()),
        "seconds_fitting_template": round(fitted, 1),
        "seconds_per_iteration": per_step,
        "checkpoints": points,
        "hours_of_own_iterations": per_step * own.iterations / 3600,
        "extrapolated": settings.iterations < own.iterations,
        "peak_memory_mb": None if memory is None else round(memory / 1e6),
    }


def plot(result: dict[str, Any], path: Path) -> None:
    """Seconds of training against held-out PSNR, one line a preset."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4.5), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    for preset in result["presets"]:
        points = preset["checkpoints"]
        label = f"{preset['preset']}: {preset['iterations']} steps, {preset['seconds_per_iteration']:.3g} s each"
        axes.plot([p["seconds"] for p in points], [p["psnr_db"] for p in points], "o-", ms=4, label=label)
    axes.set_xscale("log")
    axes.set_xlabel(f"seconds of training on {result['machine']['device']}")
    axes.set_ylabel("PSNR dB on held-out frames")
    axes.set_title(f"{result['part']} of {result['capture']}", fontsize=10)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)
    with whole_file(path) as file:
        figure.savefig(file, format="png")


def markdown(result: dict[str, Any]) -> str:
    """The table, with what was extrapolated said to be so."""
    lines = [
        f"# Presets: {result['part']} of {result['capture']}",
        "",
        "Made by `python -m experiments.presets`. PSNR over the rays on the person in frames that trained nothing, "
        "drawn with",
        f"mean codes; seconds of training alone. {result['machine']['device']}; commit {result['machine']['commit']}.",
        "",
    ]
    if result["machine"]["kind"] == "cpu":
        lines += [
            "On a CPU: smoke-sized. What the presets for a GPU cost there is not what they cost on one.",
            "",
        ]
    rows = []
    for preset in result["presets"]:
        last = preset["checkpoints"][-1]
        hours = f"{preset['hours_of_own_iterations']:.3g}" + (", extrapolated" if preset["extrapolated"] else "")
        seconds, decibels = f"{last['seconds']:.1f}", f"{last['psnr_db']:.2f}"
        a_step, own_steps = f"{preset['seconds_per_iteration']:.3g}", str(preset["own_iterations"])
        rows.append([preset["preset"], str(preset["iterations"]), seconds, decibels, a_step, own_steps, hours])
    head = ["preset", "steps here", "seconds", "PSNR dB", "s a step", "its own steps", "hours of these, this part"]
    lines += markdown_table(head, rows)
    return "\n".join(lines) + "\n\n![accuracy against seconds](presets.png)\n"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.presets", description="Accuracy against seconds of the presets, on one part."
    )
    parser.add_argument("out", metavar="OUT", type=Path, help="gets presets.json, presets.md and presets.png")
    parser.add_argument("--capture", metavar="CAP", type=Path, required=True)
    parser.add_argument("--part", choices=PARTS, default="head")
    parser.add_argument("--presets", nargs="+", choices=sorted(PRESETS), default=["demo", "fast", "paper"])
    parser.add_argument("--iterations", type=int, nargs="+", metavar="N",
                        help="steps, one number or one a preset (default: each preset's own)")  # fmt: skip
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(argv)
    steps: list[int | None] = list(given.iterations or [None])
    steps = steps * len(given.presets) if len(steps) == 1 else steps
    if len(steps) != len(given.presets) or any(n is not None and n < 1 for n in steps):
        parser.error(f"--iterations should be one positive number or one for each of {given.presets}")
    if given.device == "cuda" and not torch.cuda.is_available():
        raise AssetError("--device cuda: this machine has no CUDA device that torch can use")
    given.out.mkdir(parents=True, exist_ok=True)
    presets = [
        one_preset(given.capture, given.part, PRESETS[name], n, given.device, given.seed, given.out)
        for name, n in zip(given.presets, steps, strict=True)
    ]
    device = (
        torch.cuda.get_device_name() if given.device == "cuda" else f"{cpu_name()}, {torch.get_num_threads()} threads"
    )
    result = {
        "format": "selfscan-presets",
        "capture": read_capture(given.capture).facts.get("subject", given.capture.name),
        "part": given.part,
        "seed": given.seed,
        "held_out": f"frames 3, 3 + {HELD_OUT}, ... of the part's video",
        "machine": {"device": device, "kind": given.device, "commit": commit()},
        "presets": presets,
    }
    write_json(given.out / "presets.json", result)
    write_text(given.out / "presets.md", markdown(result))
    plot(result, given.out / "presets.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
