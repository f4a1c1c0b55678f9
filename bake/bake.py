"""Run folder -> avatar file, in order: surface, decimation, atlas, skin, cone, colour, network, measurement."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Integer
from scipy.spatial import cKDTree

from avatar.avatar_file import Avatar, Level, ViewNetwork, write_avatar
from avatar.errors import AssetError
from avatar.skeleton import BIG_POSE, joint_transforms
from avatar.skinning import dense_weights, strongest_four
from bake import measure
from bake.atlas import unwrap
from bake.cone import ViewCone, interpolated, view_cone
from bake.decimate import Enlargement, balanced, decimate
from bake.network import AMPLITUDE, Distilled, SurfacePoints, distil, write_onnx
from bake.skin import quantised, transferred_weights
from bake.surface import (
    Extraction,
    Mesh,
    PointFunction,
    enclosed_volume,
    extract,
    face_areas,
    project_to_zero,
)
from bake.texels import TexelMap, barycentric, bytes_from_unit, rasterise_charts, sample_texels, spread
from bake.transfer import match_surface
from train.template import vertex_normals, visible_faces

BODY, HEAD, LEFT_HAND, RIGHT_HAND = range(4)
PARTS = ("body", "head", "hand_left", "hand_right")


@dataclass(frozen=True)
class BakeOptions:
    faces: int = 30_000  # triangles of the finest level
    texture: int = 2048  # its atlas, texels per side
    body_step: float = 0.005  # grid step of the extraction, metres
    fine_step: float = 0.0025  # the same along the spans of head and hands
    head_density: float = 2.5  # texels per metre, relative to the body's
    hand_density: float = 2.5
    head_scale: float = 1.8  # blown up so much while triangles are collapsed
    hand_scale: float = 2.4
    samples: int = 160_000  # surface points for the network
    steps: int = 1200  # of its training
    image: int = 512  # pixels per side of the pictures that are compared
    seed: int = 0

    def __post_init__(self):
        if self.faces < 200:
            raise ValueError(f"--faces should be at least 200, is {self.faces}")
        if self.texture < 64 or self.texture > 8192 or self.texture & (self.texture - 1):
            raise ValueError(f"--texture should be a power of two from 64 to 8192, is {self.texture}")


@runtime_checkable
class Field(Protocol):
    """What is baked: the fused field of a run, canonical frame, torch float32."""

    def distance(self, points: torch.Tensor) -> torch.Tensor: ...
    def normal(self, points: torch.Tensor) -> torch.Tensor: ...
    def color(self, points: torch.Tensor, directions: torch.Tensor) -> torch.Tensor: ...


class NumpyField(NamedTuple):
    """The field behind NumPy functions, asked in pieces so that memory stays bounded."""

    distance: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n"]]
    normal: Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]]
    color: Callable[[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]]


def numpy_field(field: Field, *, piece: int = 1 << 16) -> NumpyField:
    def ask(function: Callable[..., torch.Tensor], *arrays: np.ndarray) -> np.ndarray:
        pieces = []
        for start in range(0, len(arrays[0]), piece):
            tensors = [
                torch.from_numpy(np.ascontiguousarray(a[start : start + piece], np.float32)) for a in arrays
            ]
            pieces.append(function(*tensors).detach().cpu().numpy().astype(np.float64))
        return np.concatenate(pieces) if pieces else np.zeros((0, 3))

    return NumpyField(
        lambda points: ask(field.distance, points).reshape(-1),
        lambda points: ask(field.normal, points),
        lambda points, directions: ask(field.color, points, directions),
    )


class BakedLevel(NamedTuple):
    level: Level
    mesh: Mesh  # before the atlas split its vertices, float64
    facts: dict[str, Any]


def bake(
    run_path: Path | str,
    out: Path | str,
    faces: int = 30_000,
    texture: int = 2048,
    progress: Callable[[str], None] = print,
) -> Avatar:
    """Bake a run folder into NAME.glb (and NAME.onnx where a network is shipped)."""
    from train.run import read_run

    options = BakeOptions(faces=faces, texture=texture)
    run = read_run(Path(run_path))
    return bake_run(run, Path(out), options, progress)


def bake_run(run: Any, out: Path, options: BakeOptions, report: Callable[[str], None] = print) -> Avatar:
    """As `bake`, for a run already read: .field, .surface, .subject.joints, .provenance."""
    clock = _Clock(report)
    field = numpy_field(run.field)
    source = run.surface
    joints = np.asarray(run.subject.joints, np.float64)
    source_vertices = np.asarray(source.vertices, np.float64)
    source_faces = np.asarray(source.faces, np.int64)
    source_part = np.asarray(source.part, np.int64)
    source_normals = np.asarray(source.normals, np.float64)
    if enclosed_volume(Mesh(source_vertices, source_faces)) < 0:
        source_faces = source_faces[:, ::-1]  # only the normals of a run's surface are promised to face outwards

    extraction = extract(
        solid_inside(field.distance, run.subject),
        field.normal,
        source_vertices,
        source_part != BODY,
        coarse_step=options.body_step,
        fine_step=options.fine_step,
    )
    check_complete(extraction.mesh, source_vertices, source_part)
    clock(
        f"surface: {len(extraction.mesh.faces)} triangles on the zero set (1 in 1000 farther than {extraction.residual * 1e3:.3f} mm, "
        f"{extraction.queries / 1e6:.1f} M distances, {extraction.islands} islands dropped)"
    )

    cone = view_cone(
        np.asarray(source.view_count, np.float64),
        np.asarray(source.view_mean, np.float64),
        np.asarray(source.view_covariance, np.float64),
        source_normals,
        source_faces,
    )
    weights = dense_weights(source.skin, len(joints))
    origin = Origin(source_vertices, source_faces, source_part, cone, weights)
    fine = carried(origin, extraction.mesh, extraction.normals)
    clock(
        f"statistics: {float((cone.seen > 0.5).mean()) * 100:.0f} % of the surface seen, skin and cone carried over"
    )

    parts = enlargements(joints, options)
    plan = [(options.faces, options.texture)]
    for count, share in ((10_000, 2), (3_000, 4)):
        if count < options.faces:
            plan.append((count, max(64, options.texture // share)))
    levels: list[BakedLevel] = []
    distilled: Distilled | None = None
    for number, (count, size) in enumerate(plan):
        baked, surface_of = bake_level(extraction, origin, field, count, size, parts, options)
        if distilled is None:
            points = surface_points(field, baked, origin, options)
            clock(_level_line(number, baked.facts))
            distilled = distil(field.color, points, seed=options.seed, steps=options.steps, report=report)
            clock(f"view dependence: default view is {distilled.default_view}")
        baked = with_features(baked, distilled, surface_of, size)
        if number:
            clock(_level_line(number, baked.facts))
        levels.append(baked)
    assert distilled is not None

    provenance = {
        **run.provenance,
        "baked": {
            "faces": options.faces,
            "texture": options.texture,
            "seed": options.seed,
            "surface": {
                "triangles": len(extraction.mesh.faces),
                "residual_mm": _rounded(extraction.residual * 1e3),
                "islands_dropped": extraction.islands,
                "island_area_share": _rounded(extraction.island_area),
            },
            "levels": [baked.facts for baked in levels],
            "seen_share": _rounded(float((cone.seen > 0.5).mean())),
            "distilled_db": {k: _rounded(v) for k, v in distilled.decibels.items()},
        },
    }
    avatar = Avatar(
        name=str(run.provenance.get("subject", out.stem)),
        joint_positions=joints,
        canonical_pose=np.asarray(BIG_POSE, np.float64),
        levels=tuple(baked.level for baked in levels),
        network=distilled.network,
        linear=distilled.linear,
        amplitude=AMPLITUDE,
        default_view=distilled.default_view,
        provenance=provenance,
    )
    drawn = measure.FieldSurface(
        extraction.mesh, extraction.normals, strongest_four(fine.weights), fine.cone, joints, field.distance, field.color
    )
    score = measure.compare(avatar, drawn, measure.test_views(joints, options.image))
    worst = min(score.per_view, key=lambda name: score.per_view[name])
    clock(
        f"baked paper mode against the field: {score.paper_db:.1f} dB over {len(score.per_view)} pictures of "
        f"{options.image} px (worst {score.per_view[worst]:.1f}: {worst})"
    )
    for mode, db in score.view_db.items():
        report(f"  cone field against {mode}: {db:.1f} dB")
    provenance["baked"]["against_field"] = {
        "paper_db": _rounded(score.paper_db),
        "pixels": score.pixels,
        "image": options.image,
        "per_view_db": {k: _rounded(v) for k, v in score.per_view.items()},
        "cone_db": {k: _rounded(v) for k, v in score.view_db.items()},
    }
    avatar = replace(avatar, provenance=provenance)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_avatar(out, avatar)
    if distilled.network is not None:
        write_onnx(out.with_suffix(".onnx"), ViewNetwork(*_network_arrays(distilled.network)))
    clock(f"{out}: {out.stat().st_size / 1e6:.1f} MB")
    return avatar


class Origin(NamedTuple):
    """The run's own surface, which carries what was learnt per vertex."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Integer[np.ndarray, "faces 3"]
    part: Integer[np.ndarray, "vertices"]
    cone: ViewCone
    weights: Float[np.ndarray, "vertices joints"]


