"""Stage 2 of TotalSelfScan (3.3): four trained parts become one person with one surface.

In order: the head's place on the body (Eq. 5), the fused field's zero set as a mesh, the directions it was seen
from (Eq. 14), and the parts' appearance codes (Eq. 8).
"""

import time
from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float

from train.appearance import match_appearance
from train.capture import PARTS, Capture, Subject
from train.field import PartField
from train.fused import FusedField
from train.mesh import vertex_normals
from train.parts import part_boxes
from train.preset import Preset
from train.register import Registration, refine_by_surfaces
from train.skin import CanonicalSkin
from train.surface import Surface, extract_surface, fill_from_neighbours
from train.views import ViewStatistics, ViewSums, fused_statistics, part_views, statistics

Array = np.ndarray
Say = Callable[[str], None]  # takes the lines that tell how far the work is


def compose(
    capture: Capture, fields: list[PartField], preset: Preset, landmarks: Registration, seed: int,
    seconds: dict[str, float], say: Say,
) -> tuple[Surface, list[ViewStatistics], dict]:  # fmt: skip
    """The surface with its fused statistics, each part's own statistics, and what run.json says of all this.

    `landmarks` is canonical_from_head of Eq. 6. Sets the parts' reference codes in place and adds the time of
    each step to `seconds`.
    """
    subject, parts = capture.subject, part_boxes(capture.subject)
    began = time.monotonic()
    correction = register_head(subject, fields)
    say(f"head surface on the body's (Eq. 5): median {correction.residual * 1000:.2f} mm point to plane")
    head_from_canonical = torch.tensor(np.linalg.inv(correction.transform), dtype=torch.float32)
    fused = FusedField(fields, parts, head_from_canonical).eval().requires_grad_(False)
    seconds["registration"] = time.monotonic() - began

    began = time.monotonic()
    body_cell, head_cell, hand_cell = preset.surface_cells
    vertices, faces = extract_surface(
        fused, parts, subject, body_cell=body_cell, head_cell=head_cell, hand_cell=hand_cell
    )
    points = torch.as_tensor(vertices, dtype=torch.float32)
    normals = fused.normal(points).numpy().astype(np.float64)
    shares = fused.shares(points).numpy()
    skin = CanonicalSkin(subject).of_mesh(vertices, faces, normals)
    seconds["surface"] = time.monotonic() - began
    say(f"surface: {len(vertices)} vertices, {len(faces)} faces")

    began = time.monotonic()
    canonical_from_head = correction.transform @ landmarks.transform
    sums: list[ViewSums] = []
    for index, name in enumerate(PARTS):
        moved = canonical_from_head if name == "head" else None
        sums.append(
            part_views(capture.videos[name], subject, vertices, normals, skin, shares[:, index] > 0, moved)
        )
    tables = [statistics(s) for s in sums]
    fused_table = fused_statistics(sums, shares)
    seen = fused_table.count > 0
    filled = fill_from_neighbours(fused_table.mean, seen, faces)  # unseen vertices: their count stays 0
    seconds["views"] = time.monotonic() - began
    say(f"view directions (Eq. 14): {float(seen.mean()):.1%} of the vertices seen")

    began = time.monotonic()
    matched = match_appearances(fused, points, shares, tables, preset, seed, say)
    seconds["appearance"] = time.monotonic() - began

    surface = Surface(
        vertices, faces, normals, shares.argmax(1), skin, fused_table.count, filled, fused_table.covariance
    )
    facts = {
        "head_from_canonical": np.linalg.inv(canonical_from_head).tolist(),
        "canonical_from_head_field": correction.transform.tolist(),
        "registration": {
            "landmarks_rms_mm": round(landmarks.residual * 1000, 3),
            "surfaces_median_mm": round(correction.residual * 1000, 3),
        },
        "appearance": matched,
    }
    return surface, tables, facts


def match_appearances(
    fused: FusedField, points: Float[torch.Tensor, "v 3"], shares: Float[Array, "v 4"],
    tables: Sequence[ViewStatistics], preset: Preset, seed: int, say: Say,
) -> dict[str, dict[str, float]]:  # fmt: skip
    """Eq. 8 for head and hands: on the vertices of their overlap with the body that both videos saw.

    Each is asked at the mean direction that the body video saw it from. A part with fewer than 50 such vertices
    keeps its mean code.
    """
    matched = {}
    for index in range(1, len(PARTS)):
        overlap = (shares[:, index] > 0) & (shares[:, index] < 1)
        overlap &= (tables[0].count > 0) & (tables[index].count > 0)
        count = int(overlap.sum())
        if count < 50:
            say(f"{PARTS[index]}: only {count} overlap vertices seen by both videos; code stays the mean")
            continue
        directions = tables[0].mean[overlap]
        directions = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9)
        before, after = match_appearance(
            fused, index, points[torch.as_tensor(overlap)], torch.as_tensor(directions).float(),
            steps=preset.appearance_steps, seed=seed,
        )  # fmt: skip
        matched[PARTS[index]] = {"before": round(before, 4), "after": round(after, 4), "points": count}
        say(f"{PARTS[index]}: overlap colours (Eq. 8) {before:.3f} -> {after:.3f} of the body's")
    return matched


def register_head(subject: Subject, fields: Sequence[PartField]) -> Registration:
    """Eq. 5 on template points of the face and neck, projected onto each field's own zero level.

    The transform is canonical_from_head_field: rigid, metres.
    """
    chosen = (subject.part == 1) & ~subject.hair
    seeds = subject.vertices[chosen]
    normals = vertex_normals(subject.vertices, subject.faces)[chosen]
    head, head_ok, _ = projected(fields[1], seeds, normals)
    body, body_ok, body_normals = projected(fields[0], seeds, normals)
    if head_ok.sum() < 100 or body_ok.sum() < 100:
        raise ValueError("head registration: the head or body field has no surface near the template's head")
    return refine_by_surfaces(head[head_ok], body[body_ok], body_normals[body_ok])


def projected(
    field: PartField, points: Float[Array, "n 3"], normals: Float[Array, "n 3"]
) -> tuple[Float[Array, "n 3"], Bool[Array, "n"], Float[Array, "n 3"]]:
    """Points moved onto the zero level by four Newton steps, whether they arrived, and the unit normals there.

    Arrived: within a millimetre of the level and 2 cm of where they began.
    """
    at = torch.as_tensor(points, dtype=torch.float32)
    start = at.clone()
    gradient = torch.as_tensor(normals, dtype=torch.float32)
    for _ in range(4):
        sample, gradient = field.with_gradient(at, create_graph=False)
        slope = gradient.square().sum(-1, keepdim=True).clamp_min(0.1)
        at = (at - (sample.distance[:, None] * gradient / slope).clamp(-0.01, 0.01)).detach()
    with torch.no_grad():
        left = field(at).distance.abs()
    ok = (left < 1e-3) & ((at - start).norm(dim=1) < 0.02)
    unit = torch.nn.functional.normalize(gradient.detach(), dim=1)
    return at.numpy().astype(np.float64), ok.numpy(), unit.numpy().astype(np.float64)
