"""The composition of four trained parts into one person with one surface (TotalSelfScan, 3.3).

In order: the head's place on the body (Eq. 5, then the body's pixels), the body refined to meet the parts (stage 2,
Eq. 7 and 13), the
fused field's zero set as a mesh, the directions it was seen from (Eq. 14), and the parts' appearance codes (Eq. 8).
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import KDTree

from avatar.similarity import Registration
from avatar.skeleton import PARTS
from avatar.skinning import SkinWeights
from capture.folder import Capture, CaptureSubject
from capture.views import ViewStatistics, ViewSums, fused_statistics, part_views, statistics
from geometry.mesh import vertex_normals
from geometry.register import Anchors, refine_by_surfaces
from train.appearance import match_appearance, overlap_rays
from train.field import PartField
from train.fused import FusedField
from train.objective import RayTensors, StepReport
from train.parts import eq9_shares, part_boxes, part_weight
from train.photometric import ColoredHead, refine_on_video
from train.preset import Preset
from train.skin import CanonicalSkin
from train.surface import Surface, extract_surface, fill_from_neighbours
from train.union import train_union, zero_level

Array = np.ndarray
# takes the lines that tell how far the work is
Say = Callable[[str], None]


def compose(
    capture: Capture, fields: list[PartField], preset: Preset, landmarks: Registration, seed: int,
    seconds: dict[str, float], say: Say, *, rays: RayTensors | None, checkpoint: Path | None = None,
    resume: bool = False, report: Callable[[int, StepReport], None] | None = None,
) -> tuple[Surface, list[ViewStatistics], dict]:  # fmt: skip
    """The surface with its fused statistics, each part's own statistics, and what run.json says of all this.

    `landmarks` is canonical_from_head of Eq. 6, `rays` are the body's. Refines the body (stage 2, with its
    `checkpoint` and `report`) and sets the parts' reference codes in place; adds the time of each step to
    `seconds`. A single field, which stands for everyone, has nothing to register, refine or match; its `rays`
    are None.
    """
    subject, parts = capture.subject, part_boxes(capture.subject)
    facts: dict = {"registration": {"landmarks_rms_mm": round(landmarks.residual * 1000, 3)}}
    began = time.monotonic()
    correction = Registration(np.eye(4), 0.0)
    if rays is not None:
        anchors = landmark_anchors(capture, landmarks)
        correction, facts["registration"]["surfaces_median_mm"] = place_on_surfaces(subject, fields, anchors, say)
        correction, facts["registration"]["video"] = place_on_video(capture, fields, correction, anchors, say)
    head_from_canonical = torch.tensor(np.linalg.inv(correction.transform), dtype=torch.float32)
    fused = FusedField(fields, parts, head_from_canonical).eval().requires_grad_(False)
    canonical_from_head = correction.transform @ landmarks.transform
    facts["head_from_canonical"] = np.linalg.inv(canonical_from_head).tolist()
    facts["canonical_from_head_field"] = correction.transform.tolist()
    seconds["registration"] = time.monotonic() - began

    if rays is not None and preset.union.iterations:
        began = time.monotonic()
        say(f"stage 2: the body meets the parts (Eq. 7, 13), {preset.union.iterations} steps")
        facts["union"] = train_union(
            fused, subject, rays, preset, seed=seed, checkpoint=checkpoint, resume=resume, report=report
        )
        seconds["union"] = time.monotonic() - began
        for name, step in facts["union"]["step_mm_after"].items():
            before = facts["union"]["step_mm_before"][name]
            say(f"{name}: body {before:.2f} -> {step:.2f} mm from the part's surface in the overlap")

    began = time.monotonic()
    vertices, faces, normals, skin = displayed_surface(fused, subject, preset.surface_cells)
    seconds["surface"] = time.monotonic() - began
    say(f"surface: {len(vertices)} vertices, {len(faces)} faces")

    began = time.monotonic()
    points = torch.as_tensor(vertices, dtype=torch.float32)
    shares = eq9_shares(points, parts).numpy()
    sums = view_sums(capture, vertices, normals, skin, shares, canonical_from_head)
    tables = [statistics(s) for s in sums]
    surface = with_views(vertices, faces, normals, skin, shares, tables)
    seconds["views"] = time.monotonic() - began
    say(f"view directions (Eq. 14): {float((surface.view_count > 0).mean()):.1%} of the vertices seen")

    if rays is not None:
        began = time.monotonic()
        here: dict[str, Any] = {name: value if value is None else value.cpu() for name, value in vars(rays).items()}
        facts["appearance"] = match_appearances(fused, RayTensors(**here), vertices, tables, preset, seed, say)
        seconds["appearance"] = time.monotonic() - began
    return surface, tables, facts


def displayed_surface(
    fused: FusedField, subject: CaptureSubject, cells: Sequence[float]
) -> tuple[Float[Array, "v 3"], Array, Float[Array, "v 3"], SkinWeights]:
    """Vertices, faces, normals and skin weights of the fused zero level; `cells` of body, head and hands, metres."""
    body, head, hand = cells
    vertices, faces = extract_surface(
        fused, part_boxes(subject), subject, body_cell=body, head_cell=head, hand_cell=hand
    )
    normals = fused.normal(torch.as_tensor(vertices, dtype=torch.float32)).numpy().astype(np.float64)
    return vertices, faces, normals, CanonicalSkin(subject).of_mesh(vertices, faces, normals)


def view_sums(
    capture: Capture, vertices: Float[Array, "v 3"], normals: Float[Array, "v 3"], skin: SkinWeights,
    shares: Float[Array, "v 4"], canonical_from_head: Float[Array, "4 4"],
) -> list[ViewSums]:  # fmt: skip
    """Of each part's video, the directions that the vertices with a share in that part were seen from."""
    return [
        part_views(capture.videos[name], capture.subject, vertices, normals, skin, shares[:, index] > 0,
                   canonical_from_head if name == "head" else None)
        for index, name in enumerate(PARTS)
    ]  # fmt: skip


