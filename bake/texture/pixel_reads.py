"""Which texels the pixels of a video read: each frame of it as a linear function of the atlas.

A frame is drawn s x s times finer than its pixels. A pixel is then the mean of the bilinear reads of its s x s
samples, a row of a sparse matrix over the texels. Pixels that lie half on the person are left out; those beside an
outline or a depth jump, where a millimetre of geometry shows another place, hardly count.
"""

from collections.abc import Callable, Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer, UInt8
from numpy import ndarray as Array
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.sparse import csr_matrix

from avatar.camera import Camera, pixel_rays
from avatar.gltf.avatar_file import Level
from avatar.light import CaptureLight
from avatar.rotation import unit_or_zero
from avatar.skeleton import JOINT_NUMBERS, LEFT_HAND, PARTS, RIGHT_HAND, skin_transforms
from avatar.skinning import SkinWeights, blended_transforms, dense_weights
from bake.cone import ViewCone, clamped_tangent
from bake.field import NumpyField
from bake.level import Charted, lifted
from bake.network import Distilled, SurfacePoints
from bake.texture.texels import TexelMap, bilinear, rasterise_charts
from capture.folder import PartVideo
from capture.template.hull import moved_camera
from command.workers import on_all_cores
from geometry.mesh import blended, component_labels
from player.draw.raster import Fragments, Rasteriser

# cosine between normal and view under which a pixel says nothing
GRAZING = 0.17
# power of that cosine in a pixel's weight: a head turns before its camera and is seen well by other frames. There the
# cosine counts beside the largest of all frames, SLANTED at least: shoulders are only seen at a slant
COSINE_POWER, SLANTED = {"body": 2, "head": 8, "hand_left": 2, "hand_right": 2}, 0.5
# weight under which a pixel is not worth its memory
LEAST_WEIGHT = 1e-3
# metres beside an outline or a jump in depth of JUMP metres, where pixels count RIM as much
RIM_WIDTH, JUMP, RIM = 0.003, 0.015, 0.05
# metres beside what stands FRONT nearer to the camera within which a pixel of the body's video says nothing where poses
# were estimated: a hem, or an arm, is not where it was drawn
COVERED, FRONT = 0.03, 0.03
# share of a picture's shorter side beside its border within which pixels count less and less: where a person leaves it,
# one video goes over into another
FADE = 0.12
# how much the body's video counts where another video looks closer
FAR_VIDEO = 0.1
# share of a video's own joints in a place's skin weights: none of the place's pixels count at the first, all above
# the first two together
SHARE_BEGIN, SHARE_RISE = 0.3, 0.5
# metres above the chin from which the head's video counts fully where poses were estimated; where the trunk's were
# too, metres under the chin down to which it counts fully, and down to which at all
OVER_CHIN, COLLAR = 0.01, (0.12, 0.2)
# the joints of a close-up's own part, and those that its poses hold: the forearm is in the hand's video too
PART_JOINTS = {
    "head": [15],
    "hand_left": [20, *range(LEFT_HAND.start, LEFT_HAND.stop)],
    "hand_right": [21, *range(RIGHT_HAND.start, RIGHT_HAND.stop)],
}
HELD_JOINTS = {
    **PART_JOINTS,
    "hand_left": [18, *PART_JOINTS["hand_left"]],
    "hand_right": [19, *PART_JOINTS["hand_right"]],
}
# those that move neck and collar: arms hang as they may
COLLAR_JOINTS = [JOINT_NUMBERS[name] for name in ("head", "neck", "spine3", "left_collar", "right_collar")]
# bytes from which on the light may have been brighter than shown; shading below which a pixel does not count
BURNT, DARK = 249, 0.15
# samples of a pixel, per side: about as far apart as texels are, at most so many
MOST_SAMPLES = 4


