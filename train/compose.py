"""The composition of four trained parts into one person with one surface (TotalSelfScan, 3.3).

In order: the head's place on the body (Eq. 5, then the body's pixels), the body refined to meet the parts (stage 2,
Eq. 7 and 13), the fused field's zero set as a mesh, the directions it was seen from (Eq. 14), and the parts'
appearance codes (Eq. 8).
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.spatial import KDTree

from avatar.similarity import Registration
from avatar.skeleton import PARTS
from avatar.skinning import SkinWeights
from capture.folder import Capture, CaptureSubject, PartVideo
from capture.register.head_consistency import place_by_consistency
from capture.register.head_height import height_by_outline
from capture.register.photometric import ColoredHead, refine_on_video
from capture.template.layers import BODY, without_hair
from capture.template.parts import part_boxes, rigid_weights
from capture.template.views import ViewStatistics, ViewSums, fused_statistics, part_views, statistics
from command.workers import on_all_cores
from geometry.harmonic import fill_reached
from geometry.icp import Anchors, refine_by_surfaces
from geometry.mesh import TriangleMesh, restricted, vertex_normals
from train.appearance import match_appearance, overlap_rays
from train.eye_grid import OpenEyes, filmed_eyes
from train.field import PartField
from train.fused import FusedField, eq9_shares, part_weight
from train.light import SeenLight, VideoLight, light_facts, seen_lights_from_json
from train.preset import Preset
from train.rays import RayTensors
from train.skin import CanonicalSkin
from train.surface import Surface, extract_surface
from train.trainer import UNSAVED, UNWATCHED, Checkpoints, Watch
from train.union import train_union, zero_level

# takes a line that says what was done
Say = Callable[[str], None]


@contextmanager
def timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    began = time.monotonic()
    yield
    seconds[name] = time.monotonic() - began


@dataclass(frozen=True)
class HeadPlacement:
    """Where the head's video and the head's field lie on the body."""

    # from the head's video frame to where the head's field is learned: Eq. 6, refined on the head's own video where
    # the preset says so (head_consistency.py, head_height.py); the residual is Eq. 6's
    landmarks: Registration
    # Eq. 5, then the body's pixels: canonical_from_head_field, a similarity near the identity
    correction: Float[Array, "4 4"]
    # what run.json says of it
    facts: dict[str, Any]

    @property
    def canonical_from_head(self) -> Float[Array, "4 4"]:
        """From the head's video frame to the canonical one, by all that is known."""
        return self.correction @ self.landmarks.transform


@dataclass(frozen=True, kw_only=True)
class TrainedParts:
    # in the order of PARTS; one: a single network, which stands for everyone
    fields: list[PartField]
    # the body's; None for a single network, and where nothing was learned
    rays: RayTensors | None
    # before composition only Eq. 6 is known of the parts' head; a single network learned it where it lies in the end
    head: HeadPlacement
    seed: int
    # those of the parts' videos, where the fields' colors are albedo; empty: they are what was shown
    lights: Mapping[str, VideoLight]
    # what each part took, and each step of composition, which are added
    seconds: dict[str, float]


@dataclass(frozen=True)
class Composition:
    # with its fused statistics
    surface: Surface
    # that the surface shows; None: the head's field as it was learned
    eyes: OpenEyes | None
    # what run.json says of it
    facts: dict[str, Any]