def with_views(
    vertices: Float[Array, "v 3"], faces: Array, normals: Float[Array, "v 3"], skin: SkinWeights,
    shares: Float[Array, "v 4"], tables: Sequence[ViewStatistics],
) -> Surface:  # fmt: skip
    """The surface with the parts' statistics fused by their shares; unseen vertices copy their neighbours' mean."""
    fused = fused_statistics(tables, shares)
    filled = fill_from_neighbours(fused.mean, fused.count > 0, faces)  # their count stays 0
    return Surface(vertices, faces, normals, shares.argmax(1), skin, fused.count, filled, fused.covariance)


def match_appearances(
    fused: FusedField, rays: RayTensors, vertices: Float[Array, "v 3"], tables: Sequence[ViewStatistics],
    preset: Preset, seed: int, say: Say,
) -> dict[str, dict[str, float]]:  # fmt: skip
    """Eq. 8 for head and hands, over the body video's rays that meet the surface in their overlap with the body.

    Only places that the part's own video saw count. A part with fewer than 50 such rays keeps its mean code.
    """
    matched, tree = {}, KDTree(vertices)
    for index in range(1, len(PARTS)):
        points, directions = overlap_rays(fused, index, rays)
        nearest = tree.query(points.numpy())[1]
        seen = torch.as_tensor(tables[index].count[nearest] > 0)
        points, directions = points[seen], directions[seen]
        if len(points) < 50:
            say(f"{PARTS[index]}: only {len(points)} rays in the overlap that its video saw; code stays the mean")
            continue
        before, after = match_appearance(
            fused,
            index,
            points,
            directions,
            steps=preset.appearance_steps,
            rate=preset.appearance_rate,
            seed=seed,
        )
        matched[PARTS[index]] = {"before": round(before, 4), "after": round(after, 4), "rays": len(points)}
        say(f"{PARTS[index]}: overlap colours (Eq. 8) {before:.3f} -> {after:.3f} of the body's, {len(points)} rays")
    return matched


