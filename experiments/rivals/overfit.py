"""Whether a system learns at all: how well it shows one frame of the body's video after learning from that alone."""

import time
from dataclasses import replace
from pathlib import Path

import torch

from avatar.psnr import decibels
from capture.folder import read_capture, read_subject
from experiments.rivals import anisdf
from experiments.rivals.density import first_frames
from experiments.rivals.single import place_read_from, single_preset, single_untrained
from train.command import TrainOptions
from train.objective import Batch, functions_of, render_rays
from train.part_job import PartJob
from train.preset import Preset
from train.rays import RayTensors
from train.trainer import FieldTraining, flushed_denormals, train_field


def field_on_one_frame(
    system: str, options: TrainOptions, preset: Preset, head_from: Path, steps: int
) -> dict[str, float]:
    """The PSNR on the person of the first frame, after so many steps on its rays; "single" or "anisdf"."""
    alone = anisdf.anisdf_preset(preset) if system == "anisdf" else single_preset(preset)
    part = replace(alone.parts[0], iterations=steps)
    alone = replace(alone, parts=(part,))
    capture = first_frames(read_capture(options.capture), 1)
    capture = replace(capture, subject=read_subject(head_from / "subject.npz", capture.subject.name))
    place = place_read_from(head_from, capture).canonical_from_head
    job = PartJob(capture=str(options.capture), index=0, preset=alone, canonical_from_head=place, folder="",
                  device="cpu", threads=1, seed=options.seed)  # fmt: skip
    torch.manual_seed(options.seed)
    made = (anisdf.untrained if system == "anisdf" else single_untrained)(preset, job, capture)
    rays, field = of_frame(made.rays, 0), made.field
    began = time.process_time()
    train_field(field, rays, FieldTraining(part=part, preset=alone, seed=options.seed))
    seconds = time.process_time() - began
    on, shown = (rays.mask > 0.5).nonzero()[:, 0], []
    with flushed_denormals():
        for piece in on.split(2048):
            batch = Batch(piece, torch.full((len(piece),), 0.5), part.beta[1])
            shown.append(render_rays(functions_of(field), rays, batch, alone, create_graph=False).color.detach())
    psnr = decibels((torch.cat(shown) - rays.color[on]).square().mean().item())
    return {"psnr_db": round(psnr, 2), "steps": steps, "cpu_seconds": round(seconds, 1)}


def of_frame(rays: RayTensors, frame: int) -> RayTensors:
    """The rays of one frame."""
    own = rays.frame == frame
    return replace(rays, ends=rays.ends[own], row=rays.row[own], direction=rays.direction[own], frame=rays.frame[own],
                   color=rays.color[own], mask=rays.mask[own])  # fmt: skip