class AtlasMesh(NamedTuple):
    """A level of an avatar whose texels are solved for."""

    positions: Float[Array, "corners 3"]  # canonical, metres
    normals: Float[Array, "corners 3"]
    faces: Integer[Array, "faces 3"]
    uv: Float[Array, "corners 2"]
    skin: SkinWeights
    share: Float[Array, "corners 52"]  # skin weights, dense
    joints: Float[Array, "52 3"]
    texels: TexelMap
    # TexelMap.nearest_row of `texels`
    row_of: Integer[Array, "all"]
    # mean S and H (avatar/light.py) that the base color shows; None: light and albedo are not apart
    light: Float[Array, "corners 2"] | None
    # the connected piece of the surface that each face is of: body, hair
    piece: Integer[Array, "faces"]
    # canonical height of the chin, metres, where poses were estimated
    chin: float | None
    # whether the head's video has poses of the trunk
    trunk: bool

    @property
    def size(self) -> int:
        return self.texels.size


class PixelReads(NamedTuple):
    reads: csr_matrix  # pixels x rows of the texel map; rows sum to 1
    color: Float[Array, "pixels 3"]  # [0, 1] sRGB
    weight: Float[Array, "pixels"]
    # the same whatever the angle, as long as it is not grazing
    visible: Float[Array, "pixels"]
    cosine: Float[Array, "pixels"]  # between normal and view
    place: "Place"  # what lies at each pixel's first sample
    index: Integer[Array, "pixels"]  # row * width + column of each pixel in its frame


class Place(NamedTuple):
    """Points of the mesh's surface."""

    corners: Integer[Array, "points 3"]
    weight: Float[Array, "points 3"]  # barycentric

    def of(self, values: Float[Array, "corners channels"]) -> Float[Array, "points channels"]:
        """Values of the mesh's corners at these points."""
        return blended(values, self.corners, self.weight)


class PosedFrame(NamedTuple):
    """One frame with the person posed as in it."""

    vertices: Float[Array, "corners 3"]  # metres, the camera's world
    normals: Float[Array, "corners 3"]  # unit
    towards: Float[Array, "corners 3"]  # unit, to the camera
    along: Float[Array, "corners 3"]  # unit, away from the camera, in the canonical frame
    camera: Camera

    @property
    def cosine(self) -> Float[Array, "corners"]:
        """Between normal and direction to the camera."""
        return (self.normals * self.towards).sum(1)


class Belief(NamedTuple):
    """How much the pixels of a video count."""

    importance: Float[Array, "corners"]  # [0, 1], about each vertex
    # cosine c between normal and view of the frame that sees a vertex best; one of x counts c^2 (x / c)^power
    best: Float[Array, "corners"]
    power: int
    covered: float = 0.0  # metres beside what stands before it within which a pixel does not count


class FrameLight(NamedTuple):
    """The light of one frame at each vertex, and that of the base color."""

    light: CaptureLight
    frame: Float[Array, "corners 2"]  # S and H
    base: Float[Array, "corners 2"]


class ViewChange(NamedTuple):
    """What the file's view mode adds to the base color at a level's vertices, so that textures hold the base alone.

    The base color is the surface at its global view direction (Eq. 14); a shine that follows the eye is the view
    network's. Left in the pixels it would be averaged into the texture, and the grid of pixels would show where frames
    disagree.
    """

    cone: ViewCone
    # what is added at tangents t' (bake/cone.py), sRGB
    residual: Callable[[Float[Array, "corners 3"]], Float[Array, "corners 3"]]

    def seen_along(self, directions: Float[Array, "corners 3"]) -> Float[Array, "corners 3"]:
        """What is added along unit canonical directions (away from the camera); sRGB."""
        return self.residual(clamped_tangent(directions, self.cone))


def view_change(field: NumpyField, charted: Charted, distilled: Distilled) -> ViewChange | None:
    """The change of color at a level's vertices; None where the file's default view adds nothing."""
    if distilled.features is None:
        return None
    points, _ = lifted(field, charted.points, charted.normals)
    base = field.color(points, charted.cone.direction)
    features = distilled.features(SurfacePoints(points, charted.normals, base, charted.cone))
    return ViewChange(charted.cone, lambda tangent: distilled.residual(features, tangent))