def landmark_anchors(capture: Capture, landmarks: Registration) -> Anchors:
    """The landmarks where Eq. 6 put them, the template's places, and how far apart the two are."""
    video, moved = capture.videos["head"], landmarks.transform
    assert video.landmarks is not None and video.landmark_vertices is not None
    source = video.landmarks @ moved[:3, :3].T + moved[:3, 3]
    spread = max(landmarks.residual / np.sqrt(3), 1e-4)
    return Anchors(source, capture.subject.vertices[video.landmark_vertices], spread)


def place_on_surfaces(
    subject: CaptureSubject, fields: Sequence[PartField], anchors: Anchors, say: Say
) -> tuple[Registration, float | None]:
    """The head's place of Eq. 5 and the median distance of the surfaces, mm.

    Where the surfaces give no answer (spoilt masks leave little of a head to meet), the landmarks' place stays,
    and that is said: hours of training hang on it.
    """
    try:
        correction = register_head(subject, fields, anchors)
    except ValueError as error:
        say(f"{error}: the place by landmarks stays (Eq. 6)")
        return Registration(np.eye(4), float("nan")), None
    millimetres = correction.residual * 1000
    say(f"head surface on the body's (Eq. 5): median {millimetres:.2f} mm point to plane")
    return correction, round(millimetres, 3)


def register_head(subject: CaptureSubject, fields: Sequence[PartField], anchors: Anchors) -> Registration:
    """Eq. 5 on template points of the face and neck, moved onto each part's own displayed surface.

    The transform is canonical_from_head_field: a similarity near the identity, metres.
    """
    chosen = (subject.part == 1) & ~subject.hair
    seeds, normals = subject.vertices[chosen], vertex_normals(subject.vertices, subject.faces)[chosen]
    apart = FusedField(fields, part_boxes(subject), torch.eye(4))
    head, body = zero_level(apart, 1, seeds, normals), zero_level(apart, 0, seeds, normals)
    if head.arrived.sum() < 100 or body.arrived.sum() < 100:
        raise ValueError("head registration: the head or body field has no surface near the template's head")
    return refine_by_surfaces(
        head.points[head.arrived],
        body.points[body.arrived],
        body.normals[body.arrived],
        source_normals=head.normals[head.arrived],
        anchors=anchors,
    )


def place_on_video(
    capture: Capture, fields: Sequence[PartField], correction: Registration, anchors: Anchors, say: Say
) -> tuple[Registration, dict[str, Any]]:
    """The head's place of Eq. 5 refined on the body's video, and what run.json says of it.

    Where the pixels give no answer, Eq. 5's stays, and that is said.
    """
    subject = capture.subject
    apart = FusedField(fields, part_boxes(subject), torch.eye(4))
    own = (subject.part == 1) & (part_weight(torch.as_tensor(subject.vertices), apart.parts[1]).numpy() > 0.5)
    chosen = np.flatnonzero(own)
    normals = vertex_normals(subject.vertices, subject.faces)[chosen]
    level = zero_level(apart, 1, subject.vertices[chosen], normals)
    points, inwards = (torch.as_tensor(a[level.arrived], dtype=torch.float32) for a in (level.points, -level.normals))
    colors = apart.part_color(1, points, inwards).detach().numpy().astype(np.float64)
    head = ColoredHead(chosen[level.arrived], level.points[level.arrived], colors)
    try:
        fit = refine_on_video(subject, head, capture.videos["body"], correction.transform, anchors)
    except ValueError as error:
        say(f"the body's video does not place the head ({error}): the surfaces' place (Eq. 5) stays")
        return correction, {"kept": "surfaces", "why": str(error)}
    before, after = (head.points @ T[:3, :3].T + T[:3, 3] for T in (correction.transform, fit.transform))
    moved = float(np.linalg.norm(after - before, axis=1).mean())
    say(f"head on the body's video: moved by {moved * 1000:.2f} mm, residual {fit.before:.4f} -> {fit.after:.4f}")
    facts = {
        "moved_mm": round(moved * 1000, 3),
        "residual_before": round(fit.before, 5),
        "residual_after": round(fit.after, 5),
    }
    return Registration(fit.transform, correction.residual), facts