def compose(
    capture: Capture, parts: TrainedParts, preset: Preset, say: Say, *, checkpoints: Checkpoints = UNSAVED,
    watch: Watch = UNWATCHED, device: str = "cpu",
) -> Composition:  # fmt: skip
    """Four parts into one person with one surface; refines the body (stage 2) and sets the reference codes in place.

    `checkpoints` and `watch` are stage 2's. Without rays there is nothing to register, refine or match.
    """
    subject, rays, seconds = capture.subject, parts.rays, parts.seconds
    head, head_from_field = parts.head, np.eye(4)
    with timed(seconds, "registration"):
        lights = light_facts(capture, parts.lights) if parts.lights else {}
        seen = seen_lights_from_json("light_seen", lights["light_seen"]) if lights else None
        if rays is not None:
            head = place_head(capture, parts.fields, head, say, seen, outlines=preset.hair.consistency)
            head_from_field = head.correction
        facts = placement_facts(head, head_from_field) | lights
        inverse = torch.tensor(np.linalg.inv(head_from_field), dtype=torch.float32)
        fused = FusedField(parts.fields, part_boxes(subject), inverse)
        fused.seen = seen
    if preset.open_eyes and len(parts.fields) > 1:
        with timed(seconds, "eyes"):
            closed = fused.field(PARTS.index("head")).template.cpu()
            filmed = filmed_eyes(subject, closed, capture.videos["head"], head.canonical_from_head)
        fused.eyes = filmed.eyes
        if filmed.fit is not None:
            facts["iris"] = filmed.fit.facts()
        say(f"eyes: {filmed.in_words()}")
    fused.to(device).eval().requires_grad_(False)

    if rays is not None and preset.union.iterations:
        say(f"stage 2: the body meets the parts (Eq. 7, 13), {preset.union.iterations} steps")
        parts.fields[0].light = parts.lights["body"].tensors(torch.device(device)) if parts.lights else None
        with timed(seconds, "union"):
            union = train_union(fused, subject, rays, preset, seed=parts.seed, checkpoints=checkpoints, watch=watch)
        parts.fields[0].light = None
        facts["union"] = union
        for name, step in union["step_mm_after"].items():
            before = union["step_mm_before"][name]
            say(f"{name}: body {before:.2f} -> {step:.2f} mm from the part's surface in the overlap")

    with timed(seconds, "surface"):
        shown = displayed_surface(fused, subject, preset.surface_cells)
    say(f"surface: {len(shown.vertices)} vertices, {len(shown.faces)} faces")
    with timed(seconds, "views"):
        points = torch.as_tensor(shown.vertices, dtype=torch.float32)
        shares = eq9_shares(points, part_boxes(subject)).numpy()
        tables = [statistics(s) for s in view_sums(capture, shown, shares, head.canonical_from_head)]
        surface = with_views(shown, shares, tables)
    say(f"view directions (Eq. 14): {float((surface.view_count > 0).mean()):.1%} of the vertices seen")
    if rays is not None:
        with timed(seconds, "appearance"):
            facts["appearance"] = match_appearances(fused, rays, surface.vertices, tables, preset, parts.seed, say)
    fused.cpu()
    return Composition(surface, fused.eyes, facts)


def placement_facts(head: HeadPlacement, canonical_from_head_field: Float[Array, "4 4"]) -> dict[str, Any]:
    """What run.json says of the head's place."""
    return {
        "registration": head.facts,
        "head_from_canonical": np.linalg.inv(head.canonical_from_head).tolist(),
        "canonical_from_head_field": canonical_from_head_field.tolist(),
    }


def landmark_placement(landmarks: Registration) -> HeadPlacement:
    """The head where its landmarks put it (Eq. 6), before any surface is known."""
    return HeadPlacement(landmarks, np.eye(4), {"landmarks_rms_mm": round(landmarks.residual * 1000, 3)})


def consistent_placement(capture: Capture, landmarks: Registration, say: Say) -> HeadPlacement:
    """The head where its own video shows its skin alike in all frames, before any surface is known.

    Where the frames give no answer the landmarks' place stays, and that is said.
    """
    placed = landmark_placement(landmarks)
    video = capture.videos["head"]
    try:
        found = place_by_consistency(capture.subject, video, landmarks.transform, landmark_anchors(capture, landmarks))
    except ValueError as error:
        say(f"the head's video does not place the template ({error}): the place by landmarks stays (Eq. 6)")
        return placed
    say(f"head by its own video: moved by {found.moved * 1000:.2f} mm from the landmarks' place")
    own = Registration(found.canonical_from_head, landmarks.residual)
    place, outline = placed_by_outline(capture, own, found.canonical_from_head, say)
    facts = _fit_facts(found.moved, found.before, found.after) | {
        "outline": outline,
        "moved": (place @ np.linalg.inv(landmarks.transform)).tolist(),
    }
    return HeadPlacement(Registration(place, landmarks.residual), np.eye(4), {**placed.facts, "own_video": facts})