def atlas_mesh(
    level: Level, joints: Float[Array, "52 3"], chin: float | None = None, *, trunk: bool = False
) -> AtlasMesh:
    """A level ready to be read by pixels; `chin` and `trunk` as `AtlasMesh` has them."""
    uv, faces = level.uv.astype(np.float64), level.faces.astype(np.int64)
    texels, skin = rasterise_charts(uv, faces, len(level.base_color)), level.skin
    light = None if level.light is None else level.light.astype(np.float64)
    return AtlasMesh(
        level.positions.astype(np.float64), level.normals.astype(np.float64), faces, uv, skin, dense_weights(skin),
        np.asarray(joints, np.float64), texels, texels.nearest_row().reshape(-1), light,
        pieces_of_faces(level.positions, faces), chin, trunk,
    )  # fmt: skip


def pieces_of_faces(positions: Float[Array, "corners 3"], faces: Integer[Array, "faces 3"]) -> Integer[Array, "faces"]:
    """The connected piece of each face of a level, whose vertices the atlas split."""
    _, welded = np.unique(positions, axis=0, return_inverse=True)
    welded = welded.reshape(-1)
    return component_labels(welded[faces], int(welded.max()) + 1)[welded[faces[:, 0]]]


def posed_frames(mesh: AtlasMesh, video: PartVideo, head_from_canonical: Float[Array, "4 4"]) -> Iterator[PosedFrame]:
    """The mesh as each frame shows it. The head's cameras are brought to the canonical frame, in metres; there the head
    stands still, and the trunk, where it is known, goes with it."""
    for frame, camera in enumerate(video.cameras):
        if video.axis_angle is not None and video.root is not None:
            transforms = skin_transforms(video.axis_angle[frame], mesh.joints, video.root[frame])
        else:
            camera, transforms = moved_camera(camera, head_from_canonical), None
            if video.trunk is not None:
                transforms = skin_transforms(video.trunk[frame], mesh.joints, np.zeros(3))
                transforms = np.linalg.inv(transforms[JOINT_NUMBERS["head"]]) @ transforms
        if transforms is None:
            vertices, normals, turns = mesh.positions, mesh.normals, None
        else:
            M = blended_transforms(mesh.skin, transforms)
            vertices = np.einsum("vij,vj->vi", M[:, :3, :3], mesh.positions) + M[:, :3, 3]
            normals = unit_or_zero(np.einsum("vij,vj->vi", M[:, :3, :3], mesh.normals))
            turns = M[:, :3, :3]
        towards = unit_or_zero(camera.eye - vertices)
        along = -towards if turns is None else -np.einsum("vji,vj->vi", turns, towards)
        yield PosedFrame(vertices, normals, towards, unit_or_zero(along), camera)


def frame_light(mesh: AtlasMesh, frame: PosedFrame, light: CaptureLight | None) -> FrameLight | None:
    """S and H of a frame; None where light and albedo are not apart. A light of the world is that of the frame's
    vertices."""
    if light is None or mesh.light is None:
        return None
    turn = frame.camera.camera_from_world[:3, :3] if light.frame == "camera" else np.eye(3)
    normals = frame.normals @ turn.T
    found = np.stack([light.shading(normals), light.highlight(normals, frame.towards @ turn.T)], 1)
    return FrameLight(light, found, mesh.light)


def as_base_color(color: Float[Array, "pixels 3"], lit: FrameLight, place: Place) -> Float[Array, "pixels 3"]:
    """Colors of pixels as the light of the base color would show them."""
    (shading, highlight), (base, glow) = place.of(lit.frame).T, place.of(lit.base).T
    return lit.light.shown(lit.light.albedo(color, shading, highlight), base, glow)


