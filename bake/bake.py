"""Run folder -> avatar file, in order: surface, decimation, atlas, skin, cone, color, network, measurement."""

import time
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer
from scipy.spatial import KDTree

from avatar.gltf.avatar_file import Avatar, write_avatar
from avatar.light import CaptureLight
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import BIG_POSE, PARTS
from avatar.skinning import dense_weights, strongest_four
from bake import measure
from bake.cone import view_cone
from bake.face.face import with_face
from bake.face.template import FaceRefused, person_face
from bake.field import NumpyField, numpy_field, one_thread
from bake.layers import SurfaceLayer, collapsed, extract_layers, layer_hints, layered_data, layers_of
from bake.level import (
    NECK_JOINTS,
    BakedLevel,
    Charted,
    FieldTexels,
    LayeredMesh,
    PlacesOnFinest,
    SourceSurface,
    TransferredData,
    bake_level,
    enlarged,
    enlargements,
    field_picture,
    field_texels,
    places_on_finest,
    rounded,
    surface_points,
    with_features,
    with_features_of,
    with_picture,
    with_prior,
)
from bake.loose import looseness
from bake.network import AMPLITUDE, Distilled, distil, write_onnx
from bake.options import BakeOptions
from bake.outlines import worse_parts
from bake.promises import Facts, missed_promises
from bake.run_capture import RunVideos, run_videos
from bake.texture.pixel_reads import view_change
from bake.texture.texels import TexelMap, rasterise_charts
from bake.texture.video_texture import with_video_textures
from bake.twist import with_twist
from capture.check.unseen import unseen_places
from capture.folder import CaptureSubject
from capture.own_face import OwnFace
from command.errors import AssetError
from command.workers import on_all_cores
from geometry.closest import closest_points, triangle_index
from geometry.isosurface import Extraction, GridSteps
from geometry.mesh import TriangleMesh, enclosed_volume, vertex_normals
from train.part_job import BROKEN_OFF, BROKEN_SHARE
from train.run import BakeSource, read_run
from train.surface import Surface

# triangles of the levels beside the finest, and by what the side of its atlas is divided
COARSER = ((10_000, 2), (3_000, 4), (1_000, 8))


def bake(
    run_path: Path | str,
    out: Path | str,
    options: BakeOptions = BakeOptions(),  # noqa: B008  frozen
    *,
    capture: Path | str | None = None,
) -> Avatar:
    """Bake a run folder into NAME.glb (and NAME.onnx where a network is shipped).

    `capture` is where the videos lie, else run.json says where.

    Raises:
        AssetError: the videos are asked for and nowhere, or the run or the capture is unusable.
    """
    run = read_run(Path(run_path))
    given = None if capture is None else Path(capture)
    videos = None if options.texture_from == "field" else run_videos(run.path, run.provenance, given)
    return bake_run(run.bake_source, Path(out), options, print, videos)


@one_thread()
def bake_run(
    run: BakeSource, out: Path, options: BakeOptions, report: Callable[[str], None] = print,
    videos: RunVideos | None = None,
) -> Avatar:  # fmt: skip
    """As `bake`, for a run already read; without `videos` the textures are the field's."""
    if videos is None:
        options = replace(options, texture_from="field")
    elif videos.trunk:
        options = replace(options, collar_density=options.head_density)
    clock = _Clock(report)
    joints = run.subject.joints
    origin = run_surface(run.surface)
    # a template that was given is the person; of one that was fitted outlines say how good it is
    worse, outlines = worse_parts(run, videos) if videos is not None and videos.estimated else ({}, {})
    for part, why in worse.items():
        clock.report(f"{part}: {why}: the template stays")
    field, layers, extraction, given_up = extracted(run, origin, options, clock, worse)
    baked = bake_levels(extraction, layers, origin, field, joints, options, clock)
    levels, distilled = [loosened(level, run.subject) for level in baked.levels], baked.distilled
    facts: Facts = {
        "faces": options.faces,
        "texture": options.texture,
        "seed": options.seed,
        "surface": {
            "triangles": len(extraction.mesh.faces),
            "residual_mm": rounded(extraction.residual * 1e3),
            "islands_dropped": extraction.islands,
            "island_area_share": rounded(extraction.island_area),
        },
        "template_kept": given_up,
        "outlines_off": outlines,
        "seen_share": rounded(float((origin.cone.seen > 0.5).mean())),
        "texture_from": options.texture_from,
        "distilled_db": {k: rounded(v) for k, v in distilled.decibels.items()},
        "missed": [],
    }
    avatar = Avatar(
        name=str(run.provenance.get("subject", out.stem)), joint_positions=joints,
        canonical_pose=np.asarray(BIG_POSE, np.float64), levels=tuple(level.level for level in levels),
        network=distilled.network, linear=distilled.linear, amplitude=AMPLITUDE, default_view=distilled.default_view,
        provenance={**run.provenance, "baked": facts}, light=avatar_light(run.world_light, run.provenance),
    )  # fmt: skip
    with ThreadPoolExecutor(1) as beside:
        # with the field's own textures, whatever the file will hold
        views = measure.test_views(joints, options.image)
        whole, normals = shown_surface(origin, run.surface.normals, extraction.mesh, given_up)
        surface = measure.FieldSurface(whole, normals, strongest_four(origin.weights), origin.cone, joints, field)
        comparing = beside.submit(measure.compare, avatar, surface, views)
        if videos is not None:
            change = view_change(field, levels[0].charted, distilled)
            levels, facts["videos"] = with_video_textures(levels, baked.places, joints, videos, clock.report, change)
            avatar = replace(avatar, levels=tuple(level.level for level in levels))
            facts["unseen"] = unseen_lines(run, origin, collar=videos.trunk)
            for line in facts["unseen"]:
                clock.report(f"  {line}")
        facts["against_field"] = field_facts(comparing.result(), options, clock)
    facts["levels"] = [level.facts for level in levels]
    steps = " / ".join(f"{level.facts['seam_step']['seen_p99']:.1f}" for level in levels)
    clock(f"textures from the {facts['texture_from']}: chart edges step p99 {steps} of 255 beyond the picture's own")
    facts["default_view"] = {"mode": distilled.default_view, "reason": distilled.reason}
    clock(f"default view: {distilled.default_view} ({distilled.reason})")
    if "face" not in options.without:
        avatar = faced(avatar, run.subject, videos.own_face if videos else None, clock)
    return written(avatar, out, facts, options, clock)


