"""Stage 2 (TotalSelfScan, 3.3 and 3.4): the body meets the other parts, L_union = L_body + L_g (Eq. 7, 13)."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from torch import Tensor

from avatar.skeleton import PARTS
from capture.folder import CaptureSubject
from capture.template.surface import visible_faces
from files.input_file import unusable
from files.whole import whole_file
from geometry.mesh import face_normals
from geometry.sample import lattice_samples
from train.fused import FusedField
from train.objective import Extra
from train.preset import PartPreset, Preset
from train.rays import RayTensors
from train.trainer import UNSAVED, UNWATCHED, Checkpoints, FieldTraining, Watch, train_field
from train.weight_file import read_weights


class ZeroLevel(NamedTuple):
    """Seeds moved onto a part's displayed surface by Newton's method."""

    points: Float[Array, "n 3"]  # canonical, metres
    # within a millimetre of the level and 2 cm of the seed
    arrived: Bool[Array, "n"]
    normals: Float[Array, "n 3"]  # unit, canonical


def zero_level(fused: FusedField, index: int, seeds: Float[Array, "n 3"], normals: Float[Array, "n 3"]) -> ZeroLevel:
    """Points where part `index` shows its surface, F(x + mean T_nr(x)) = 0, found from seeds near it."""
    at = torch.as_tensor(seeds, dtype=torch.float32, device=fused.device)
    start, gradient = at.clone(), torch.as_tensor(normals, dtype=torch.float32, device=fused.device)
    for _ in range(4):
        sample, gradient = fused.part_gradient(index, at)
        slope = gradient.square().sum(-1, keepdim=True).clamp_min(0.1)
        at = at - (sample.distance[:, None] * gradient / slope).clamp(-0.01, 0.01)
    with torch.no_grad():
        left = fused.part_distance(index, at).abs()
    arrived = (left < 1e-3) & ((at - start).norm(dim=1) < 0.02)
    unit = torch.nn.functional.normalize(gradient, dim=1)
    points, unit = (array.cpu().numpy().astype(np.float64) for array in (at, unit))
    return ZeroLevel(points, arrived.cpu().numpy(), unit)


def in_overlap(shares: Float[Tensor, "n p"], index: int) -> Bool[Tensor, "n"]:
    """Where both the body and part `index` have a weight: the intersection region of Eq. 7 to 9."""
    return (shares[:, index] > 0) & (shares[:, index] < 1)


def overlap_surface(fused: FusedField, subject: CaptureSubject) -> list[Float[Tensor, "_ 3"]]:
    """S_j of Eq. 7 for head and hands: at most 1500 points of the part's zero level in its overlap with the body."""
    faces = np.asarray(subject.faces)[visible_faces(subject)]
    middle = torch.as_tensor(subject.vertices[faces].mean(1), dtype=torch.float32, device=fused.device)
    shares = fused.shares(middle).cpu()
    out = []
    for index in range(1, len(fused.fields)):
        near = faces[in_overlap(shares, index).numpy()]
        seeds = lattice_samples(subject.vertices, near, np.full(len(near), 0.006))
        normals = face_normals(subject.vertices, near)[seeds.face]
        level = zero_level(fused, index, seeds.on(subject.vertices, near), normals)
        points = torch.as_tensor(level.points[level.arrived], dtype=torch.float32, device=fused.device)
        points = points[in_overlap(fused.shares(points), index)]
        out.append(points[:: -(-len(points) // 1500) or 1])
    return out


def geometry_loss(
    fused: FusedField, surfaces: list[Float[Tensor, "_ 3"]], parts: tuple[PartPreset, ...], preset: Preset
) -> Extra:
    """L_g, Eq. 7: mean |s_body - s_part| over the batch's samples in an overlap, and mean |s_body| on S_part.

    A batch gives points y = x + T_nr(x, code of the frame) and s_body(y). The fused query adds the mean T_nr
    instead: y is shown at x = y - mean T_nr(y) (to first order), and there the part is asked as the fused query
    asks it, moved by Eq. 5 and displaced by its own mean. Of the samples in an overlap only those count that lie in
    the band of the part's own rays: farther from its template the part's field was never supervised, and its
    value there is no reason to move the body.
    """
    body = fused.field(0)
    with torch.no_grad():
        places = [fused.local(0, points)[0] for points in surfaces]

    def loss(points: Tensor, distance: Tensor) -> Tensor:
        """L_g at points where the body's distance is `distance`."""
        with torch.no_grad():
            shown = points - body.displacement.mean(body.unit(points))
            shares = fused.shares(shown)
        apart, count = torch.zeros((), device=points.device), 0
        for index in range(1, len(fused.fields)):
            chosen = in_overlap(shares, index).nonzero()[:, 0]
            with torch.no_grad():
                local, _ = fused.local(index, shown[chosen])
                away = fused.field(index).template(local)
                band = parts[index].band
                supervised = (away < band.outside) & (away > -band.inside)
                chosen, local = chosen[supervised], local[supervised]
                other = fused.field(index)(local).distance / fused.scale(index)
            apart = apart + (distance[chosen] - other).abs().sum()
            count += len(chosen)
        on = body(torch.cat(places)).distance.abs()
        return preset.union.consistency * apart / max(count, 1) + preset.union.surface * on.sum() / max(len(on), 1)

    return loss


def steps_apart(fused: FusedField, surfaces: list[Float[Tensor, "_ 3"]]) -> dict[str, float]:
    """Mean |s_body| on each part's surface in the overlap, millimetres: what L_g is to remove."""
    with torch.no_grad():
        steps = [fused.part_distance(0, points).abs() for points in surfaces]
    names = PARTS[1:]
    return {name: round(float(step.mean()) * 1000, 3) for name, step in zip(names, steps) if len(step)}


def train_union(
    fused: FusedField, subject: CaptureSubject, rays: RayTensors, preset: Preset, *, seed: int,
    checkpoints: Checkpoints = UNSAVED, watch: Watch = UNWATCHED,
) -> dict:  # fmt: skip
    """Stage 2: train the body of `fused` in place from where it stands, the other parts fixed; says what it did.

    The body's rays and losses are stage 1's, with L_g added; the surface is as narrow as stage 1 left it and the
    learning rates are a share of stage 1's.
    """
    device, union = rays.ends.device, preset.union
    body = fused.to(device).field(0)
    surfaces = overlap_surface(fused, subject)
    before = steps_apart(fused, surfaces)
    part = replace(preset.parts[0], iterations=union.iterations)
    settings = replace(
        preset, grid_rate=preset.grid_rate * union.rate, network_rate=preset.network_rate * union.rate,
        displacement_rate=preset.displacement_rate * union.rate, warm_up=union.warm_up, last_rate=union.last_rate,
    )  # fmt: skip
    body.requires_grad_(True)
    try:
        extra = geometry_loss(fused, surfaces, preset.parts, preset)
        training = FieldTraining(part=part, preset=settings, seed=seed, extra=extra)
        at = train_field(body, rays, training, checkpoints=checkpoints, watch=watch)
    finally:
        body.requires_grad_(False)
    after = steps_apart(fused, surfaces)
    return {"steps": union.iterations, "skipped": at.skipped, "step_mm_before": before, "step_mm_after": after}


def write_rays(path: Path, rays: RayTensors) -> None:
    """The prepared rays of stage 1, kept for stage 2 and Eq. 8."""
    with whole_file(path) as file:
        torch.save(asdict(rays), file)


def read_rays(path: Path, device: torch.device) -> RayTensors:
    """Rays that `write_rays` left.

    Raises:
        AssetError: no such file, or not such rays.
    """
    what = "the body's rays of this training"
    content = read_weights(path, what, device)
    with unusable(f"{path}: expected {what}, found"):
        return RayTensors(**content)
