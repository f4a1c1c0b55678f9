"""Variants of a finished run: the paper's ablations that need no training of their own, and what a seam measures.

    ours                 the run itself
    landmarks_only       the head where its landmarks put it (Eq. 6), without Eq. 5 and its own video; the body is ours
    no_L_g               the body as stage 1 left it (Eq. 7 and 13 undone); head's place and codes are ours
    no_codes_no_fusion   every part with the mean of its own codes (no Eq. 8), colour switched, not blended (no Eq. 9)
    no_fusion            matched codes, colour switched
    filled_eyes          round the eyes the surface as the head's field learnt it, without train/eye_grid.py
    one_surface          hair and body as one surface, without capture/template/layers.py (ours where no hair hangs)

Switched: the part of the largest weight gives all of the colour, so the border lies in the middle of the overlap,
where both fields are equally at home. (At the border of the part's box, where the authors' code switches, the
part's own video has hardly seen the surface: that would measure the rim of a training box.) Eq. 9 is about colour:
the blended geometry is the same in all variants whose fields are.

Where the geometry differs the surface is extracted anew and its view statistics measured on it.
"""

import copy
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from avatar.skeleton import PARTS
from capture.fit.refine import with_refined
from capture.folder import Capture
from capture.template.parts import part_boxes
from capture.template.views import statistics
from train.compose import displayed_surface, view_sums, with_views
from train.field import PartField
from train.fused import FusedField, eq9_shares
from train.run import Run, read_part
from train.union import in_overlap

VARIANTS = ("ours", "landmarks_only", "no_L_g", "no_codes_no_fusion", "no_fusion", "filled_eyes", "one_surface")
SEAMS = ("neck", "wrist_left", "wrist_right")  # between the body and PARTS[1:]


def variant(run: Run, capture: Capture, name: str) -> Run:
    """A variant of a run of four parts; `run` is left as it is, trained parts are shared.

    Raises:
        ValueError: no such variant, or a run of a single network.
        AssetError: the run folder lacks what the variant needs.
    """
    if name not in VARIANTS:
        raise ValueError(f"variant should be one of {VARIANTS}, is {name!r}")
    if name == "ours":
        return run
    capture = with_refined(capture, run.path)
    if len(run.field.fields) == 1:
        raise ValueError(f"variant {name}: the run is one network, it has no parts to compose")
    facts: dict = {**run.provenance, "variant": name}
    fields = [run.field.field(index) for index in range(len(PARTS))]
    if name in ("no_fusion", "no_codes_no_fusion"):
        if name == "no_codes_no_fusion":
            fields = [_with_mean_code(field) for field in fields]
        field = _fused(run, fields, run.field.head_from_canonical, SwitchedField)
        return replace(run, field=field, provenance=facts)

    if name == "one_surface":
        run = replace(run, subject=replace(run.subject, under_hair=run.subject.under_hair[:0]))
    head_from_canonical = run.field.head_from_canonical
    canonical_from_head = np.linalg.inv(np.asarray(facts["head_from_canonical"], np.float64))
    if name == "landmarks_only":
        correction = np.asarray(facts["canonical_from_head_field"], np.float64)
        canonical_from_head = np.linalg.solve(correction, canonical_from_head)
        # the field is learnt where its own video put it (head_consistency.py): back to the landmarks' place
        moved = np.asarray(facts.get("registration", {}).get("own_video", {}).get("moved", np.eye(4)), np.float64)
        canonical_from_head = np.linalg.solve(moved, canonical_from_head)
        head_from_canonical = torch.as_tensor(moved, dtype=torch.float32)
        facts |= {"canonical_from_head_field": np.linalg.inv(moved).tolist(),
                  "head_from_canonical": np.linalg.inv(canonical_from_head).tolist()}  # fmt: skip
    elif name == "no_L_g":
        fields[0] = read_part(run.path / "body_stage1.pt", run.subject, 0, run.preset.parts[0])
    field = _fused(run, fields, head_from_canonical)
    if name == "filled_eyes":
        field.eyes = None
    shown = displayed_surface(field, run.subject, run.preset.surface_cells)
    shares = eq9_shares(torch.as_tensor(shown.vertices, dtype=torch.float32), part_boxes(run.subject)).numpy()
    sums = view_sums(capture, shown, shares, canonical_from_head)
    surface = with_views(shown, shares, [statistics(s) for s in sums])
    return replace(run, field=field, surface=surface, provenance=facts)