class Extracted(NamedTuple):
    field: NumpyField  # whose surface it is
    layers: list[SurfaceLayer]
    extraction: Extraction
    # parts whose template stands in for what they learned, and why
    given_up: dict[str, str]


def extracted(
    run: BakeSource, origin: SourceSurface, options: BakeOptions, clock: "_Clock",
    worse: Mapping[str, str] | None = None,
) -> Extracted:  # fmt: skip
    """The layers of a run and their zero sets as one mesh. Parts that are worse than their template, or break off, go
    back to it.

    Raises:
        AssetError: there is no surface, or a part of it breaks off that learned nothing.
    """
    steps = GridSteps(options.body_step, options.fine_step)
    field, given_up = run.field, dict(worse or {})
    if worse and run.with_templates is not None:
        field = run.with_templates(given_up)
    while True:
        asked = numpy_field(field)
        layers = layers_of(asked, run.subject, origin)
        try:
            hints = layer_hints(origin, run.subject, given_up, len(layers))
            extraction = extract_layers(layers, hints, steps, asked.details)
            broken = broken_parts(extraction.mesh, origin.vertices, origin.part)
        except AssetError as fault:
            if run.with_templates is None or len(given_up) == len(PARTS):
                raise
            extraction, broken = None, dict.fromkeys(PARTS, str(fault))
        broken = {part: why for part, why in broken.items() if part not in given_up}
        if extraction is not None and not broken:
            break
        why = "; ".join(dict.fromkeys(broken.values()))
        if run.with_templates is None:
            raise AssetError(f"surface: {why}")
        clock.report(f"surface: {why}: the template stays for {', '.join(broken)}")
        given_up |= broken
        field = run.with_templates(given_up)
    clock(
        f"surface: {len(extraction.mesh.faces)} triangles on the zero set (1 in 1000 farther than "
        f"{extraction.residual * 1e3:.3f} mm, {extraction.queries / 1e6:.1f} M distances, "
        f"{extraction.islands} islands dropped)"
    )
    return Extracted(asked, layers, extraction, given_up)


def shown_surface(
    origin: SourceSurface, normals: Float[np.ndarray, "vertices 3"], extracted: TriangleMesh, given_up: Collection[str]
) -> tuple[TriangleMesh, Float[np.ndarray, "vertices 3"]]:
    """The run's surface and its normals, with parts that were given up where the extracted surface has them."""
    vertices, normals = origin.vertices.copy(), normals.copy()
    moved = np.isin(origin.part, [PARTS.index(part) for part in given_up])
    if moved.any():
        index = triangle_index(extracted.vertices, extracted.faces)
        vertices[moved] = closest_points(vertices[moved], index).point
        normals[moved] = vertex_normals(vertices, origin.faces)[moved]
    return TriangleMesh(vertices, origin.faces), normals


