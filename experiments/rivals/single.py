"""The single network (TotalSelfScan, 4.3, first ablation): one field learns everyone from all four videos.

It has the parameters of the four parts together, in the box of the body, and gets the four parts' rays in as many
steps as they take together. Its head rays are moved to the canonical frame by the transform that the four parts end
with (Eq. 5, 6 and the body's pixels): one network has one surface, so nothing can be registered afterwards. It is
shown with the mean code of the body's frames.

    python -m experiments.rivals.single CAPTURE -o RUN [--head-from RUN_OF_FOUR_PARTS] [options of selfscan train]
"""

import argparse
import shutil
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from avatar.similarity import Registration
from avatar.skeleton import PARTS
from avatar.skinning import SkinWeights
from capture.fit.refine import with_learned
from capture.folder import Capture, read_capture
from capture.template.grid import close_cavities, distance_grid
from capture.template.parts import part_boxes
from capture.template.surface import SurfaceCloud, neck_height, surface_cloud, visible_faces
from command.command_line import Help, parse
from command.errors import AssetError
from experiments.program import end_with
from train.command import TrainOptions
from train.compose import HeadPlacement, place_head
from train.distributed import leave_ranks
from train.networks.hash import HashNetworks
from train.networks.paper import PaperNetworks
from train.networks.triplane import TriPlaneNetworks
from train.part_job import PartJob, Untrained, ray_settings
from train.preset import PartPreset, Preset, chosen_preset, without
from train.rays import FilmedPart, RayTensors, part_rays
from train.run import build_field, matrix_of, read_facts, read_part, write_part
from train.session import digest_of
from train.stages import Training, begin, finish, part_job, prepared, read_fields, train_parts
from train.template_grid import TemplateGrid


def single_preset(preset: Preset) -> Preset:
    """The preset of the single network that stands against the four parts of `preset`.

    Its rays are of four videos, which have four lights: light is no factor.
    """
    return replace(without(preset, ["light"]), parts=(single_part(preset),))


def single_part(preset: Preset) -> PartPreset:
    """Settings of the single network: the body's, with the steps and the parameters of all parts."""
    body, head = preset.parts[:2]
    networks = body.networks
    match networks:
        case TriPlaneNetworks():
            each = [p.networks for p in preset.parts if isinstance(p.networks, TriPlaneNetworks)]
            plane_size, color_size = (
                round(sum(getattr(n, side) ** 2 for n in each) ** 0.5) for side in ("plane_size", "color_size")
            )
            networks = replace(networks, plane_size=plane_size, color_size=color_size, width=2 * networks.width)
        case HashNetworks():
            finest = min(part.networks.cell for part in preset.parts if isinstance(part.networks, HashNetworks))
            networks = replace(networks, cell=finest, rows=4 * networks.rows, width=2 * networks.width)
        case PaperNetworks():
            networks = replace(networks, width=2 * networks.width)
    steps = sum(part.iterations for part in preset.parts)
    # half the body's: the fingers must stand apart in the template
    cell = 0.5 * body.cell
    return replace(body, iterations=steps, cell=cell, beta=(body.beta[0], head.beta[1]), networks=networks)


def single_untrained(preset: Preset, job: PartJob, capture: Capture) -> Untrained:
    """The single network, untrained, and the rays of all four videos; `preset` is the four parts'."""
    device = torch.device(job.device)
    frames = sum(len(video.images) for video in capture.videos.values())
    rays, cloud, flagged, lost = single_rays(job, capture, preset)
    template = single_template(capture, cloud, job.settings.cell)
    field = build_field(capture.subject, 0, job.settings, template, frames).to(device)
    own = torch.from_numpy(cloud.points[::8].astype(np.float32))
    return Untrained(field, rays, flagged, lost, own)


