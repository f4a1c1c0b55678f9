"""Parts that are not learned: the template itself, painted as the videos show it."""

import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.light import CaptureLight
from capture.folder import Capture, CaptureSubject
from capture.light.seen_colors import seen_colors
from capture.template.surface import visible_faces
from command.workers import on_all_cores
from train import run as run_folder
from train.field import PartField
from train.networks.seen import SeenColor
from train.part_job import template_distance
from train.preset import Preset

# metres from the template beyond which no color is asked for
REACH = 0.06


def seen_parts(
    capture: Capture, preset: Preset, lights: Mapping[str, CaptureLight], folder: Path, seed: int
) -> dict[str, dict]:
    """Write PART.pt of the parts that the preset does not learn into `folder`; what run.json says of each. `lights` are
    the videos'."""
    painted = [index for index in range(len(preset.parts)) if index not in preset.learned]
    if not painted:
        return {}
    began = time.monotonic()
    # what stays untrained, and shows nothing, is the same in every run
    torch.manual_seed(seed)
    colors = seen_colors(capture, lights, seed)
    visible, facts = visible_faces(capture.subject), {}
    made = on_all_cores(
        lambda index: template_distance(capture.subject, index, preset.parts[index], visible)[0], painted
    )
    for index, template in zip(painted, made):
        name, settings = preset.names[index], preset.parts[index]
        frames = len(capture.videos[name].images)
        field = run_folder.build_field(capture.subject, index, settings, template, frames)
        paint(field, capture.subject, colors)
        run_folder.write_part(folder / f"{name}.pt", field)
        facts[name] = {"steps": 0, "seconds": round(time.monotonic() - began, 1), "peak_memory_mb": None}
        began = time.monotonic()
    return facts


def paint(field: PartField, subject: CaptureSubject, colors: Float[Array, "vertices 3"]) -> None:
    """Give each node of the part's colors that of the nearest vertex; far from all, their mean."""
    color = field.color_network
    assert isinstance(color, SeenColor)
    places = (color.places() + 1) / 2 * (field.high - field.low) + field.low
    _, nearest = KDTree(subject.vertices).query(places.numpy(), distance_upper_bound=REACH, workers=-1)
    painted = np.concatenate([colors, colors.mean(0, keepdims=True)])[nearest]
    color.values.copy_(torch.as_tensor(painted.T, dtype=torch.float32).view_as(color.values))