def unseen_lines(run: BakeSource, surface: SourceSurface, *, collar: bool) -> list[str]:
    """What hardly any frame shows of the surface, but what loose clothes hide, and neck and `collar` where the head's
    video shows them too."""
    in_sight, behind = np.ones(len(surface.faces), bool), run.subject.behind_cloth
    if behind is not None:
        nearest = KDTree(run.subject.vertices).query(surface.vertices, workers=-1)[1]
        in_sight = ~behind[nearest][surface.faces].all(1)
    if collar:
        in_sight &= surface.weights[:, NECK_JOINTS].sum(1)[surface.faces].mean(1) < 0.5
    found = unseen_places(surface.vertices, surface.faces, run.surface.skin, run.surface.view_count, in_sight)
    return [place.line() for place in found]


def written(avatar: Avatar, out: Path, facts: Facts, options: BakeOptions, clock: "_Clock") -> Avatar:
    """Write the avatar with its facts and the network beside it, where it has one; say which promises it missed."""
    if options.twist:
        facts["twist"] = True
        avatar = with_twist(avatar)
    avatar = replace(avatar, provenance={**avatar.provenance, "baked": facts})
    write_avatar(out, avatar)
    facts["missed"] = missed_promises(facts, options, out.stat().st_size)
    if facts["missed"]:
        write_avatar(out, avatar)
    network = out.with_suffix(".onnx")
    if avatar.network is not None:
        write_onnx(network, avatar.network)
    else:
        # that of an earlier bake would be taken for this avatar's
        network.unlink(missing_ok=True)
    clock(f"{out}: {out.stat().st_size / 1e6:.1f} MB")
    for line in facts["missed"]:
        clock.report(f"missed: {line}")
    return avatar


def faced(avatar: Avatar, subject: CaptureSubject, own: OwnFace | None, clock: "_Clock") -> Avatar:
    """The avatar with a face that moves, where its template and its surface have what that takes; its own as far as a
    film of it said."""
    try:
        found = with_face(avatar.levels, person_face(subject), own)
    except FaceRefused as why:
        clock.report(f"face: stays still, {why}")
        return avatar
    moving = [len(level.face.vertices) for level in found.levels if level.face is not None]
    clock(f"face: moves {' / '.join(map(str, moving))} vertices{', as its film says' if own else ''}")
    return replace(avatar, levels=tuple(found.levels), eyes=found.eyes)


def loosened(baked: BakedLevel, subject: CaptureSubject) -> BakedLevel:
    level = baked.level
    found = looseness(level.positions.astype(np.float64), level.faces.astype(np.int64), level.skin, subject)
    return baked._replace(level=replace(level, loose=found))


def avatar_light(light: CaptureLight | None, provenance: Facts) -> CaptureLight | None:
    """The capture's light in the avatar's world: the camera's heading is taken off, it stands before the T-pose."""
    if light is None:
        return None
    backwards = np.array(provenance.get("light_camera", [0.0, 0.0, 1.0]), np.float64)
    heading = float(np.arctan2(backwards[0], backwards[2]))
    return light.turned(matrix_from_axis_angle(np.array([0.0, -heading, 0.0])), "world")


def run_surface(surface: Surface) -> SourceSurface:
    """The run's surface, its triangles facing outwards, and its view statistics as cones."""
    vertices, faces = surface.vertices, surface.faces
    if enclosed_volume(TriangleMesh(vertices, faces)) < 0:
        # only the normals of a run's surface are promised to face outwards
        faces = faces[:, ::-1]
    count, mean, covariance = (
        values.astype(np.float64) for values in (surface.view_count, surface.view_mean, surface.view_covariance)
    )
    cone = view_cone(count, mean, covariance, surface.normals, faces)
    return SourceSurface(vertices, faces, surface.part, cone, dense_weights(surface.skin), surface.layer)


def broken_parts(
    mesh: TriangleMesh, vertices: Float[np.ndarray, "vertices 3"], part: Integer[np.ndarray, "vertices"]
) -> dict[str, str]:
    """The parts of a run's surface that lie off the mesh, with why they count as broken off (train/part_job.py)."""
    away, _ = KDTree(mesh.vertices).query(vertices, workers=-1)
    missing = {PARTS[int(label)]: float((away[part == label] > BROKEN_OFF).mean()) for label in np.unique(part)}
    return {
        name: f"{share * 100:.0f} % of {name} is more than {BROKEN_OFF * 100:.0f} cm from the largest piece"
        for name, share in missing.items()
        if share > BROKEN_SHARE
    }