def single_rays(job: PartJob, capture: Capture, preset: Preset) -> tuple[RayTensors, SurfaceCloud, float, float]:
    """The rays of the four parts one after the other, a template cloud as fine as each part's, shares left out, lost.

    Frames count through: body, head, left hand, right hand.
    """
    subject, visible = capture.subject, visible_faces(capture.subject)
    each, clouds, flagged, lost = [], [], [], []
    for index, (name, settings) in enumerate(zip(PARTS, preset.parts, strict=True)):
        cloud = surface_cloud(subject, index, visible, settings.spacing)
        filmed = FilmedPart(part_boxes(subject)[index], capture.videos[name], subject, cloud,
                            job.canonical_from_head if name == "head" else None)  # fmt: skip
        generator = np.random.default_rng([job.seed, index])
        found = part_rays(filmed, ray_settings(settings, preset), generator, job.device)
        each.append(found.rays)
        flagged.append(found.flagged * len(found.rays.ends))
        lost.append(found.lost)
        clouds.append(cloud)
    counts = [len(capture.videos[name].images) for name in PARTS]
    left_out = sum(flagged) / sum(len(rays.ends) for rays in each)
    return joined_rays(each, counts), joined_cloud(clouds), left_out, sum(lost) / len(lost)


def joined_rays(each: list[RayTensors], frames: list[int]) -> RayTensors:
    """Rays of several videos as one; `frames` is the number of frames of each. Rigid videos get unturned bones."""
    rows = np.cumsum([0, *[len(rays.joints) for rays in each]])
    starts = np.cumsum([0, *frames])
    bones: list[Tensor] = []
    for rays, count in zip(each, frames, strict=True):
        unturned = torch.tensor([0.0, 0, 0, 1], device=rays.ends.device).expand(count, 52, 4)
        bones.append(unturned if rays.bones is None else rays.bones)
    joined: dict[str, Any] = {
        field.name: torch.cat([getattr(rays, field.name) for rays in each])
        for field in fields(RayTensors)
        if field.name not in ("row", "frame", "bones")
    }
    return RayTensors(
        **joined,
        row=torch.cat([rays.row + int(start) for rays, start in zip(each, rows)]),
        frame=torch.cat([rays.frame + int(start) for rays, start in zip(each, starts)]),
        bones=torch.cat(bones),
    )


def joined_cloud(clouds: list[SurfaceCloud]) -> SurfaceCloud:
    """Each part's samples, from the cloud that is fine there."""
    own = [cloud.part == index for index, cloud in enumerate(clouds)]
    join = lambda arrays: np.concatenate([array[mine] for array, mine in zip(arrays, own)])
    points = join([cloud.points for cloud in clouds])
    skin = SkinWeights(join([cloud.skin.joints for cloud in clouds]), join([cloud.skin.weights for cloud in clouds]))
    return SurfaceCloud(
        points, join([cloud.normals for cloud in clouds]), skin, join([cloud.part for cloud in clouds]),
        KDTree(points), min(cloud.spacing for cloud in clouds), join([cloud.gap for cloud in clouds]),
        join([cloud.area for cloud in clouds]),
    )  # fmt: skip


def single_template(capture: Capture, cloud: SurfaceCloud, cell: float) -> TemplateGrid:
    """The whole template's distance in the body's box, the head's cavities closed as for the head part."""
    extent, neck = part_boxes(capture.subject)[0].extent, neck_height(capture.subject)
    grid = distance_grid(cloud, extent.low, extent.high, cell)
    values = grid.values.astype(np.float64)
    axes = [extent.low[i] + cell * np.arange(values.shape[i]) for i in range(3)]
    above = axes[1] > neck - 0.1
    head = close_cavities(values[:, above], [axes[0], axes[1][above], axes[2]], cell, (capture.subject, neck))
    values[:, above] = head
    return TemplateGrid(torch.tensor(values, dtype=torch.float32), torch.from_numpy(grid.low), cell)


def train_single(options: TrainOptions, preset: Preset, head_from: Path | None = None) -> Path:
    """Train the single network that stands against `preset` of four parts, and write the run folder.

    Its head lies where four parts have it: in the finished run `head_from`, else body and head are trained and placed
    first.

    Raises:
        AssetError: `head_from` is no run of four parts on this capture.
    """
    return train_alone(options, preset, single_preset(preset), single_untrained, head_from)