class Carried(NamedTuple):
    weights: Float[np.ndarray, "n joints"]
    cone: ViewCone
    part: Integer[np.ndarray, "n"]
    filled: int  # rows of weights that found no source nearby facing the same way


def carried(origin: Origin, mesh: Mesh, normals: Float[np.ndarray, "n 3"]) -> Carried:
    """Skin weights, cone and part of another mesh of the same surface."""
    match = match_surface(mesh.vertices, normals, origin.vertices, origin.faces)
    corners = origin.faces[match.face]
    weights, filled = transferred_weights(match, mesh.faces, origin.faces, origin.weights)
    nearest = np.take_along_axis(corners, match.barycentric.argmax(1)[:, None], 1)[:, 0]
    return Carried(
        weights, interpolated(origin.cone, corners, match.barycentric), origin.part[nearest], filled
    )


INSIDE = np.array([0.02, 0.015, 0.004, 0.004])  # metres: so deep inside the registered template is no surface


def solid_inside(distance: PointFunction, subject: Any) -> PointFunction:
    """The distance, made negative deep inside the subject's template (INSIDE, per part).

    Training samples a band around the template; deeper in, the field is whatever its network makes up, and its
    zero sets there are sheets inside the body, some of them joined to the skin through a pinhole. Only the
    faces that can be seen from outside count: mouth and eye sockets would turn the sign.
    """
    faces = np.asarray(subject.faces, np.int64)
    vertices = np.asarray(subject.vertices, np.float64)
    seen = np.unique(faces[visible_faces(subject)])
    normals = vertex_normals(vertices, faces)[seen]
    places = vertices[seen]
    part = np.asarray(subject.part, np.int64)[seen]
    tree, limit = cKDTree(places), INSIDE[part]
    hands = places[part >= LEFT_HAND]
    if len(hands):  # the hands' fields speak up to 10 cm beyond the wrist, where the part is body
        limit = np.where(cKDTree(hands).query(places)[0] < 0.12, np.minimum(limit, 0.006), limit)

    def solid(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        value = distance(points)
        # only what is positive, or nearly, can be wrong; an island deeper in is dropped as one
        doubtful = np.flatnonzero((value > -0.005) & (value < 0.06))
        away, near = tree.query(points[doubtful], k=4, distance_upper_bound=0.1, workers=-1)
        found = np.isfinite(away).all(1)
        doubtful, away, near = doubtful[found], away[found], near[found]
        # four vertices must agree: beside a sharp edge one normal alone can be wrong
        offset = points[doubtful][:, None] - places[near]
        behind = ((offset * normals[near]).sum(2) < -0.3 * away).all(1)
        deep = behind & (away[:, 0] > limit[near[:, 0]])
        value[doubtful[deep]] = -away[deep, 0]
        return value

    return solid


def check_complete(mesh: Mesh, vertices: np.ndarray, part: np.ndarray, limit: float = 0.03) -> None:
    """Every part of the run's surface must have the extracted one near it, else a part broke off."""
    away, _ = cKDTree(mesh.vertices).query(vertices, workers=-1)
    for label in np.unique(part):
        missing = float((away[part == label] > limit).mean())
        if missing > 0.1:
            raise AssetError(
                f"surface: {PARTS[int(label)]} should be one piece with the rest, but {missing * 100:.0f} % of it "
                f"is more than {limit * 100:.0f} cm from the largest piece (the field breaks there)"
            )


def enlargements(joints: Float[np.ndarray, "52 3"], options: BakeOptions) -> list[Enlargement]:
    """Head and hands of the canonical pose, to keep more triangles than their size asks for."""
    canonical = joint_transforms(np.asarray(BIG_POSE, np.float64), joints, np.zeros(3))[:, :3, 3]
    result = [Enlargement(canonical[15], np.array([0.0, 1.0, 0.0]), 0.25, options.head_scale)]
    for elbow, wrist in ((18, 20), (19, 21)):
        axis = canonical[wrist] - canonical[elbow]
        length = float(np.linalg.norm(axis))
        if length > 0:
            result.append(Enlargement(canonical[wrist], axis / length, 0.25, options.hand_scale))
    return result


def bake_level(
    extraction: Extraction,
    origin: Origin,
    field: NumpyField,
    count: int,
    size: int,
    parts: list[Enlargement],
    options: BakeOptions,
) -> tuple[BakedLevel, Callable[[TexelMap], SurfacePoints]]:
    """One level without its features, and the function that tells what its texels show."""
    coarse = decimate(extraction.mesh, count, parts)
    mesh = balanced(coarse, field.distance, field.normal)
    normals = field.normal(mesh.vertices)
    data = carried(origin, mesh, normals)

    face_part = np.sort(data.part[mesh.faces], axis=1)[
        :, 1
    ]  # the middle one of three is the majority's, or between
    density = np.array([1.0, options.head_density, options.hand_density, options.hand_density])
    # a gutter of 8 texels at 2048 keeps three mips clean
    padding = max(2, size // 256)
    chart = unwrap(mesh.vertices, mesh.faces, face_part, density, size=size, padding=padding)
    cone = ViewCone(*(value[chart.source] for value in data.cone))
    joints, weights = quantised(data.weights[chart.source])

    texels = rasterise_charts(chart.uv, chart.faces, size)
    corner_normals, corner_points = normals[chart.source], mesh.vertices[chart.source]

    def surface_at(some: TexelMap, jitter: np.ndarray) -> tuple[np.ndarray, np.ndarray, ViewCone]:
        weight = barycentric(chart.uv, chart.faces, some, jitter)
        corners = chart.faces[some.face]
        points = (weight[:, :, None] * corner_points[corners]).sum(1)
        near = np.clip(weight, 0, 1)
        near /= near.sum(1, keepdims=True)
        facing = (near[:, :, None] * corner_normals[corners]).sum(1)
        facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-20)
        return points, facing, interpolated(cone, corners, near)

    lift = np.zeros(len(texels.index))  # metres along the normal from the triangle to the zero set

    def color_at(rows: np.ndarray, jitter: np.ndarray) -> np.ndarray:
        result = np.empty((len(rows), 3))
        for start in range(0, len(rows), 1 << 18):
            own = rows[start : start + (1 << 18)]
            points, facing, local = surface_at(texels.rows(own), jitter)
            if jitter.any():
                points += lift[own, None] * facing  # the centre's lift serves the whole texel
            else:
                points, lift[own] = lifted(field, points, facing)
            result[start : start + (1 << 18)] = field.color(points, local.direction)
        return result

    color = sample_texels(color_at, texels)
    base = bytes_from_unit(spread(color, texels))
    level = Level(
        positions=mesh.vertices[chart.source].astype(np.float32),
        normals=corner_normals.astype(np.float32),
        uv=chart.uv.astype(np.float32),
        faces=chart.faces.astype(np.uint32),
        joints=joints,
        weights=weights,
        view_dir=cone.direction.astype(np.float32),
        view_q=cone.metric.astype(np.float32),
        view_seen=cone.seen.astype(np.float32),
        base_color=base,
        features=None,
    )
    away = measure.field_to_mesh(field.distance, mesh)
    seams = measure.seam_steps(chart.uv, chart.faces, chart.source, base)
    areas = face_areas(mesh.vertices, mesh.faces)
    facts: dict[str, Any] = {
        "faces": len(mesh.faces),
        "vertices": len(level.positions),
        "charts": chart.charts,
        "texture": size,
        "utilisation": _rounded(chart.utilisation),
        "field_to_mesh_mm": {"mean": _rounded(away.mean() * 1e3), "max": _rounded(away.max() * 1e3)},
        "seam_step": {
            "median": _rounded(float(np.median(seams)) if len(seams) else 0.0),
            "p99": _rounded(float(np.quantile(seams, 0.99)) if len(seams) else 0.0),
        },
        "faces_by_part": {PARTS[p]: int((face_part == p).sum()) for p in range(4)},
        "texel_mm_by_part": _texel_sizes(
            chart.uv, chart.faces, chart.face_part, mesh, areas, face_part, size
        ),
        "weights_filled": data.filled,
    }

    def surface_of(some: TexelMap) -> SurfacePoints:
        points, facing, local = surface_at(some, np.zeros(2))
        points, _ = lifted(field, points, facing)
        base_unit = base.reshape(size * size, 3) / 255.0
        scale = size // some.size
        row, column = some.index // some.size, some.index % some.size
        middle = (row * scale + scale // 2) * size + column * scale + scale // 2
        return SurfacePoints(points, facing, base_unit[middle], local)

    baked = BakedLevel(level, mesh, facts)
    return baked, surface_of


def lifted(
    field: NumpyField, points: Float[np.ndarray, "n 3"], facing: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n"]]:
    """Points of the mesh moved along its normals onto the zero set, at most 4 mm, and how far."""
    moved, _ = project_to_zero(
        field.distance, field.normal, points, reach=0.004, steps=1, tolerance=1e-4, directions=facing
    )
    return moved, ((moved - points) * facing).sum(1)


def _texel_sizes(
    uv: np.ndarray,
    faces: np.ndarray,
    parts: np.ndarray,
    mesh: Mesh,
    areas: np.ndarray,
    mesh_parts: np.ndarray,
    size: int,
) -> dict[str, float]:
    a, b, c = (uv[faces[:, i]] * size for i in range(3))
    covered = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    result = {}
    for p in np.unique(mesh_parts):
        texels, square = covered[parts == p].sum(), areas[mesh_parts == p].sum()
        result[PARTS[int(p)]] = _rounded(1e3 * float(np.sqrt(square / max(texels, 1e-9))))
    return result


def surface_points(
    field: NumpyField, baked: BakedLevel, origin: Origin, options: BakeOptions
) -> SurfacePoints:
    """Points of the finest level for the network: head and hands count four times their area."""
    rng = np.random.default_rng(options.seed + 1)
    level = baked.level
    mesh = Mesh(level.positions.astype(np.float64), level.faces.astype(np.int64))
    match = match_surface(mesh.vertices, level.normals.astype(np.float64), origin.vertices, origin.faces)
    part = origin.part[origin.faces[match.face, 0]]
    importance = np.where(part[mesh.faces[:, 0]] != BODY, 4.0, 1.0)
    face, weight = measure.spread_over(mesh, options.samples, rng, importance)
    corners = mesh.faces[face]
    normals = (weight[:, :, None] * level.normals[corners]).sum(1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    points = (weight[:, :, None] * mesh.vertices[corners]).sum(1)
    points, _ = project_to_zero(
        field.distance, field.normal, points, reach=0.004, steps=2, directions=normals
    )
    cone = ViewCone(
        level.view_dir.astype(np.float64), level.view_q.astype(np.float64), level.view_seen.astype(np.float64)
    )
    local = interpolated(cone, corners, weight)
    return SurfacePoints(points, normals, field.color(points, local.direction), local)


def with_features(
    baked: BakedLevel, distilled: Distilled, surface_of: Callable[[TexelMap], SurfacePoints], size: int
) -> BakedLevel:
    """The level with its feature texture, half as wide as the base colour's."""
    if distilled.features is None:
        return baked
    level = baked.level
    texels = rasterise_charts(level.uv.astype(np.float64), level.faces.astype(np.int64), size // 2)
    values = np.empty((len(texels.index), 4), np.uint8)
    for start in range(0, len(values), 1 << 18):
        piece = slice(start, start + (1 << 18))
        values[piece] = distilled.features(surface_of(texels.rows(np.arange(len(values))[piece])))
    features = spread(values.astype(np.float64), texels).astype(np.uint8)
    return BakedLevel(replace(level, features=features), baked.mesh, baked.facts)


def _level_line(number: int, facts: dict[str, Any]) -> str:
    return (
        f"level {number}: {facts['faces']} triangles, {facts['charts']} charts in {facts['texture']} px, "
        f"{facts['field_to_mesh_mm']['mean']:.3f} mm from the field, chart edges step {facts['seam_step']['median']:.1f} "
        f"(p99 {facts['seam_step']['p99']:.1f}) of 255"
    )


def _rounded(value: float) -> float | None:
    """Four significant digits; None for what is not finite, which JSON cannot say."""
    return float(f"{value:.4g}") if np.isfinite(value) else None


def _network_arrays(network: ViewNetwork) -> Iterable[np.ndarray]:
    return network.w1, network.b1, network.w2, network.b2


class _Clock:
    """Reports each finished stage with the seconds it took. Never part of the file: same input, same bytes."""

    def __init__(self, report: Callable[[str], None]):
        self.report, self.start, self.last = report, time.perf_counter(), time.perf_counter()

    def __call__(self, line: str) -> None:
        now = time.perf_counter()
        self.report(f"[{now - self.start:5.1f} s, +{now - self.last:4.1f}] {line}")
        self.last = now
