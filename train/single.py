"""The single network (TotalSelfScan, 4.3, first ablation): one field learns everyone from all four videos.

It has the parameters of the four parts together, in the box of the body, and gets the four parts' rays in as many
steps as they take together. Its head rays are moved to the canonical frame by the transform that the four parts end
with (Eq. 5, 6 and the body's pixels): one network has one surface, so nothing can be registered afterwards. It is
shown with the mean code of the body's frames.
"""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from avatar.skeleton import PARTS
from avatar.skinning import SkinWeights
from capture.folder import Capture
from capture.template import SurfaceCloud, neck_height, surface_cloud, visible_faces
from train.field import PartField
from train.networks.hash import HashNetworks
from train.networks.paper import PaperNetworks
from train.networks.triplane import TriPlaneNetworks
from train.objective import RayTensors, ray_tensors
from train.parts import part_boxes
from train.preset import PartPreset, Preset
from train.rays import part_rays
from train.template_grid import TemplateGrid, close_cavities, template_grid

Array = np.ndarray

NAME = "single"


def part_names(preset: Preset) -> tuple[str, ...]:
    """What a run with this preset trains; each is a file of the run folder."""
    return (NAME,) if preset.single else PARTS


def part_presets(preset: Preset) -> tuple[PartPreset, ...]:
    """Settings of what a run with this preset trains, in the order of `part_names`."""
    return (single_part(preset),) if preset.single else preset.parts


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


def single_rays(
    capture: Capture,
    preset: Preset,
    canonical_from_head: Float[Array, "4 4"],
    seed: int,
    device: torch.device,
    prepared: Callable[[float], None] = lambda share: None,
) -> tuple[RayTensors, SurfaceCloud, float, float]:
    """The rays of the four parts one after the other, a template cloud as fine as each part's, shares left out, lost.

    Frames count through: body, head, left hand, right hand. `prepared` hears the share done.
    """
    subject, visible = capture.subject, visible_faces(capture.subject)
    each, clouds, flagged, lost = [], [], [], []
    for index, (name, settings) in enumerate(zip(PARTS, preset.parts, strict=True)):
        cloud = surface_cloud(subject, index, visible, settings.spacing)
        rays = part_rays(
            capture.videos[name], subject, cloud, part_boxes(subject)[index], settings.band,
            ends=preset.sections + 2, per_frame=preset.rays_per_frame,
            canonical_from_head=canonical_from_head if name == "head" else None,
            rng=np.random.default_rng([seed, index]), background=settings.background,
            prepared=lambda share, video=index: prepared((video + share) / len(PARTS)),
        )  # fmt: skip
        each.append(ray_tensors(rays, cloud, device))
        flagged.append(rays.flagged * len(rays.ends))
        lost.append(rays.lost)
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
    """Of each part the samples of the cloud that is fine there."""
    own = [cloud.part == index for index, cloud in enumerate(clouds)]
    join = lambda arrays: np.concatenate([array[mine] for array, mine in zip(arrays, own)])
    points = join([cloud.points for cloud in clouds])
    skin = SkinWeights(join([cloud.skin.joints for cloud in clouds]), join([cloud.skin.weights for cloud in clouds]))
    return SurfaceCloud(
        points, join([cloud.normals for cloud in clouds]), skin, join([cloud.part for cloud in clouds]),
        KDTree(points), min(cloud.spacing for cloud in clouds), join([cloud.gap for cloud in clouds]),
    )  # fmt: skip


def single_template(capture: Capture, cloud: SurfaceCloud, cell: float) -> TemplateGrid:
    """The whole template's distance in the body's box, the head's cavities closed as for the head part."""
    extent, neck = part_boxes(capture.subject)[0].extent, neck_height(capture.subject)
    grid = template_grid(cloud, extent.low, extent.high, cell)
    values = grid.values.numpy().astype(np.float64)
    axes = [extent.low[i] + cell * np.arange(values.shape[i]) for i in range(3)]
    above = axes[1] > neck - 0.1
    head = close_cavities(values[:, above], [axes[0], axes[1][above], axes[2]], cell, (capture.subject, neck))
    values[:, above] = head
    return TemplateGrid(torch.tensor(values, dtype=torch.float32), grid.low, cell)


@torch.no_grad()
def show_as_in_the_body_video(field: PartField, capture: Capture) -> None:
    """The reference code is set to the mean over the body's frames: the light of its video is everyone's reference."""
    frames = len(capture.videos["body"].images)
    field.reference.copy_(field.appearance.weight[:frames].mean(0))
