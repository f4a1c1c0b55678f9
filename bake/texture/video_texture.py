"""Textures from the videos: the atlas solved against the frames at their own resolution, after fusion.

The field's colors come from grids of 3.5 to 8 mm; a frame shows 1 to 8 mm, and forty of them together less. The atlas
that the field gave is the prior; its change is solved for (texture_solve.py) with chart edges as equations of the same
problem, what no video saw is filled by material (fill.py), and coarser levels show what the finest does.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer
from numpy import ndarray as Array
from scipy.sparse import csr_matrix

from avatar.camera import Camera
from avatar.rotation import unit_or_zero
from avatar.skeleton import BIG_POSE, JOINTS, PARTS, joint_transforms
from bake.level import BakedLevel, PlacesOnFinest, rounded, with_picture
from bake.promises import Facts
from bake.run_capture import RunVideos
from bake.texture.fill import TexelSurface, filled_colors
from bake.texture.frame_alignment import WINDOWS, ShownVideo, aligned_frames
from bake.texture.hair_colors import strange_beside_hair
from bake.texture.pixel_reads import (
    AtlasMesh,
    PixelReads,
    Place,
    ViewChange,
    atlas_mesh,
    part_of_corners,
    pixel_size,
    samples_for,
    video_reads,
)
from bake.texture.seams import edge_reads
from bake.texture.texels import TexelMap, atlas_areas, barycentric, neighbour_pairs, spread
from bake.texture.texture_solve import (
    ROUNDS,
    Equations,
    Prior,
    ShownRange,
    shown_range,
    solve_change,
    within_shown,
)
from capture.folder import PartVideo
from command.workers import on_all_cores
from geometry.least_squares import robust_weight
from geometry.mesh import TriangleMesh, blended, face_areas
from player.draw.raster import Rasteriser
from player.gl.context import open_context

# frames are averaged over k x k pixels before they are read, while a pixel stays within so many texels
FINEST_PIXEL = 1.3
# lambda of a texel as wide as a pixel and its growth with the texel's share of a pixel: many small texels under one
# pixel divide what it shows. mu over lambda.
STAY, STAY_POWER, SMOOTH = 0.06, 1.5, 4.0
# mu over lambda where color follows the eye: frames then disagree, and the grids of their pixels would show as ribs
SMOOTH_SHINE = 16.0
# texels in a pixel from which, where poses were estimated, mu grows so that it smooths over the same share of a pixel:
# frames disagree by more than a texel, and the grids of their pixels would show as a weave
WIDER = 1.5
# weight of a point on a chart edge looking the same from both sides
AGREE = 1.0
# share of the head from which a place is the head's alone, when what no video saw is filled
WHOLE_HEAD = 0.95
# difference of a pixel's color from what the others show, sRGB, at which it counts a quarter where poses were estimated
DOUBTED = 0.15
# frames that show a texel, away from outlines, up to which it counts as unseen, and from which as seen; the same of
# their mean squared cosine: at grazing angles a frame shows the colors of a print as one grey
UNSEEN, SEEN = 0.3, 1.0
GRAZING, FACING = 0.1, 0.3
# round what print runs, from joint to joint
LIMBS = (
    ("pelvis", "spine1", "spine2", "spine3", "neck"),
    *((f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist") for side in ("left", "right")),
    *((f"{side}_hip", f"{side}_knee", f"{side}_ankle") for side in ("left", "right")),
)


class VideoTexture(NamedTuple):
    """The finest level's atlas from the videos."""

    image: Float[Array, "size size 3"]  # [0, 1] sRGB
    texels: TexelMap
    facts: Facts


def with_video_textures(
    levels: list[BakedLevel], places: list[PlacesOnFinest], joints: Float[Array, "52 3"], videos: RunVideos,
    report: Callable[[str], None] = lambda line: None, change: ViewChange | None = None,
) -> tuple[list[BakedLevel], Facts]:  # fmt: skip
    """The levels with their base color solved against the videos, and what the file says of it.

    `places` are those of the coarser levels; `change` is what the finest level shows beyond its base color, where a
    view network is to show it.
    """
    solved = solve_texture(levels[0], joints, videos, report, change)
    shown = [(solved.image, solved.texels), *((place.read(solved.image), place.texels) for place in places)]
    result = on_all_cores(lambda pair: with_picture(pair[0], *pair[1]), zip(levels, shown, strict=True))
    return list(result), solved.facts


