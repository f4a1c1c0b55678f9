"""One level of detail: its mesh, charts, vertex data and base color from the fine surface and the field."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Integer, UInt8
from numpy import ndarray as Array

from avatar.gltf.avatar_file import Level
from avatar.rotation import unit_or_zero
from avatar.skeleton import BIG_POSE, JOINT_NUMBERS, PARTS, joint_transforms
from avatar.texture import bytes_of, mip_levels, mipmaps, sample_texture
from bake import measure
from bake.atlas import Unwrapped, unwrap
from bake.cone import ViewCone, interpolated
from bake.field import NumpyField
from bake.network import Distilled, SurfacePoints
from bake.options import BakeOptions
from bake.promises import Facts
from bake.skin import quantised, transferred_weights
from bake.texture.seams import ChartEdges, chart_edges, seam_steps, seen_steps, solve_seams
from bake.texture.texels import TexelMap, atlas_areas, barycentric, rasterise_charts, sample_texels, spread
from geometry.closest import match_surface
from geometry.decimate import Enlargement, Magnifier, magnified
from geometry.isosurface import Detail, PointFunction, project_to_zero
from geometry.mesh import TriangleMesh, blended, face_areas, face_values
from geometry.repair import find_faults
from geometry.sample import stratified_samples

# texels whose points are in memory at once
PIECE = 1 << 18
# what gets charts of its own: the parts, and what neck and collar bones move of the body
GROUPS = (*PARTS, "collar")
NECK_JOINTS = [JOINT_NUMBERS[name] for name in ("neck", "left_collar", "right_collar")]


class Charted(NamedTuple):
    """What the texels of a level show: its surface by atlas vertex, float64."""

    uv: Float[Array, "corners 2"]
    faces: Integer[Array, "faces 3"]
    points: Float[Array, "corners 3"]  # canonical, metres
    normals: Float[Array, "corners 3"]  # unit, the field's
    cone: ViewCone


class BakedLevel(NamedTuple):
    """A level as it goes into the file, the surface under its texels, and what the file says of it."""

    level: Level
    charted: Charted
    edges: ChartEdges
    facts: Facts


class SourceSurface(NamedTuple):
    """The run's own surface, which carries what training found per vertex."""

    vertices: Float[Array, "vertices 3"]
    faces: Integer[Array, "faces 3"]
    part: Integer[Array, "vertices"]
    cone: ViewCone
    weights: Float[Array, "vertices joints"]
    layer: Integer[Array, "vertices"]  # capture/template/layers.py


class LayeredMesh(NamedTuple):
    """A collapsed mesh of all layers of a person (bake/layers.py)."""

    mesh: TriangleMesh
    normals: Float[Array, "vertices 3"]  # unit, of each vertex's layer
    layer: Integer[Array, "vertices"]
    # metres, canonical points to the nearest layer's surface
    away: PointFunction


class TransferredData(NamedTuple):
    """What the run's surface says of the vertices of another mesh."""

    weights: Float[Array, "n joints"]
    cone: ViewCone
    part: Integer[Array, "n"]
    # rows of weights that found no source nearby facing the same way
    filled: int


def transferred_data(origin: SourceSurface, mesh: TriangleMesh, normals: Float[Array, "n 3"]) -> TransferredData:
    """Skin weights, cone and part of another mesh of the same surface; `normals` are its vertices', unit."""
    match = match_surface(mesh.vertices, normals, origin.vertices, origin.faces)
    corners = origin.faces[match.face]
    weights, filled = transferred_weights(match, mesh.faces, origin.faces, origin.weights)
    nearest = np.take_along_axis(corners, match.barycentric.argmax(1)[:, None], 1)[:, 0]
    return TransferredData(weights, interpolated(origin.cone, corners, match.barycentric), origin.part[nearest], filled)


def magnifiers(details: Sequence[Detail], options: BakeOptions) -> list[Magnifier]:
    """The eyes of the canonical pose, to get more triangles and texels than their size asks for."""
    return [
        Magnifier(0.5 * (one.low + one.high), 0.5 * float((one.high - one.low).max()), options.eye_scale)
        for one in details
    ]


def enlargements(
    joints: Float[Array, "52 3"], options: BakeOptions, details: Sequence[Detail] = ()
) -> list[Enlargement | Magnifier]:
    """Head, hands and eyes of the canonical pose, to keep more triangles than their size asks for."""
    canonical = joint_transforms(np.asarray(BIG_POSE, np.float64), joints, np.zeros(3))[:, :3, 3]
    head = Enlargement(canonical[15], np.array([0.0, 1.0, 0.0]), 0.25, options.head_scale)
    result: list[Enlargement | Magnifier] = [*magnifiers(details, options), head]
    for elbow, wrist in ((18, 20), (19, 21)):
        axis = canonical[wrist] - canonical[elbow]
        length = float(np.linalg.norm(axis))
        if length > 0:
            result.append(Enlargement(canonical[wrist], axis / length, 0.25, options.hand_scale))
    return result