def placed_by_outline(
    capture: Capture, landmarks: Registration, canonical_from_head: Float[Array, "4 4"], say: Say
) -> tuple[Float[Array, "4 4"], dict[str, Any] | None]:
    """canonical_from_head as high as the outlines of the head's bare skin have it, and what run.json says of it.

    Where the outlines say too little it stays, and that is said.
    """
    anchors = landmark_anchors(capture, landmarks)
    try:
        found = height_by_outline(capture.subject, capture.videos["head"], canonical_from_head, anchors)
    except ValueError as error:
        say(f"outlines say nothing of the head's height ({error})")
        return canonical_from_head, None
    say(f"head by its outlines: {-found.shift * 1000:+.2f} mm in height")
    facts = {"moved_mm": round(-found.shift * 1000, 3), "thickness_px": round(found.thickness, 3), "rows": found.rows}
    return found.canonical_from_head, facts


def place_head(
    capture: Capture, fields: Sequence[PartField], start: HeadPlacement, say: Say,
    seen: tuple[SeenLight, ...] | None = None, *, outlines: bool = False,
) -> HeadPlacement:  # fmt: skip
    """The head's place by the surfaces of body and head, the first two fields (Eq. 5), then by the body's pixels.

    `seen`, the parts' seen lights, where their colors are albedo; `outlines`, its height by its own video's outlines.
    """
    landmarks, facts = start.landmarks, dict(start.facts)
    anchors = landmark_anchors(capture, landmarks)
    correction, facts["surfaces_median_mm"] = place_on_surfaces(capture.subject, fields, anchors, say)
    correction, facts["video"] = place_on_video(capture, fields, correction, anchors, say, seen)
    head = HeadPlacement(landmarks, correction.transform, facts)
    if outlines:
        place, facts["outline"] = placed_by_outline(capture, landmarks, head.canonical_from_head, say)
        head = replace(head, correction=place @ np.linalg.inv(landmarks.transform))
    return head


class DisplayedSurface(NamedTuple):
    """The fused zero level as it is posed; canonical, metres."""

    vertices: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]
    normals: Float[Array, "vertices 3"]
    skin: SkinWeights
    layer: Int[Array, "vertices"]  # capture/template/layers.py


def displayed_surface(fused: FusedField, subject: CaptureSubject, cells: Sequence[float]) -> DisplayedSurface:
    """The fused zero level with its skin weights; `cells` of body, head and hands, metres."""
    (vertices, faces), layer = extract_surface(fused, part_boxes(subject), subject, cells)
    points = torch.as_tensor(vertices, dtype=torch.float32, device=fused.device)
    normals = fused.normal(points).cpu().numpy().astype(np.float64)
    if not layer.any():
        return DisplayedSurface(
            vertices, faces, normals, CanonicalSkin(subject).of_mesh(vertices, faces, normals), layer
        )
    # where a layer was cut off the field's gradient is no normal of it
    of_mesh = vertex_normals(vertices, faces)
    normals = np.where((of_mesh * normals).sum(1, keepdims=True) > 0.5, normals, of_mesh)
    return DisplayedSurface(vertices, faces, normals, layered_skin(subject, vertices, faces, normals, layer), layer)


def layered_skin(
    subject: CaptureSubject, vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"],
    normals: Float[Array, "vertices 3"], layer: Int[Array, "vertices"],
) -> SkinWeights:  # fmt: skip
    """Weights of a surface of two layers: the body's from the template without hair, the hair's the head's."""
    skin = rigid_weights(len(vertices))
    body = layer == BODY
    own = CanonicalSkin(without_hair(subject)).of_mesh(*restricted(TriangleMesh(vertices, faces), body), normals[body])
    skin.joints[body], skin.weights[body] = own.joints, own.weights
    return skin


def view_sums(
    capture: Capture, shown: DisplayedSurface, shares: Float[Array, "vertices 4"],
    canonical_from_head: Float[Array, "4 4"],
) -> list[ViewSums]:  # fmt: skip
    """Of each part's video, the directions that the vertices with a share in that part were seen from."""

    def of_part(video: PartVideo) -> ViewSums:
        """Those of one video."""
        place = canonical_from_head if video.part == "head" else None
        inside = shares[:, PARTS.index(video.part)] > 0
        return part_views(video, capture.subject, shown.vertices, shown.normals, shown.skin, inside, place)

    return list(on_all_cores(of_part, (capture.videos[name] for name in PARTS)))


