"""Textures from the videos: the atlas solved against the frames at their own resolution, after fusion.

The field's colors come from grids of 3.5 to 8 mm; a frame shows 1 to 8 mm, and forty of them together less. The atlas
that the field gave is the prior; its change is solved for (texture_solve.py) with chart edges as equations of the same
problem, what no video saw is filled by material (fill.py), and coarser levels get the change of the finest.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Integer
from scipy.sparse import csr_matrix

from avatar.camera import Camera
from avatar.gltf.avatar_file import Level
from avatar.skeleton import PARTS
from avatar.texture import mip_levels, sample_texture
from bake.fill import Surface, filled_colors
from bake.frame_alignment import ShownVideo, align_frames
from bake.level import BakedLevel, rounded, seam_facts, surface_at
from bake.pixel_reads import AtlasMesh, atlas_mesh, part_of_corners, pixel_size, samples_for, video_reads
from bake.run_capture import RunVideos
from bake.seams import edge_reads, solve_seams
from bake.shown_range import ShownRange, shown_range, within_shown
from bake.texels import barycentric, bytes_from_unit, spread
from bake.texture_solve import Equations, Prior, neighbour_pairs, solve_change
from bake.view_change import ViewChange
from capture.folder import PartVideo
from geometry.closest import match_surface
from geometry.mesh import TriangleMesh, face_areas
from player.context import open_context
from player.raster import Rasteriser

Array = np.ndarray

# frames are averaged over k x k pixels before they are read, while a pixel stays within so many texels
FINEST_PIXEL = 1.3
# lambda of a texel as wide as a pixel and its growth with the texel's share of a pixel: many small texels under one
# pixel divide what it tells. mu over lambda.
STAY, STAY_POWER, SMOOTH = 0.06, 1.5, 4.0
# mu over lambda where color follows the eye: frames then disagree, and the grids of their pixels would show as ribs
SMOOTH_SHINY = 16.0
# weight of a point on a chart edge looking the same from both sides
AGREE = 1.0
# frames that show a texel, away from outlines, up to which it counts as unseen, and from which as seen
UNSEEN, SEEN = 0.3, 1.0


class VideoTexture(NamedTuple):
    """The finest level's atlas from the videos."""

    image: Float[Array, "size size 3"]  # [0, 1] sRGB
    change: Float[Array, "size size 3"]  # against the field's, spread beyond the charts
    facts: dict[str, Any]


def with_video_textures(
    levels: list[BakedLevel],
    joints: Float[Array, "52 3"],
    videos: RunVideos,
    report: Callable[[str], None] = lambda line: None,
    change: ViewChange | None = None,
) -> tuple[list[BakedLevel], dict[str, Any]]:
    """The levels with their base color solved against the videos, and what the file says of it.

    `change` is what the finest level shows beyond its base color, where a view network is to show it.
    """
    finest = levels[0]
    solved = solve_texture(finest, joints, videos, report, change)
    images = [solved.image, *(carried_to(level, finest.level, solved.change) for level in levels[1:])]
    result = []
    for baked, image in zip(levels, images, strict=True):
        mesh = atlas_mesh(baked.level, joints)
        # coarse mips read beyond the finest's edges; no goal: closing them as far as the field's would blur print
        image = solve_seams(image, mesh.texels, mesh.uv, baked.edges, mip_levels(image.shape))
        level = replace(baked.level, base_color=bytes_from_unit(image))
        facts = {**baked.facts, "seam_step": seam_facts(level, baked.edges)}
        result.append(baked._replace(level=level, facts=facts))
    return result, solved.facts