class ReadVideos(NamedTuple):
    equations: list[Equations]
    shown: list[ShownVideo]
    ranges: list[ShownRange]
    frames: Float[Array, "texels"]  # frames that show each texel, away from outlines
    faced: Float[Array, "texels"]  # the same, each times its squared cosine
    pixel: Float[Array, "parts"]  # metres of a pixel
    texel: Float[Array, "texels"]  # metres of a texel
    part: Integer[Array, "texels"]

    def seen_share(self) -> Float[Array, "texels"]:
        """How far each texel counts as seen, [0, 1]."""
        often = np.clip((self.frames - UNSEEN) / (SEEN - UNSEEN), 0, 1)
        square = self.faced / np.maximum(self.frames, 1e-9)
        return often * np.clip((square - GRAZING) / (FACING - GRAZING), 0, 1)

    def smoothing(self, estimated: bool) -> Float[Array, "texels"]:
        """How many times mu counts at each texel, where poses were `estimated` or not."""
        wide = self.pixel[self.part] / self.texel / WIDER
        return np.square(np.maximum(wide, 1)) if estimated else np.ones(len(wide))


def solve_texture(
    baked: BakedLevel, joints: Float[Array, "52 3"], videos: RunVideos, report: Callable[[str], None],
    change: ViewChange | None = None,
) -> VideoTexture:  # fmt: skip
    """The atlas of a level solved against the videos; see the module."""
    mesh = atlas_mesh(baked.level, joints, videos.chin, trunk=videos.trunk)
    given = (baked.level.base_color.reshape(-1, 3)[mesh.texels.index] / np.float32(255)).astype(np.float32)
    facts: Facts = {}
    found = read_videos(mesh, given, videos, change, facts, report)
    seams = seam_equations(mesh, baked, given)
    stay = STAY * (found.texel / found.pixel[found.part]) ** STAY_POWER
    smooth = (SMOOTH if change is None else SMOOTH_SHINE) * found.smoothing(videos.estimated)
    prior, pairs = Prior(stay, smooth * stay), neighbour_pairs(mesh.texels)
    equations, belief, blurred = found.equations, [np.ones(1, np.float32)] * len(PARTS), None
    if videos.estimated:
        # each time from where they were: first onto the blur of them all
        for window in WINDOWS:
            # what frames are moved onto need not be solved to the end
            rounds = ROUNDS // 2 if blurred is None else ROUNDS // 4
            blurred = solve_change(equations, prior, pairs, stiff=seams, rounds=rounds, start=blurred)
            equations = moved_onto(found, given, blurred, window, facts)
        moved = ", ".join(f"{name} {facts[name]['moved_mm']:.1f}" for name in PARTS)
        report(f"frames moved onto the texture they agree on, mm: {moved}")
        assert blurred is not None
        belief = [doubted(own, blurred) for own in equations]
    solution = solve_change(equations, prior, pairs, stiff=seams, start=blurred)
    surface = texel_surface(mesh, found.texel)
    solved = np.clip(within_shown(given + solution, given, surface.points, found.ranges), 0, 1)
    for name, own, sure in zip(PARTS, equations, belief, strict=True):
        # every pixel counts, those that were doubted as well
        left = (own.wanted - own.matrix @ (solved - given)) / sure[:, None]
        facts[name]["rms_after"] = rounded(255 * _rms(left, weight_roots(own.matrix) / sure))
    seen = found.seen_share()[:, None]
    if videos.estimated:
        seen[strange_beside_hair(surface, solved, seen[:, 0] == 1, videos.chin)] = 0
    rest = np.flatnonzero(seen < 1)
    fill = filled_colors(surface, solved, seen[:, 0] == 1)
    solved[rest] = seen[rest] * solved[rest] + (1 - seen[rest]) * fill
    image = spread(solved.astype(np.float64), mesh.texels)
    unseen = float(np.average(seen[:, 0] < 0.5, weights=found.texel**2))
    facts["unseen_share"] = rounded(unseen)
    report(f"textures: {unseen * 100:.0f} % of the surface was in no video, filled by material")
    return VideoTexture(image, mesh.texels, facts)


def moved_onto(
    found: ReadVideos, given: Float[Array, "texels 3"], change: Float[Array, "texels 3"], window: float, facts: Facts
) -> list[Equations]:
    """The equations as read, each frame moved onto the atlas `given + change`, `window` (metres) as one; how far goes
    into `facts`."""
    result = []
    for name, own, video in zip(PARTS, found.equations, found.shown, strict=True):
        moved, mean = aligned_frames(own, video, given, change, window)
        facts[name]["moved_mm"] = rounded(mean * 1e3)
        result.append(moved)
    return result