def train_alone(
    options: TrainOptions, four: Preset, alone: Preset, make: Callable[[Preset, PartJob, Capture], Untrained],
    head_from: Path | None, after: Callable[[Path], None] = lambda part: None,
) -> Path:  # fmt: skip
    """Train one field of preset `alone` that stands against the preset `four` of parts; `make` makes it, `after` takes
    the file of its weights."""
    four = without(four, ["light"])
    head = None if head_from is None else place_read_from(head_from, read_capture(options.capture))
    decides = None if head is None else {"head_from": digest_of({"place": head.canonical_from_head.tolist()})}
    with ExitStack() as held:
        training = begin(options, alone, held, decides)
        if training is None:
            return options.out
        if head is None:
            training = prepared(training)
            training = replace(training, head=placed_by_parts(replace(training, preset=four)))
        else:
            # no need to look for a place that is known
            hair = replace(alone.hair, consistency=False)
            training = prepared(replace(training, head=head, preset=replace(alone, hair=hair)))
        job = part_job(training, training.session.partial, 0)
        job = replace(job, videos=PARTS, make=partial(make, four))
        facts = train_parts(training, [job])
        if training.ranks.writes:
            after(Path(job.folder) / f"{job.name}.pt")
            show_as_in_the_body_video(training, job)
        finish(training, facts)
    return options.out


def place_read_from(run: Path, capture: Capture) -> HeadPlacement:
    """Where a finished run of four parts on the same capture has the head.

    Raises:
        AssetError: it is no such run.
    """
    facts = read_facts(run)
    if "single" in facts.get("parts", {}):
        raise AssetError(f"{run}: is a single network; --head-from needs a run of four parts")
    if facts.get("capture") != capture.facts:
        raise AssetError(f"{run}: was trained on another capture; --head-from needs a run on {capture.path}")
    final = np.linalg.inv(matrix_of(run, facts, "head_from_canonical"))
    correction = matrix_of(run, facts, "canonical_from_head_field")
    landmarks = Registration(np.linalg.solve(correction, final), float("nan"))
    return HeadPlacement(landmarks, correction, {**facts.get("registration", {}), "from": "a run of four parts"})


def placed_by_parts(training: Training) -> HeadPlacement:
    """Where four parts have the head: body and head are trained as parts and placed."""
    training.say("head: body and head are trained as parts and placed first; --head-from RUN takes a finished run's")
    own, folder = training.session.partial, training.session.partial / "placement"

    def copied() -> None:
        folder.mkdir(exist_ok=True)
        for path in (own / "subject.npz", *sorted(own.glob("refined_*.npz"))):
            shutil.copyfile(path, folder / path.name)

    training.from_writer(copied)
    train_parts(training, [part_job(training, folder, index) for index in (1, 0)])

    def placed() -> HeadPlacement:
        capture, fields = with_learned(training.capture, folder), read_fields(training, folder, 2)
        head = place_head(capture, fields, training.head, training.say, outlines=training.preset.hair.consistency)
        return replace(head, facts={**head.facts, "from": "body and head trained for it"})

    return training.from_writer(placed)


def show_as_in_the_body_video(training: Training, job: PartJob) -> None:
    """The reference code is set to the mean over the body's frames: the light of its video is everyone's reference."""
    path = Path(job.folder) / f"{job.name}.pt"
    field = read_part(path, training.capture.subject, 0, job.settings)
    frames = len(training.capture.videos["body"].images)
    with torch.no_grad():
        field.reference.copy_(field.appearance.weight[:frames].mean(0))
    write_part(path, field)


def main(argv: list[str] | None = None) -> int:
    """The options of `selfscan train`, and --head-from."""
    own = argparse.ArgumentParser(prog="python -m experiments.rivals.single", add_help=False, allow_abbrev=False)
    own.add_argument("--head-from", type=Path)
    given, rest = own.parse_known_args(argv)
    words = Help(
        own.prog or "", "One network for everyone, for comparison. --head-from RUN: a finished run of four parts."
    )
    options = parse(TrainOptions, rest, words)
    try:
        train_single(options, chosen_preset(options), given.head_from)
    finally:
        leave_ranks()
    return 0


if __name__ == "__main__":
    end_with(main)