def solve_texture(
    baked: BakedLevel,
    joints: Float[Array, "52 3"],
    videos: RunVideos,
    report: Callable[[str], None],
    change: ViewChange | None = None,
) -> VideoTexture:
    """The atlas of a level solved against the videos; see the module."""
    level = baked.level
    mesh = atlas_mesh(level, joints)
    given = (level.base_color.reshape(-1, 3)[mesh.texels.index] / np.float32(255)).astype(np.float32)
    texel = texel_sizes(mesh)
    part = part_of_corners(mesh)[mesh.faces[mesh.texels.face]].max(1)
    frames = np.zeros(len(given))
    pixel = np.full(len(PARTS), np.inf)
    equations: list[Equations] = []
    shown: list[ShownVideo] = []
    ranges: list[ShownRange] = []
    facts: dict[str, Any] = {}
    context = open_context()
    try:
        rasteriser = Rasteriser(context)
        for name in PARTS:
            video = videos.video(name)
            index = PARTS.index(name)
            own = float(np.median(texel[part == index])) if (part == index).any() else float(np.median(texel))
            seen_size = pixel_size(video, mesh, videos.head_from_canonical)
            video = averaged(video, averaging(seen_size, own))
            pixel[index] = pixel_size(video, mesh, videos.head_from_canonical)
            samples, light = samples_for(pixel[index], own), videos.lights.get(name)
            reads = video_reads(mesh, video, videos.head_from_canonical, rasteriser, samples, light, change)
            found = equations_of(reads, given, mesh.positions)
            ranges.append(shown_range(found.places, found.colors, max(pixel[index], own)))
            equations.append(found.equations)
            shown.append(ShownVideo(found.frames, video.cameras[0].size[0], pixel[index]))
            frames += np.square(pixel[index] / texel) * found.told
            facts[name] = {
                "pixel_mm": rounded(seen_size * 1e3),
                "pixels": len(found.equations.wanted),
                "rms_before": rounded(found.rms * 255),
            }
            report(
                f"{name}: {len(video.images)} frames, {seen_size * 1e3:.2f} mm a pixel, texels of {own * 1e3:.2f} mm, "
                f"{len(found.equations.wanted) / 1e6:.1f} M pixels, {found.rms * 255:.1f} of 255 beside the field's"
            )
        rasteriser.release()
    finally:
        context.release()
    seams = seam_equations(mesh, baked, given)
    share = texel / pixel[part]
    stay = STAY * share**STAY_POWER
    smooth = SMOOTH if change is None else SMOOTH_SHINY
    prior, pairs = Prior(stay, smooth * stay), neighbour_pairs(mesh.texels)
    solution = solve_change(equations, prior, pairs, stiff=seams)
    if videos.estimated:
        for name, own, video in zip(PARTS, equations, shown, strict=True):
            facts[name]["moved_mm"] = rounded(align_frames(own, video, given, solution) * 1e3)
        moved = ", ".join(f"{name} {facts[name]['moved_mm']:.1f}" for name in PARTS)
        report(f"frames moved onto the texture they agree on, mm: {moved}")
        solution = solve_change(equations, prior, pairs, stiff=seams)
    surface = texel_surface(baked, mesh, texel)
    solved = np.clip(within_shown(given + solution, given, surface.points, ranges), 0, 1)
    for name, own in zip(PARTS, equations, strict=True):
        left = own.wanted - own.matrix @ (solved - given)
        facts[name]["rms_after"] = rounded(255 * _rms(left, own.matrix))
    seen = np.clip((frames - UNSEEN) / (SEEN - UNSEEN), 0, 1)[:, None]
    rest = np.flatnonzero(seen < 1)
    fill = filled_colors(surface, solved, seen[:, 0] == 1)
    solved[rest] = seen[rest] * solved[rest] + (1 - seen[rest]) * fill
    image = spread(solved.astype(np.float64), mesh.texels)
    unseen = float(np.average(seen[:, 0] < 0.5, weights=texel**2))
    facts["unseen_share"] = rounded(unseen)
    report(f"textures: {unseen * 100:.0f} % of the surface was in no video, filled by material")
    return VideoTexture(image, image - level.base_color / 255.0, facts)


class VideoEquations(NamedTuple):
    """What one video says of the atlas."""

    equations: Equations
    frames: list[Integer[Array, "pixels"]]  # each frame's pixels, in the order of the rows
    # sum over visible pixels of the share of the texel in the pixel
    told: Float[Array, "texels"]
    rms: float  # of what pixels show beside the given atlas, weighted
    places: Float[Array, "rows 3"]  # canonical, metres
    colors: Float[Array, "rows 3"]


def equations_of(reads: Any, given: Float[Array, "texels 3"], positions: Float[Array, "corners 3"]) -> VideoEquations:
    """The equations of a video's frames, one matrix, weights multiplied in."""
    data, indices, lengths, wanted, frames, places, colors = [], [], [], [], [], [], []
    told = np.zeros(len(given))
    for own in reads:
        matrix, root = own.reads, np.sqrt(own.weight)
        each = np.diff(matrix.indptr)
        told += np.bincount(matrix.indices, matrix.data * np.repeat(own.visible, each), len(given))
        wanted.append(((own.color - matrix @ given) * root[:, None]).astype(np.float32))
        data.append(matrix.data * np.repeat(root, each))
        indices.append(matrix.indices)
        lengths.append(each)
        frames.append(own.index.astype(np.int32))
        places.append(own.place.of(positions).astype(np.float32))
        colors.append(own.color)
    pointers = np.r_[0, np.cumsum(_joined(lengths), dtype=np.int64)]
    if pointers[-1] < 2**31:
        pointers = pointers.astype(np.int32)
    shape = (len(pointers) - 1, len(given))
    matrix = csr_matrix((_joined(data), _joined(indices), pointers), shape)
    equations = Equations(matrix, _joined(wanted))
    rms = _rms(equations.wanted, matrix)
    return VideoEquations(equations, frames, told, rms, _joined(places), _joined(colors))