def read_videos(
    mesh: AtlasMesh, given: Float[Array, "texels 3"], videos: RunVideos, change: ViewChange | None, facts: Facts,
    report: Callable[[str], None],
) -> ReadVideos:  # fmt: skip
    """The equations of all videos on the atlas `given`. What the file says of each video goes into `facts`."""
    texel = texel_sizes(mesh)
    part = part_of_corners(mesh)[mesh.faces[mesh.texels.face]].max(1)
    frames, faced = np.zeros((2, len(given)))
    found = ReadVideos([], [], [], frames, faced, np.full(len(PARTS), np.inf), texel, part)
    with open_context() as context:
        rasteriser = Rasteriser(context)
        for index, name in enumerate(PARTS):
            video = videos.video(name)
            own = float(np.median(texel[part == index] if (part == index).any() else texel))
            seen_size = pixel_size(video, mesh, videos.head_from_canonical)
            video = averaged(video, averaging(seen_size, own))
            pixel = found.pixel[index] = pixel_size(video, mesh, videos.head_from_canonical)
            samples, light = samples_for(pixel, own), videos.lights.get(name)
            reads = video_reads(mesh, video, videos.head_from_canonical, rasteriser, samples, light, change)
            read = equations_of(reads, given, mesh.positions)
            found.ranges.append(shown_range(read.places, read.colors, max(pixel, own)))
            found.equations.append(read.equations)
            found.shown.append(ShownVideo(read.frames, video.cameras[0].size[0], pixel))
            for sums, own_sums in ((found.frames, read.shown), (found.faced, read.faced)):
                np.add(sums, np.square(pixel / texel) * own_sums, out=sums)
            facts[name] = {
                "pixel_mm": rounded(seen_size * 1e3),
                "pixels": len(read.equations.wanted),
                "rms_before": rounded(read.rms * 255),
            }
            report(
                f"{name}: {len(video.images)} frames, {seen_size * 1e3:.2f} mm a pixel, texels of {own * 1e3:.2f} mm, "
                f"{len(read.equations.wanted) / 1e6:.1f} M pixels, {read.rms * 255:.1f} of 255 beside the field's"
            )
        rasteriser.release()
    return found


class VideoEquations(NamedTuple):
    """What one video says of the atlas."""

    equations: Equations
    frames: list[Integer[Array, "pixels"]]  # each frame's pixels, in the order of the rows
    # sum over visible pixels of the share of the texel in the pixel, and of that times the squared cosine
    shown: Float[Array, "texels"]
    faced: Float[Array, "texels"]
    rms: float  # root mean square of what pixels show beside the given atlas, weighted
    places: Float[Array, "rows 3"]  # canonical, metres
    colors: Float[Array, "rows 3"]


def equations_of(
    reads: Iterable[PixelReads], given: Float[Array, "texels 3"], positions: Float[Array, "corners 3"]
) -> VideoEquations:
    """The equations of a video's frames, one matrix, weights multiplied in."""
    data, indices, lengths, wanted, frames, places, colors = [], [], [], [], [], [], []
    shown, faced = np.zeros((2, len(given)))
    for own in reads:
        matrix, root = own.reads, np.sqrt(own.weight)
        each = np.diff(matrix.indptr)
        for sums, share in ((shown, own.visible), (faced, own.visible * np.square(own.cosine))):
            sums += np.bincount(matrix.indices, matrix.data * np.repeat(share, each), len(given))
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
    rms = _rms(equations.wanted, weight_roots(matrix))
    return VideoEquations(equations, frames, shown, faced, rms, _joined(places), _joined(colors))


def doubted(equations: Equations, solution: Float[Array, "texels 3"]) -> Float[Array, "rows"]:
    """Weigh pixels less, in place, that differ from what most show, as one beside a lock that shows the shirt; by what
    each row was multiplied."""
    left = (equations.wanted - equations.matrix @ solution) / np.maximum(weight_roots(equations.matrix), 1e-9)[:, None]
    sure = np.sqrt(robust_weight(np.square(left).sum(1), DOUBTED)).astype(np.float32)
    equations.matrix.data *= np.repeat(sure, np.diff(equations.matrix.indptr))
    equations.wanted[:] *= sure[:, None]
    return sure


def _joined(pieces: list[Array]) -> Array:
    """The pieces as one array; the list is emptied, or large videos would be in memory twice."""
    result = np.concatenate(pieces)
    pieces.clear()
    return result


def weight_roots(matrix: csr_matrix) -> Float[Array, "rows"]:
    """Square roots of the weights that were multiplied into rows of reads, which sum to one."""
    return np.asarray(matrix.sum(1)).ravel()


def _rms(left: Float[Array, "rows 3"], root: Float[Array, "rows"]) -> float:
    """Root mean square of weighted residuals, over the weights, whose square roots are `root`."""
    return float(np.sqrt(np.square(left).sum() / max(3 * float(np.square(root).sum()), 1e-12)))