def vertex_importance(mesh: AtlasMesh, part: str) -> Float[Array, "corners"]:
    """How much a video is believed about each vertex, [0, 1], by what its poses hold and what looks closer.

    Where poses were estimated, and the trunk's in the head's video were not, it shows neck, collar and the ends of hair
    otherwise bent than they stand, and is not believed about what lies under the chin.
    """

    def believed(part: str, joints: dict[str, list[int]]) -> Float[Array, "corners"]:
        own, (low, high) = joints[part], (0.0, OVER_CHIN)
        if part == "head" and mesh.trunk:
            own, (high, low) = COLLAR_JOINTS, np.negative(COLLAR)
        held = np.clip((mesh.share[:, own].sum(1) - SHARE_BEGIN) / SHARE_RISE, 0, 1)
        if part == "head" and mesh.chin is not None:
            held *= np.clip((mesh.positions[:, 1] - mesh.chin - low) / (high - low), 0, 1)
        return held

    if part == "body":
        closer = sum(believed(own, PART_JOINTS) for own in PART_JOINTS)
        return 1 - (1 - FAR_VIDEO) * np.clip(closer, 0, 1)
    return believed(part, HELD_JOINTS)


def pixel_size(video: PartVideo, mesh: AtlasMesh, head_from_canonical: Float[Array, "4 4"]) -> float:
    """Metres of a pixel where the video's own part is, in its middle frame."""
    own, sizes = vertex_importance(mesh, video.part) > 0.5, []
    step = max(len(video.cameras) // 4, 1)
    for frame in islice(posed_frames(mesh, video, head_from_canonical), 0, None, step):
        view = frame.camera.camera_from_world
        depth = frame.vertices[own] @ view[2, :3] + view[2, 3]
        sizes.append(float(np.median(depth)) / frame.camera.K[0, 0])
    return float(np.median(sizes))


def video_reads(
    mesh: AtlasMesh, video: PartVideo, head_from_canonical: Float[Array, "4 4"], rasteriser: Rasteriser, samples: int,
    light: CaptureLight | None = None, change: ViewChange | None = None,
) -> Iterator[PixelReads]:  # fmt: skip
    """What the pixels of each frame read, `samples` x `samples` places a pixel.

    `light` is divided out of them, and what they show because of where they were seen from (`change`) taken off.
    """
    power, best = COSINE_POWER[video.part], np.ones(len(mesh.positions))
    if power > 2:
        # every other frame tells it well enough
        frames = islice(posed_frames(mesh, video, head_from_canonical), 0, None, 2)
        best = np.max([frame.cosine for frame in frames], 0).clip(SLANTED, 1)
    covered = COVERED if video.part == "body" and mesh.chin is not None else 0.0
    belief = Belief(vertex_importance(mesh, video.part), best, power, covered)

    def of_drawn(drawn_frame: tuple[int, PosedFrame, Fragments]) -> PixelReads:
        """What the pixels of a drawn frame read."""
        number, frame, drawn = drawn_frame
        sure = video.masks[number]
        if video.unsure is not None:
            # what is away from a head is unknown to its mask alone (capture/read/close_up.py)
            sure = sure | video.unsure[number] if video.trunk is not None else sure & ~video.unsure[number]
        lit = frame_light(mesh, frame, light)
        own = frame_reads(mesh, frame, drawn, video.images[number], sure, belief, lit)
        if change is not None:
            shown = own.place.of(change.seen_along(frame.along))
            own = own._replace(color=np.clip(own.color - shown, 0, 1).astype(np.float32))
        return own

    frames = enumerate(posed_frames(mesh, video, head_from_canonical))
    # one thread draws, all of them read
    drawn = ((number, frame, drawn_finer(rasteriser, mesh, frame, samples)) for number, frame in frames)
    return on_all_cores(of_drawn, drawn)


def drawn_finer(rasteriser: Rasteriser, mesh: AtlasMesh, frame: PosedFrame, samples: int) -> Fragments:
    """The frame with `samples` x `samples` places a pixel, where the camera's own lens puts them."""
    camera = frame.camera
    size = (camera.size[0] * samples, camera.size[1] * samples)
    drawn = rasteriser.draw(frame.vertices, mesh.faces, camera, size)
    if not camera.distortion.any():
        return drawn
    # the rasteriser knows no lens: each place of the picture is looked up where a pinhole shows it
    _, rays = pixel_rays(camera.resized(size))
    local = rays @ camera.camera_from_world[:3, :3].T
    K = camera.resized(size).K
    column = np.floor((K[0, 0] * local[:, 0] + K[0, 1] * local[:, 1]) / local[:, 2] + K[0, 2]).astype(np.int64)
    row = np.floor(K[1, 1] * local[:, 1] / local[:, 2] + K[1, 2]).astype(np.int64)
    inside = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
    place = np.where(inside, row * size[0] + column, 0)
    face = np.where(inside, drawn.face.reshape(-1)[place], -1).reshape(drawn.face.shape)
    return Fragments(
        face,
        drawn.barycentric.reshape(-1, 3)[place].reshape(drawn.barycentric.shape),
        np.where(face >= 0, drawn.depth.reshape(-1)[place].reshape(face.shape), np.float32(np.inf)),
    )


def frame_reads(
    mesh: AtlasMesh, frame: PosedFrame, drawn: Fragments, image: UInt8[Array, "height width 3"],
    sure: Bool[Array, "height width"], belief: Belief, lit: FrameLight | None = None,
) -> PixelReads:  # fmt: skip
    """The pixels of one frame that lie on the person as a whole; `sure` are those of its mask."""
    height, width = sure.shape
    s = drawn.face.shape[0] // height
    hit = drawn.face >= 0
    whole = hit.reshape(height, s, width, s).all((1, 3)) & sure
    rows, columns = np.nonzero(whole)
    i, j = np.divmod(np.arange(s * s), s)
    place = (rows[:, None] * s + i) * (width * s) + columns[:, None] * s + j
    face = drawn.face.reshape(-1)[place]
    weight = drawn.barycentric.reshape(-1, 3)[place]
    corners = mesh.faces[face]
    values = np.stack([frame.cosine, belief.importance, belief.best], 1).astype(np.float32)
    cosine, important, best = blended(values, corners, weight).mean(1).T
    visible = important * (cosine > GRAZING) * np.where(_near_rim(frame, drawn, hit, sure)[whole], RIM, 1.0)
    visible *= from_border(whole)[whole]
    if belief.covered:
        visible *= ~_beside_front(frame, drawn, hit, belief.covered, s)[whole]
    counts = visible * best**2 * (np.maximum(cosine, 0) / best) ** belief.power
    if lit is not None:
        # a burnt pixel may have been brighter, and what no light reached shows no color
        known = (image[rows, columns].max(1) < BURNT) & (blended(lit.frame, corners, weight).mean(1)[:, 0] > DARK)
        counts = counts * known
    used = counts > LEAST_WEIGHT
    corners, weight = corners[used], weight[used]
    place = Place(corners[:, 0], weight[:, 0])
    uv = blended(mesh.uv.astype(np.float32), corners, weight)
    reads = bilinear_reads(uv, mesh)
    color = image[rows[used], columns[used]].astype(np.float32) / 255
    if lit is not None:
        color = as_base_color(color, lit, place).astype(np.float32)
    return PixelReads(
        reads, color, counts[used].astype(np.float32), visible[used].astype(np.float32), cosine[used], place,
        rows[used] * width + columns[used],
    )  # fmt: skip


def bilinear_reads(uv: Float[Array, "pixels samples 2"], mesh: AtlasMesh) -> csr_matrix:
    """Pixels x rows of the texel map: the mean over samples of what a bilinear filter reads."""
    texel, weight = bilinear(uv, mesh.size)
    value = weight / np.float32(uv.shape[1])
    pixels, each = len(uv), uv.shape[1] * 4
    pointers = np.arange(pixels + 1, dtype=np.int32) * each
    shape = (pixels, len(mesh.texels.index))
    result = csr_matrix((value.reshape(-1), mesh.row_of[texel.reshape(-1)], pointers), shape)
    result.sum_duplicates()
    return result


def from_border(whole: Bool[Array, "height width"]) -> Float[Array, "height width"]:
    """How much the pixels of a picture count for being near its border: from 0 to 1 within FADE of its shorter side."""
    away = [np.minimum(np.arange(n) + 0.5, n - 0.5 - np.arange(n)) for n in whole.shape]
    return np.clip(np.minimum(away[0][:, None], away[1]) / (FADE * min(whole.shape)), 0, 1)


def _near_rim(
    frame: PosedFrame, drawn: Fragments, hit: Bool[Array, "rows columns"], sure: Bool[Array, "height width"]
) -> Bool[Array, "height width"]:
    """Pixels within RIM_WIDTH of an outline, of the person's mask's end, or of a jump in depth."""
    height, width = sure.shape
    s = hit.shape[0] // height
    if not hit.any():
        return np.zeros_like(sure)
    depth = np.where(hit, drawn.depth, 1e3)
    bad = ~hit | ~np.repeat(np.repeat(sure, s, 0), s, 1)
    across, down = np.abs(np.diff(depth, axis=1)) > JUMP, np.abs(np.diff(depth, axis=0)) > JUMP
    bad[:, 1:] |= across
    bad[:, :-1] |= across
    bad[1:] |= down
    bad[:-1] |= down
    bad = maximum_filter(bad, size=_window(frame, drawn, hit, RIM_WIDTH, s))
    return np.asarray(bad.reshape(height, s, width, s).any((1, 3)))


def _beside_front(
    frame: PosedFrame, drawn: Fragments, hit: Bool[Array, "rows columns"], width: float, s: int
) -> Bool[Array, "height width"]:
    """Pixels within `width` metres of the edge of what stands FRONT nearer to the camera."""
    rows, columns = hit.shape
    if not hit.any():
        return np.zeros((rows // s, columns // s), bool)
    depth = np.where(hit, drawn.depth, np.float32(1e3))
    front = np.full_like(depth, np.inf)
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        for near, far in ((one, other), (other, one)):
            front[near][depth[far] - depth[near] > FRONT] = depth[near][depth[far] - depth[near] > FRONT]
    behind = depth - minimum_filter(front, size=_window(frame, drawn, hit, width, s)) > FRONT
    return np.asarray(behind.reshape(rows // s, s, columns // s, s).any((1, 3)))


def _window(frame: PosedFrame, drawn: Fragments, hit: Bool[Array, "rows columns"], metres: float, s: int) -> int:
    """Samples of a square that reaches so far to each side of its middle, where the person stands."""
    sample = float(np.median(drawn.depth[hit])) / (frame.camera.K[0, 0] * s)
    return 2 * int(np.ceil(metres / sample)) + 1


def samples_for(pixel: float, texel: float) -> int:
    """Samples a side of a pixel of `pixel` metres on texels of `texel` metres."""
    return int(np.clip(np.ceil(pixel / texel), 1, MOST_SAMPLES))


def part_of_corners(mesh: AtlasMesh) -> Integer[Array, "corners"]:
    """The part of each vertex by its skin weights, and what the head's video shows of the trunk; index into PARTS."""
    sums = [mesh.share[:, PART_JOINTS[part]].sum(1) for part in PARTS[1:]]
    found = np.where(np.max(sums, axis=0) > 0.5, np.argmax(sums, axis=0) + 1, 0)
    return np.where(mesh.trunk & (vertex_importance(mesh, "head") > 0.5), PARTS.index("head"), found)