def _joined(pieces: list[Array]) -> Array:
    """The pieces as one array; the list is emptied, or large videos would be in memory twice."""
    result = np.concatenate(pieces)
    pieces.clear()
    return result


def _rms(left: Float[Array, "rows 3"], matrix: csr_matrix) -> float:
    """Root mean square of weighted residuals, over the weights: the rows of `matrix` sum to their square roots."""
    weight = np.square(np.asarray(matrix.sum(1))).sum()
    return float(np.sqrt(np.square(left).sum() / max(3 * float(weight), 1e-12)))


def seam_equations(mesh: AtlasMesh, baked: BakedLevel, given: Float[Array, "texels 3"]) -> Equations:
    """Points on chart edges look the same from both sides in the finest mip."""
    rows, columns, values, count = edge_reads(mesh.uv, baked.edges, mesh.size)
    matrix = csr_matrix((values.astype(np.float32), (rows, mesh.row_of[columns])), (count, len(given)))
    matrix = (matrix * np.float32(np.sqrt(AGREE))).tocsr()
    return Equations(matrix, -(matrix @ given))


def texel_sizes(mesh: AtlasMesh) -> Float[Array, "texels"]:
    """Metres of each texel's side on the surface."""
    corners = mesh.uv[mesh.faces] * mesh.size
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    covered = 0.5 * np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    side = np.sqrt(face_areas(mesh.positions, mesh.faces) / np.maximum(covered, 1e-6))
    middle = np.median(side[mesh.texels.face])
    return np.clip(side, 0.1 * middle, 10 * middle)[mesh.texels.face]


def averaging(pixel: float, texel: float) -> int:
    """Over how many pixels a side frames may be averaged, as a texel is no finer."""
    return int(np.clip(np.floor(FINEST_PIXEL * texel / pixel), 1, 8))


def averaged(video: PartVideo, k: int) -> PartVideo:
    """The video with k x k pixels as one; masks where all of them are on the person."""
    if k == 1:
        return video
    frames, height, width = video.masks.shape
    rows, columns = height // k, width // k

    def blocks(images: Array) -> Array:
        return images[:, : rows * k, : columns * k].reshape(frames, rows, k, columns, k, *images.shape[3:])

    images = np.stack([np.round(one.mean((1, 3))).astype(np.uint8) for one in blocks(video.images)])
    cameras = []
    for camera in video.cameras:
        scale = np.diag([1 / k, 1 / k, 1.0])
        cameras.append(Camera(scale @ camera.K, camera.camera_from_world, (columns, rows), camera.distortion))
    unsure = None if video.unsure is None else blocks(video.unsure).any((2, 4))
    return replace(video, images=images, masks=blocks(video.masks).all((2, 4)), cameras=tuple(cameras), unsure=unsure)


def texel_surface(baked: BakedLevel, mesh: AtlasMesh, texel: Float[Array, "texels"]) -> Surface:
    """The texels as places of the welded mesh."""
    welded, index = np.unique(mesh.positions, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    weight = np.clip(barycentric(mesh.uv, mesh.faces, mesh.texels, np.zeros(2)), 0, 1)
    weight /= weight.sum(1, keepdims=True)
    points, facing, _ = surface_at(baked.charted, mesh.texels, np.zeros(2))
    return Surface(
        TriangleMesh(welded, faces), faces[mesh.texels.face], weight, points, facing, np.square(texel),
        mesh.piece[mesh.texels.face],
    )  # fmt: skip


def carried_to(baked: BakedLevel, finest: Level, change: Float[Array, "size size 3"]) -> Float[Array, "own own 3"]:
    """The atlas of a coarser level with the change that the finest one had at the nearest place that faces the same
    way, averaged over as many texels as one of its own covers."""
    level = baked.level
    size = len(level.base_color)
    for _ in range(int(np.log2(max(len(change) // size, 1)))):
        change = 0.25 * (change[::2, ::2] + change[1::2, ::2] + change[::2, 1::2] + change[1::2, 1::2])
    mesh = atlas_mesh(level, np.zeros((52, 3)))
    points, facing, _ = surface_at(baked.charted, mesh.texels, np.zeros(2))
    faces = finest.faces.astype(np.int64)
    match = match_surface(points, facing, finest.positions.astype(np.float64), faces)
    uv = (match.barycentric[:, :, None] * finest.uv.astype(np.float64)[faces[match.face]]).sum(1)
    own = level.base_color.reshape(-1, 3)[mesh.texels.index] / 255.0
    return spread(np.clip(own + sample_texture(change, uv), 0, 1), mesh.texels)