def seam_equations(mesh: AtlasMesh, baked: BakedLevel, given: Float[Array, "texels 3"]) -> Equations:
    """Points on chart edges look the same from both sides in the finest mip."""
    points = edge_reads(mesh.uv, baked.edges, mesh.size)
    parts = (np.float32(np.sqrt(AGREE)) * points.data.astype(np.float32), mesh.row_of[points.indices], points.indptr)
    matrix = csr_matrix(parts, (len(points.indptr) - 1, len(given)))
    matrix.sum_duplicates()
    return Equations(matrix, -(matrix @ given))


def texel_sizes(mesh: AtlasMesh) -> Float[Array, "texels"]:
    """Metres of each texel's side on the surface."""
    areas = atlas_areas(mesh.uv[mesh.faces] * mesh.size)
    side = np.sqrt(face_areas(mesh.positions, mesh.faces) / np.maximum(areas, 1e-6))
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
    blocks = lambda of: of[:, : rows * k, : columns * k].reshape(frames, rows, k, columns, k, *of.shape[3:])
    images = np.stack([np.round(one.mean((1, 3))).astype(np.uint8) for one in blocks(video.images)])
    scale = np.diag([1 / k, 1 / k, 1.0])
    cameras = tuple(
        Camera(scale @ camera.K, camera.camera_from_world, (columns, rows), camera.distortion)
        for camera in video.cameras
    )
    unsure = None if video.unsure is None else blocks(video.unsure).any((2, 4))
    return replace(video, images=images, masks=blocks(video.masks).all((2, 4)), cameras=cameras, unsure=unsure)


def texel_surface(mesh: AtlasMesh, texel: Float[Array, "texels"]) -> TexelSurface:
    """The texels as places of the welded mesh."""
    welded, index = np.unique(mesh.positions, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces]
    weight = np.clip(barycentric(mesh.uv, mesh.faces, mesh.texels, np.zeros(2)), 0, 1)
    weight /= weight.sum(1, keepdims=True)
    corners = mesh.faces[mesh.texels.face]
    facing = unit_or_zero(blended(mesh.normals, corners, weight))
    axes = limb_axes(mesh.joints)
    limbs, over = limbs_of(mesh.share, axes, Place(corners, weight))
    return TexelSurface(
        TriangleMesh(welded, faces), faces[mesh.texels.face], weight, blended(mesh.positions, corners, weight), facing,
        np.square(texel), mesh.piece[mesh.texels.face], limbs, over, axes,
    )  # fmt: skip


def limbs_of(
    share: Float[Array, "corners 52"], axes: Float[Array, "52 3"], place: Place
) -> tuple[Integer[Array, "points 2"], Float[Array, "points"]]:
    """The two joints that move each place most, and how much of it goes over to the second, half of it at most; under
    the chin the neck's is first, where the head's share is not whole. Nothing goes over to what is no limb."""
    head = JOINTS.index("head")
    of_head = place.of(share[:, [head]])[:, 0]
    limbs, most = np.zeros((2, len(of_head)), np.int64), np.zeros((2, len(of_head)))
    for joint in np.flatnonzero(np.arange(len(JOINTS)) != head):
        own = place.of(share[:, [joint]])[:, 0]
        # the larger of the two is first; the other may be second
        own, fallen = np.where(own > most[0], (own, most[0]), (most[0], own))
        limbs[1] = np.where(own > most[0], limbs[0], np.where(fallen > most[1], joint, limbs[1]))
        limbs[0] = np.where(own > most[0], joint, limbs[0])
        most = np.stack([own, np.maximum(most[1], fallen)])
    over = np.where(np.isfinite(axes[limbs[1], 0]), most[1] / np.maximum(most.sum(0), 1e-9), 0.0)
    limbs[0, of_head > WHOLE_HEAD] = head
    return limbs.T, over


def limb_axes(joints: Float[Array, "52 3"]) -> Float[Array, "52 3"]:
    """Unit directions of trunk, arms and legs from joint to joint in the canonical pose; 0 round the collar, which is
    cut aslant; NaN for other joints."""
    canonical = joint_transforms(np.asarray(BIG_POSE, np.float64), joints, np.zeros(3))[:, :3, 3]
    axes = np.full((len(JOINTS), 3), np.nan)
    axes[[JOINTS.index(name) for name in ("neck", "left_collar", "right_collar")]] = 0
    for chain in LIMBS:
        along = np.array([JOINTS.index(name) for name in chain])
        axes[along[:-1]] = unit_or_zero(np.diff(canonical[along], axis=0))
    return axes