def bake_level(
    surface: LayeredMesh, data: TransferredData, size: int, field: NumpyField, options: BakeOptions
) -> BakedLevel:
    """One level of `size` texels a side of a collapsed mesh, still without colors and features."""
    mesh, normals = surface.mesh, surface.normals

    face_part = face_values(data.part, mesh.faces)
    group = face_part
    if options.collar_density != 1:
        collar = data.weights[:, NECK_JOINTS].sum(1)[mesh.faces].mean(1) > 0.5
        group = np.where(collar & (face_part == PARTS.index("body")), GROUPS.index("collar"), face_part)
    density = np.array([1.0, options.head_density, options.hand_density, options.hand_density, options.collar_density])
    # a gutter of 8 texels at 2048 keeps three mips clean; one of 2 at 512 left none for the charts' skirts
    padding = max(4, size // 256)
    # larger charts for the eyes, without a seam round them
    grown = magnified(mesh.vertices, magnifiers(field.details, options))
    chart = unwrap(grown, mesh.faces, group, density, size=size, padding=padding)
    cone = data.cone.of(chart.source)
    joints, weights = quantised(data.weights[chart.source])
    charted = Charted(chart.uv, chart.faces, mesh.vertices[chart.source], normals[chart.source], cone)

    facing, light = light_at(field, charted)
    single = lambda values: values.astype(np.float32)
    level = Level(
        positions=single(charted.points), normals=single(facing), uv=single(chart.uv),
        faces=chart.faces.astype(np.uint32), joints=joints, weights=weights, view_dir=single(cone.direction),
        view_q=single(cone.metric), view_seen=single(cone.seen), base_color=np.zeros((size, size, 3), np.uint8),
        features=None, light=light,
    )  # fmt: skip
    facts = level_facts(level, surface, group, chart)
    edges = chart_edges(chart.uv, chart.faces, chart.source)
    return BakedLevel(level, charted, edges, {**facts, "weights_filled": data.filled})


class FieldTexels(NamedTuple):
    """Texels of a level's atlas, of any size, on the field's zero set."""

    texels: TexelMap
    lift: Float[Array, "texels"]  # metres along the normal from the triangles to the zero set

    def points(
        self, charted: Charted, rows: Integer[Array, "rows"], jitter: Float[Array, "2"]
    ) -> tuple[Float[Array, "rows 3"], Float[Array, "rows 3"], ViewCone]:
        """Points on the zero set under some texels, moved by `jitter` texels, with unit normals and cones."""
        points, facing, local = surface_at(charted, self.texels.rows(rows), jitter)
        return points + self.lift[rows, None] * facing, facing, local


def field_texels(field: NumpyField, charted: Charted, size: int) -> FieldTexels:
    """The texels of an atlas of `size` texels a side. The lift is asked once for every 2 x 2 texels of a triangle's
    inside, which is many texels wide, and everywhere on the skirts, where the triangle's plane runs off it."""
    texels = rasterise_charts(charted.uv, charted.faces, size)
    row, column = texels.index // texels.size, texels.index % texels.size
    block = np.where(texels.inside, row // 2 * texels.size + column // 2, texels.size**2 + texels.index)
    order = np.argsort(block, kind="stable")
    first = np.r_[True, np.diff(block[order]) > 0]
    asked = order[first]
    found = np.empty(len(asked))
    for start in range(0, len(asked), PIECE):
        points, facing, _ = surface_at(charted, texels.rows(asked[start : start + PIECE]), np.zeros(2))
        found[start : start + PIECE] = lifted(field, points, facing)[1]
    lift = np.empty(len(texels.index))
    lift[order] = found[np.cumsum(first) - 1]
    return FieldTexels(texels, lift)


def field_picture(
    field: NumpyField, charted: Charted, placed: FieldTexels, samples: int
) -> Float[Array, "size size 3"]:
    """The atlas as the field colors it, its chart edges not closed yet: its zero set at the global view direction
    (Eq. 14), [0, 1] sRGB."""

    def color_at(rows: Array, jitter: Array) -> Array:
        result = np.empty((len(rows), 3))
        for start in range(0, len(rows), PIECE):
            points, _, local = placed.points(charted, rows[start : start + PIECE], jitter)
            result[start : start + PIECE] = field.color(points, local.direction)
        return result

    return spread(sample_texels(color_at, placed.texels, samples=samples), placed.texels)


def enlarged(image: Float[Array, "half half 3"], texels: TexelMap) -> Float[Array, "size size 3"]:
    """An atlas made anew for the texels of a larger one."""
    row, column = np.divmod(texels.index, texels.size)
    return spread(sample_texture(image, (np.stack([column, row], 1) + 0.5) / texels.size), texels)


def with_picture(baked: BakedLevel, picture: Float[Array, "size size 3"], texels: TexelMap) -> BakedLevel:
    """The level with a picture as its base color, its chart edges closed in every mip that the player draws."""
    image = solve_seams(picture, texels, baked.charted.uv, baked.edges, mip_levels(picture.shape))
    level = replace(baked.level, base_color=bytes_of(image))
    steps = seam_facts(level, baked.edges, bytes_of(picture))
    return baked._replace(level=level, facts={**baked.facts, "seam_step": steps})


def with_prior(baked: BakedLevel, picture: Float[Array, "size size 3"], texels: TexelMap) -> BakedLevel:
    """The level with a picture as its base color that the videos are going to replace: chart edges stay as they are."""
    return baked._replace(level=replace(baked.level, base_color=bytes_of(picture)))


class PlacesOnFinest(NamedTuple):
    """Where the texels of a coarser level lie in the atlas of the finest."""

    texels: TexelMap
    uv: Float[Array, "texels 2"]

    def read(self, image: Float[Array, "size size channels"]) -> Float[Array, "own own channels"]:
        """An image of the finest level as the coarser one shows it, averaged over what one of its texels covers."""
        while len(image) >= 2 * self.texels.size:
            image = halved(image)
        return spread(sample_texture(image, self.uv), self.texels)


def places_on_finest(baked: BakedLevel, finest: BakedLevel) -> PlacesOnFinest:
    """The texels of a level at the nearest place of the finest that faces the same way."""
    texels = rasterise_charts(baked.charted.uv, baked.charted.faces, len(baked.level.base_color))
    points, facing, _ = surface_at(baked.charted, texels, np.zeros(2))
    match = match_surface(points, facing, finest.charted.points, finest.charted.faces)
    return PlacesOnFinest(texels, blended(finest.charted.uv, finest.charted.faces[match.face], match.barycentric))


def halved(image: Float[Array, "size size channels"]) -> Float[Array, "half half channels"]:
    """Means of two by two texels."""
    return 0.25 * (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2])


def surface_at(
    charted: Charted, texels: TexelMap, jitter: Float[Array, "2"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"], ViewCone]:
    """Point, unit normal and cone under each texel's centre moved by `jitter` texels.

    On a chart's skirt the point is extrapolated in the triangle's plane; normal and cone stay the border's.
    """
    weight = barycentric(charted.uv, charted.faces, texels, jitter)
    corners = charted.faces[texels.face]
    near = np.clip(weight, 0, 1)
    near /= near.sum(1, keepdims=True)
    facing = unit_or_zero(blended(charted.normals, corners, near))
    return blended(charted.points, corners, weight), facing, interpolated(charted.cone, corners, near)


def light_at(
    field: NumpyField, charted: Charted
) -> tuple[Float[Array, "corners 3"], Float32[Array, "corners 2"] | None]:
    """Normals of the vertices that light falls on, and mean S and H that the base color shows there.

    Where light is no factor of its own they are the surface's, and no S and H. They also are where a surface was cut
    (hair): the field goes on behind it.
    """
    if field.seen_light is None or field.light_normal is None:
        return charted.normals, None
    smooth = field.light_normal(charted.points)
    along = (smooth * charted.normals).sum(1, keepdims=True) > 0.5
    normals = np.where(along, smooth, charted.normals)
    return normals, field.seen_light(charted.points, normals).astype(np.float32)


def lifted(
    field: NumpyField, points: Float[Array, "n 3"], facing: Float[Array, "n 3"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n"]]:
    """Points of the mesh moved along its normals onto the zero set, at most 4 mm, and how far."""
    moved, _ = project_to_zero(field.distance, points, facing, reach=0.004, steps=1, tolerance=1e-4)
    return moved, ((moved - points) * facing).sum(1)


def level_facts(level: Level, surface: LayeredMesh, group: Integer[Array, "faces"], chart: Unwrapped) -> Facts:
    """What the file's provenance says of a level; `surface` is its mesh before the atlas split vertices.

    `group` of GROUPS has each triangle. Sides of squares as large as a group's mean triangle and as one of its texels
    are in mm.
    """
    size, mesh = len(level.base_color), surface.mesh
    away = measure.field_to_mesh(surface.away, mesh)
    fault = find_faults(mesh.faces, len(mesh.vertices))
    covered, areas = atlas_areas(chart.uv[chart.faces] * size), face_areas(mesh.vertices, mesh.faces)
    triangle, texel = {}, {}
    for number in np.unique(group):
        own, name = group == number, GROUPS[int(number)]
        # in an order of their own, which chart.face_part follows
        texels = max(covered[chart.face_part == number].sum(), 1e-9)
        triangle[name] = rounded(1e3 * float(np.sqrt(areas[own].mean())))
        texel[name] = rounded(1e3 * float(np.sqrt(areas[own].sum() / texels)))
    return {
        "vertices": len(level.positions),
        "charts": chart.charts,
        "texture": size,
        "utilisation": rounded(chart.utilisation),
        "field_to_mesh_mm": {"mean": rounded(away.mean() * 1e3), "max": rounded(away.max() * 1e3)},
        "open_edges": fault.open_edges,
        "non_manifold_edges": fault.crowded_edges,
        "faces": len(mesh.faces),
        "faces_by_part": {name: int((group == number).sum()) for number, name in enumerate(GROUPS)},
        "texel_mm_by_part": texel,
        "triangle_mm_by_part": triangle,
    }


def seam_facts(level: Level, edges: ChartEdges, picture: UInt8[Array, "size size 3"]) -> Facts:
    """Color steps across chart edges (of 255) in every mip that the player draws, and what is seen of them beyond what
    the `picture` that the edges were closed in steps at the same places; the worst mip's first."""
    uv, faces = level.uv.astype(np.float64), level.faces.astype(np.int64)
    mips, count = [], mip_levels(level.base_color.shape)
    for image in mipmaps(level.base_color, count):
        steps = seam_steps(uv, edges, image)
        at = np.quantile(steps, [0.5, 0.99]) if len(steps) else np.zeros(2)
        seen = float(np.quantile(seen_steps(uv, faces, edges, image, picture), 0.99)) if len(steps) else 0.0
        mips.append({"median": rounded(float(at[0])), "p99": rounded(float(at[1])), "seen_p99": rounded(seen)})
    return {key: max(mip[key] for mip in mips) for key in ("median", "p99", "seen_p99")} | {"mips": mips}


def surface_points(
    field: NumpyField, surface: LayeredMesh, data: TransferredData, options: BakeOptions
) -> SurfacePoints:
    """Points of the finest level for the network: head and hands count four times their area."""
    mesh = surface.mesh
    importance = np.where(data.part[mesh.faces[:, 0]] != PARTS.index("body"), 4.0, 1.0)
    face, weight = stratified_samples(*mesh, options.samples, seed=options.seed + 1, weight=importance)
    corners = mesh.faces[face]
    normals = unit_or_zero(blended(surface.normals, corners, weight))
    points = blended(mesh.vertices, corners, weight)
    points, _ = project_to_zero(field.distance, points, normals, reach=0.004, steps=2)
    local = interpolated(data.cone, corners, weight)
    return SurfacePoints(points, normals, field.color(points, local.direction), local)


def with_features(
    baked: BakedLevel, picture: Float[Array, "size size 3"], half: FieldTexels, distilled: Distilled
) -> BakedLevel:
    """The finest level, which the field colors as in `picture`, with its feature texture, `half` as wide."""
    if distilled.features is None:
        return baked
    base, values = halved(picture).reshape(-1, 3)[half.texels.index], []
    for rows in np.split(np.arange(len(base)), range(PIECE, len(base), PIECE)):
        points, facing, local = half.points(baked.charted, rows, np.zeros(2))
        values.append(distilled.features(SurfacePoints(points, facing, base[rows], local)))
    return with_feature_image(baked, spread(np.concatenate(values) / 255.0, half.texels), half.texels)


def with_features_of(
    baked: BakedLevel, features: UInt8[Array, "size size features"] | None, place: PlacesOnFinest
) -> BakedLevel:
    """A coarser level with the `features` of the finest, where that has any."""
    if features is None:
        return baked
    texels = rasterise_charts(baked.charted.uv, baked.charted.faces, place.texels.size // 2)
    return with_feature_image(baked, halved(place.read(features / np.float64(255))), texels)


def with_feature_image(baked: BakedLevel, image: Float[Array, "half half features"], texels: TexelMap) -> BakedLevel:
    """The level with an image of features as its feature texture, its chart edges closed."""
    image = solve_seams(image, texels, baked.charted.uv, baked.edges, mip_levels(image.shape))
    return baked._replace(level=replace(baked.level, features=bytes_of(image)))


def rounded(value: float) -> float | None:
    """Four significant digits; None for what is not finite, which JSON cannot say."""
    return float(f"{value:.4g}") if np.isfinite(value) else None
