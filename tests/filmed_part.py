"""A part of a small capture with its template cloud, ready for rays, and its untrained field."""

from dataclasses import dataclass

import numpy as np
import torch

from avatar.skeleton import PARTS
from bake.run_capture import RunVideos
from capture.folder import PartVideo
from capture.template.parts import part_boxes
from capture.template.surface import surface_cloud, visible_faces
from train.rays import FilmedPart, RaySettings, RayTensors, part_rays
from train.run import build_field
from train.template_grid import template_grid


def filmed_part(capture, index=2, spacing=0.006, **changes) -> FilmedPart:
    """Part `index` (the left hand) in its own video; `changes` replace what FilmedPart takes."""
    subject = capture.subject
    cloud = surface_cloud(subject, index, visible_faces(subject), spacing)
    return FilmedPart(
        **({"part": part_boxes(subject)[index], "video": capture.videos[PARTS[index]], "subject": subject,
            "cloud": cloud} | changes)
    )  # fmt: skip


def rays_of(filmed: FilmedPart, settings, *, ends: int, per_frame: int) -> RayTensors:
    """The part's rays by the band of its preset, seeded."""
    own = RaySettings(band=settings.band, ends=ends, per_frame=per_frame)
    return part_rays(filmed, own, np.random.default_rng(0)).rays


def untrained(filmed: FilmedPart, settings, frames: int, *, cell: float = 0.006, seed: int = 5):
    """The part's field before its first step."""
    extent, index = filmed.part.extent, PARTS.index(filmed.part.name)
    template = template_grid(filmed.cloud, extent.low, extent.high, cell)
    torch.manual_seed(seed)
    return build_field(filmed.subject, index, settings, template, frames)


@dataclass(frozen=True)
class FoundVideos(RunVideos):
    """Videos of a run that lie in no folder."""

    found: dict[str, PartVideo]

    def video(self, part: str) -> PartVideo:
        return self.found[part]