def with_views(
    shown: DisplayedSurface, shares: Float[Array, "vertices 4"], tables: Sequence[ViewStatistics]
) -> Surface:
    """The surface with the parts' statistics fused by their shares; unseen vertices take their neighbours' mean."""
    fused = fused_statistics(tables, shares)
    filled = fill_reached(fused.mean, fused.count > 0, shown.faces)  # their count stays 0
    return Surface(shown.vertices, shown.faces, shown.normals, shares.argmax(1), shown.skin, fused.count, filled,
                   fused.covariance, shown.layer)  # fmt: skip


def match_appearances(
    fused: FusedField, rays: RayTensors, vertices: Float[Array, "vertices 3"], tables: Sequence[ViewStatistics],
    preset: Preset, seed: int, say: Say,
) -> dict[str, dict[str, float]]:  # fmt: skip
    """Eq. 8 for head and hands, over the body video's rays that meet the surface in their overlap with the body.

    Only places that the part's own video saw count. A part with fewer than 50 such rays keeps its mean code.
    """
    matched, tree = {}, KDTree(vertices)
    for index in range(1, len(PARTS)):
        points, directions = overlap_rays(fused, index, rays)
        nearest = tree.query(points.cpu().numpy())[1]
        seen = torch.as_tensor(tables[index].count[nearest] > 0, device=points.device)
        points, directions = points[seen], directions[seen]
        if len(points) < 50:
            say(f"{PARTS[index]}: only {len(points)} rays in the overlap that its video saw; code stays the mean")
            continue
        before, after = match_appearance(fused, index, points, directions, preset, seed)
        matched[PARTS[index]] = {"before": round(before, 4), "after": round(after, 4), "rays": len(points)}
        say(f"{PARTS[index]}: overlap colors (Eq. 8) {before:.3f} -> {after:.3f} of the body's, {len(points)} rays")
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
        head.points[head.arrived], body.points[body.arrived], body.normals[body.arrived],
        source_normals=head.normals[head.arrived], anchors=anchors,
    )  # fmt: skip


def place_on_video(
    capture: Capture, fields: Sequence[PartField], correction: Registration, anchors: Anchors, say: Say,
    seen: tuple[SeenLight, ...] | None,
) -> tuple[Registration, dict[str, Any]]:  # fmt: skip
    """The head's place of Eq. 5 refined on the body's video, and what run.json says of it.

    Where the pixels give no answer, Eq. 5's stays, and that is said.
    """
    subject = capture.subject
    apart = FusedField(fields, part_boxes(subject), torch.eye(4))
    apart.seen = seen
    own = (subject.part == 1) & (part_weight(torch.as_tensor(subject.vertices), apart.parts[1]).numpy() > 0.5)
    chosen = np.flatnonzero(own)
    normals = vertex_normals(subject.vertices, subject.faces)[chosen]
    level = zero_level(apart, 1, subject.vertices[chosen], normals)
    points, inwards = (
        torch.as_tensor(a[level.arrived], dtype=torch.float32, device=apart.device)
        for a in (level.points, -level.normals)
    )
    colors = apart.part_shown(1, points, inwards).detach().cpu().numpy().astype(np.float64)
    head = ColoredHead(chosen[level.arrived], level.points[level.arrived], colors)
    try:
        fit = refine_on_video(subject, head, capture.videos["body"], correction.transform, anchors)
    except ValueError as error:
        say(f"the body's video does not place the head ({error}): the surfaces' place (Eq. 5) stays")
        return correction, {"kept": "surfaces", "why": str(error)}
    before, after = (head.points @ T[:3, :3].T + T[:3, 3] for T in (correction.transform, fit.transform))
    moved = float(np.linalg.norm(after - before, axis=1).mean())
    say(f"head on the body's video: moved by {moved * 1000:.2f} mm, residual {fit.before:.4f} -> {fit.after:.4f}")
    return Registration(fit.transform, correction.residual), _fit_facts(moved, fit.before, fit.after)


def _fit_facts(moved: float, before: float, after: float) -> dict[str, Any]:
    """What run.json says of a fit to a video that moved the head by so many metres; residuals of colors."""
    return {"moved_mm": round(moved * 1000, 3), "residual_before": round(before, 5), "residual_after": round(after, 5)}