class SwitchedField(FusedField):
    """The color does not blend: the part of the largest weight gives all of it (ablation of Eq. 9)."""

    def color(self, points: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """As FusedField.color."""
        largest = lambda at: torch.nn.functional.one_hot(self.shares(at).argmax(1), len(self.fields)).to(at.dtype)
        return self.blend(largest, self.part_shown, points, directions)


def _fused(
    run: Run, fields: list[PartField], head_from_canonical: Float[Tensor, "4 4"], kind: type[FusedField] = FusedField
) -> FusedField:
    field = kind(fields, part_boxes(run.subject), head_from_canonical)
    field.seen, field.eyes = run.field.seen, run.field.eyes
    return field.to(run.field.head_from_canonical.device).eval().requires_grad_(False)


def _with_mean_code(field: PartField) -> PartField:
    field = copy.deepcopy(field)
    field.reference.copy_(field.appearance.weight.detach().mean(0))
    return field


def seam_steps(run: Run) -> dict[str, dict[str, float]]:
    """How far the body and each part are from agreeing, over the surface of their overlap that a video saw.

        step_mm             mean |s_part - s_body|
        color_step          mean |c_part - c_body|, of 255, seen along the mean direction (Eq. 14)
        shown_color_step    mean difference of the colours shown 1 mm to either side of the overlap's middle;
                            with blended colours (Eq. 9) what is left is the texture's own change over 2 mm

    A run of one network has no seams: no entries.
    """
    field, surface = run.field, run.surface
    device = field.head_from_canonical.device
    points = torch.as_tensor(surface.vertices, dtype=torch.float32, device=device)
    directions = torch.as_tensor(surface.view_mean, dtype=torch.float32, device=device)
    directions = torch.nn.functional.normalize(directions, dim=1)
    seen = torch.as_tensor(surface.view_count > 0, device=device)
    out = {}
    for index, name in enumerate(SEAMS[: len(field.fields) - 1], start=1):
        chosen = in_overlap(field.shares(points), index) & seen
        if not chosen.any():
            continue
        here, along = points[chosen], directions[chosen]
        with torch.no_grad():
            apart = (field.part_distance(index, here) - field.part_distance(0, here)).abs()
        colors = (field.part_color(index, here, along) - field.part_color(0, here, along)).abs()
        out[name] = {
            "step_mm": round(float(apart.mean()) * 1000, 3),
            "color_step": round(float(colors.mean()) * 255, 2),
            "shown_color_step": round(_shown_step(field, index, here, along), 2),
        }
    return out


def _shown_step(field: FusedField, index: int, points: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"]) -> float:
    """Mean change of the displayed colour, of 255, from 1 mm before to 1 mm behind the middle of the overlap."""
    share, slope = _share_and_slope(field, index, points)
    length = slope.norm(dim=1, keepdim=True)
    middle = (share - 0.5).abs() < 0.003 * length[:, 0]  # within 3 mm of it
    if not middle.any():
        return float("nan")
    across = slope[middle] / length[middle]
    at = points[middle] - across * ((share[middle, None] - 0.5) / length[middle])
    after = field.color(at + 0.001 * across, directions[middle])
    before = field.color(at - 0.001 * across, directions[middle])
    return float((after - before).abs().mean()) * 255


def _share_and_slope(
    field: FusedField, index: int, points: Float[Tensor, "n 3"]
) -> tuple[Float[Tensor, "n"], Float[Tensor, "n 3"]]:
    """Eq. 9's weight of a part and its gradient, per metre."""
    with torch.enable_grad():
        points = points.detach().requires_grad_()
        share = field.shares(points)[:, index]
        (slope,) = torch.autograd.grad(share.sum(), points)
    return share.detach(), slope