def level_plan(options: BakeOptions) -> list[tuple[int, int]]:
    """Triangles and texels a side of each level, finest first."""
    coarser = [(count, max(64, options.texture // share)) for count, share in COARSER if count < options.faces]
    return [(options.faces, options.texture), *coarser]


class BakedLevels(NamedTuple):
    """All levels, finest first, with the field's colors, and what was distilled on the finest."""

    levels: list[BakedLevel]
    places: list[PlacesOnFinest]  # one for each coarser level
    distilled: Distilled


def bake_levels(
    extraction: Extraction, layers: list[SurfaceLayer], origin: SourceSurface, field: NumpyField,
    joints: Float[np.ndarray, "52 3"], options: BakeOptions, clock: "_Clock",
) -> BakedLevels:  # fmt: skip
    """All levels: the field colors the finest, whose picture and features the others show as well.

    The edges of charts are closed where the textures stay the field's; else they are in the videos' equations.
    """
    parts = enlargements(joints, options, field.details)
    surfaces: list[tuple[LayeredMesh, TransferredData, int]] = []
    mesh, layer = extraction.mesh, extraction.layer
    for count, size in level_plan(options):
        # each out of the one before
        surface = collapsed(mesh, layer, layers, count, parts, clock.report)
        mesh, layer = surface.mesh, surface.layer
        surfaces.append((surface, layered_data(origin, mesh, surface.normals, layer), size))

    def distilled_finest() -> Distilled:
        surface, data, _ = surfaces[0]
        points = surface_points(field, surface, data, options)
        return distil(field.color, points, seed=options.seed, steps=options.steps, report=clock.report)

    levels: list[BakedLevel] = []
    with ThreadPoolExecutor(1) as beside:
        distilling = beside.submit(distilled_finest)
        for level in on_all_cores(lambda one: bake_level(*one, field, options), surfaces):
            facts = level.facts
            clock(
                f"level {len(levels)}: {facts['faces']} triangles, {facts['charts']} charts in {facts['texture']} px, "
                f"{facts['field_to_mesh_mm']['mean']:.3f} mm from the field"
            )
            levels.append(level)
        half, texels, picture = field_atlas(field, levels[0].charted, options)
        clock(f"colors of the field for {len(texels.index) / 1e6:.1f} M texels")
        places = [places_on_finest(level, levels[0]) for level in levels[1:]]
        distilled = distilling.result()
    clock(f"view dependence: the richest mode worth its place is {distilled.default_view}")
    # the field's picture is where the videos' solution begins: its chart edges are in their equations
    colored = with_picture if options.texture_from == "field" else with_prior
    levels[0] = colored(with_features(levels[0], picture, half, distilled), picture, texels)

    def coarser(placed: tuple[BakedLevel, PlacesOnFinest]) -> BakedLevel:
        level, place = placed
        level = colored(level, place.read(picture), place.texels)
        return with_features_of(level, levels[0].level.features, place)

    levels[1:] = on_all_cores(coarser, zip(levels[1:], places, strict=True))
    clock("colors and features of all levels")
    return BakedLevels(levels, places, distilled)


def field_atlas(
    field: NumpyField, finest: Charted, options: BakeOptions
) -> tuple[FieldTexels, TexelMap, Float[np.ndarray, "size size 3"]]:
    """The texels of the finest level with half as many a side, and with all of them, and its picture by the field."""
    half = field_texels(field, finest, options.texture // 2)
    if options.texture_from == "field":
        whole = field_texels(field, finest, options.texture)
        return half, whole.texels, field_picture(field, finest, whole, options.texel_samples)
    # the videos' solution begins there, with finer texels than the field's grids are
    texels = rasterise_charts(finest.uv, finest.faces, options.texture)
    return half, texels, enlarged(field_picture(field, finest, half, 1), texels)


def field_facts(score: measure.BakeScore, options: BakeOptions, clock: "_Clock") -> Facts:
    """What baking lost, in decibels, as the file's provenance says it."""
    worst = min(score.per_view, key=lambda name: score.per_view[name])
    clock(
        f"baked paper mode against the field: {score.paper_db:.1f} dB over {len(score.per_view)} pictures of "
        f"{options.image} px (worst {score.per_view[worst]:.1f}: {worst})"
    )
    for mode, db in score.view_db.items():
        apart = ", ".join(f"{group.replace('_', ' ')}s {one[mode]:.1f}" for group, one in score.group_db.items())
        clock.report(f"  cone field against {mode}: {db:.1f} dB ({apart})")
    # paper mode against the paper field, each mode against the cone field
    decibels = lambda paper, db: {
        "paper_db": rounded(paper), "cone_db": {mode: rounded(db[mode]) for mode in db if mode != "paper"},
    }  # fmt: skip
    return {
        "pixels": score.pixels,
        "image": options.image,
        "per_view_db": {k: rounded(v) for k, v in score.per_view.items()},
        **decibels(score.paper_db, score.view_db),
        **{group: decibels(one["paper"], one) for group, one in score.group_db.items()},
    }


class _Clock:
    """Reports each finished stage with the seconds it took. Never part of the file: same input, same bytes."""

    def __init__(self, report: Callable[[str], None]):
        self.report, self.start, self.last = report, time.perf_counter(), time.perf_counter()

    def __call__(self, line: str) -> None:
        now = time.perf_counter()
        self.report(f"[{now - self.start:5.1f} s, +{now - self.last:4.1f}] {line}")
        self.last = now
