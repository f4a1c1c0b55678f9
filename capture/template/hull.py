"""Hair that stands off the template: carved from the masks and joined to the template before anything is learned.

Long hair lies farther from a registered body than any band in which a surface is looked for. A visual hull
(Laurentini 1994) of head and body video shows where it is: what the masks of nearly all views hold is the person,
and what of that stands far off the template round the head is hair. Everything later reads only the template, so
hair joined to it here is marched to, learned, skinned and baked like skin. It moves with the head (rule H: strands
hang from it, whatever shoulder they touch).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage

from avatar.camera import Camera
from avatar.skeleton import BIG_POSE, JOINTS, PARTS, skin_transforms
from avatar.skinning import skin_points
from capture.folder import Capture, CaptureSubject, PartVideo
from capture.template.grid import DistanceGrid, closed_surface, distance_grid, trilinear
from capture.template.hollows import ColorView, Sure, carve_hollows, color_views, pixels_of
from capture.template.parts import rigid_weights
from capture.template.surface import surface_cloud, visible_faces
from capture.videos import even
from command.workers import on_all_cores
from geometry.cells import distance_to, pieces
from geometry.mesh import compact

HEAD = JOINTS.index("head")
CELL = 0.006  # metres, of the carved grid
# metres beyond the head that hair may hang, x, y (down), z
AROUND = (0.10, 0.25, 0.10)
# views at least; what fewer see is taken for empty
SEEN_BY = 8
# metres: the hull lies outside the hair, and masks are a pixel or two off
ERODED = 0.006
FARTHEST = 0.12  # metres: no hair stands farther off
# metres: farther than this off the template is hair
STANDS_OFF = 0.015
# cubic metres, a tenth of a litre: less standing off is an ear, a collar, a hull's hollow
LEAST = 1e-4
# share of a head's height over its lowest skin where the brow is: all that stands off above it is hair
BROW = 0.65
# metres: half of a face's width, and how far under the head's lowest skin its throat goes; no hair hangs before either
FACE, THROAT = 0.06, 0.06
# metres over the head's lowest skin from which on what stands off behind the face is surely hair
CHIN = 0.08
# metres before the middle of the skull from which nothing distinguishes a thin lock from a cheek
CHEEK = 0.05
# metres behind the middle of the skull where the neck's back begins
NAPE = 0.06
RISEN = 5  # poses of the body's video whose shoulders are asked
# levels under the neck over which hair hangs one cell farther out
STEEP = 3
# metres beside what stands off, over which its edge sinks to the skin
BESIDE = 0.045


class Trust(NamedTuple):
    """What is hair where template and poses are known so well."""

    against: float  # a cell is empty when a greater share of the views that see it show background there
    trunk: float  # metres off the trunk that are hair
    over: float  # metres over the head's lowest skin to which shoulders may rise
    beside: float  # metres beside what stands off before the nape, over which its edge sinks to the trunk
    # metres off the head, and STANDS_OFF off the trunk, that are hair where they hang together with what stands off
    joined: float
    # whether outlines drew the scalp out, as far as short hair: where more stands off, it then has hair all over
    drawn_out: bool


GIVEN = Trust(0.1, STANDS_OFF, 0.0, BESIDE, np.inf, drawn_out=False)
# poses from the videos: outlines are a centimetre off, shoulders two, and a tenth of the views contradicts half of the
# hair; an edge as wide as in what is given is a plate on the shoulder. Locks beside a face are as thin as their error
ESTIMATED = Trust(0.2, 0.025, 0.03, 0.015, 0.006, drawn_out=True)


class MaskView(NamedTuple):
    """Where a picture shows background, and the camera that took it, moved to where the head rests canonically."""

    beside: Bool[Array, "height width"]  # surely background: a pixel that is not to be believed proves no air
    camera: Camera  # its camera_from_world takes canonical metres


def mask_views(video: PartVideo, frames_from_canonical: Sequence[Float[Array, "4 4"]] | Array) -> list[MaskView]:
    """A video's views of what moves by one rigid motion, or similarity, in each frame."""
    unsure = np.zeros_like(video.masks) if video.unsure is None else video.unsure
    cameras = map(moved_camera, video.cameras, frames_from_canonical)
    return [MaskView(~(mask | edge), camera) for mask, edge, camera in zip(video.masks, unsure, cameras, strict=True)]


def head_cameras(video: PartVideo, canonical_from_head: Float[Array, "4 4"]) -> list[Camera]:
    """The head video's cameras; their frame differs from the canonical one by a similarity (Eq. 6)."""
    head_from_canonical = np.linalg.inv(canonical_from_head)
    return [moved_camera(camera, head_from_canonical) for camera in video.cameras]


def moved_camera(camera: Camera, frame_from_canonical: Float[Array, "4 4"]) -> Camera:
    """The camera of a frame as one that takes canonical metres.

    A similarity of the scene shows as the same picture when the camera's frame is scaled with it.
    """
    scale = float(np.cbrt(np.linalg.det(frame_from_canonical[:3, :3])))
    pose = camera.camera_from_world @ frame_from_canonical
    pose[:3] /= scale
    return replace(camera, camera_from_world=pose)


def background_share(
    points: Float[Array, "n 3"], views: Sequence[MaskView]
) -> tuple[Float[Array, "n"], Int[Array, "n"]]:
    """Of the views whose picture holds a point the share that shows background there, and how many views hold it."""
    against, seen = np.zeros(len(points)), np.zeros(len(points), int)
    for view in views:
        row, column, _, holds = pixels_of(view.camera, points)
        seen += holds
        against[holds] += view.beside[row[holds], column[holds]]
    return against / np.maximum(seen, 1), seen


class Scalp(NamedTuple):
    """Where hair grows, canonical metres."""

    neck: float  # height of the head's lowest skin
    brow: float  # height
    middle: tuple[float, float]  # the skull's, x and z


def scalp_of(head: Float[Array, "n 3"]) -> Scalp:
    """The scalp of a head's skin."""
    neck, top = head[:, 1].min(), head[:, 1].max()
    brow = neck + BROW * (top - neck)
    skull = head[head[:, 1] > brow]
    x, _, z = 0.5 * (skull.min(0) + skull.max(0))
    return Scalp(float(neck), float(brow), (float(x), float(z)))


class Hair(NamedTuple):
    """A closed volume of hair on a grid of the canonical frame: 1 inside, 0 outside, smooth between."""

    share: Float[Array, "x y z"]
    low: Float[Array, "3"]  # place of share[0, 0, 0], metres
    cell: float


class Pictures(NamedTuple):
    """What colors need to carve hollows (capture/template/hollows.py)."""

    subject: CaptureSubject
    views: Sequence[ColorView]
    # vertices of skin and clothes whose colors are no hair's; None: masks and template are exact, colors say no more
    bare: Bool[Array, "vertices"] | None = None


def carve(
    views: Sequence[MaskView], template: DistanceGrid, scalp: Scalp, pictures: Pictures | None = None,
    trust: Trust = GIVEN,
) -> Hair | None:  # fmt: skip
    """What the views hold round the template, where it stands off far enough to be hair; None: nothing.

    A piece counts when some of it is above the neck. The hair lies on the template's grid. With `pictures` hollows
    that are full in every mask are carved by color.
    """
    distance, cell = template.values.astype(np.float64), template.cell
    low = template.low.astype(np.float64)
    axes = [low[i] + cell * np.arange(distance.shape[i]) for i in range(3)]
    _, y, z = np.meshgrid(*axes, indexing="ij", sparse=True)
    back = z < scalp.middle[1]
    behind = (y > scalp.neck + CHIN) & back
    held = distance < 0
    asked = np.argwhere(~held & (distance < FARTHEST))
    share, seen = background_share(low + cell * asked, views)
    held[tuple(asked.T)] = (share <= trust.against) & (seen >= SEEN_BY)
    if pictures is not None:
        sure = None
        if pictures.bare is not None:
            sure = Sure(np.broadcast_to(behind, held.shape), np.broadcast_to(back, held.shape), pictures.bare)
        held &= ~carve_hollows(held, held & (distance > cell), low, cell, pictures.subject, pictures.views, sure)
    hull = distance_to(~held) * cell > ERODED
    head = y > scalp.neck + np.where(z > scalp.middle[1] - NAPE, trust.over, 0.0)
    least = np.where(head, STANDS_OFF, trust.trunk)
    beside = np.where(head | (z < scalp.middle[1] - NAPE), BESIDE, trust.beside)
    standing = hull & (distance > least)
    standing = np.asarray(ndimage.binary_opening(standing, ndimage.generate_binary_structure(3, 1)), bool)
    free = hanging(hull & (distance > -2 * cell), axes, scalp)
    standing &= free
    above = np.broadcast_to((axes[1] > scalp.neck)[:, None], standing.shape)
    standing = large_pieces(standing, cell, LEAST, above)
    if not standing.any():
        return None
    # behind, where hair is all that is as near, what the opening took away stays away
    thin = free & ~behind & (z < scalp.middle[1] + CHEEK)
    thin &= distance > np.maximum(trust.joined, np.where(head, 0, STANDS_OFF))
    thin = np.asarray(ndimage.binary_propagation(standing, mask=standing | thin), bool)
    # down to the template under and beside what stands off, so that neither gap nor step is left between hair and skin;
    # thin locks beside a face cast no such edge on it
    away = np.where(before_face(axes, scalp), distance_to(standing), distance_to(thin)) * cell
    edge = least * (1 - away / beside)
    if trust.drawn_out:
        edge = np.where((y > scalp.brow) | behind, least, edge)
    solid = hull & (distance > -2 * cell) & (distance < edge) | thin
    return Hair(ndimage.gaussian_filter(solid.astype(np.float64), 0.8), low, cell)


def large_pieces(
    cells: Bool[Array, "x y z"], cell: float, least: float, reached: Bool[Array, "x y z"]
) -> Bool[Array, "x y z"]:
    """The cells of connected pieces of `least` cubic metres or more that hold one of the cells `reached`."""
    label = pieces(cells)
    large = np.bincount(label.ravel()) * cell**3 >= least
    return cells & (large & (np.bincount(label[reached], minlength=len(large)) > 0))[label]


def before_face(axes: Sequence[Array], scalp: Scalp) -> Bool[Array, "x y z"]:
    """Where no hair hangs: before face and throat."""
    x, y, z = np.meshgrid(*axes, indexing="ij", sparse=True)
    return (np.abs(x - scalp.middle[0]) < FACE) & (z > scalp.middle[1]) & (y > scalp.neck - THROAT) & (y < scalp.brow)


def hanging(outer: Bool[Array, "x y z"], axes: Sequence[Array], scalp: Scalp) -> Bool[Array, "x y z"]:
    """Of the `outer` cells of a person those that hair may be: above the neck all but before the face, below it what is
    reached from there downwards. What else stands off is a collar, or a shoulder that is not where the template has it.
    """
    free = outer & ~before_face(axes, scalp)
    for level in range(len(axes[1]) - 2, -1, -1):
        if axes[1][level] < scalp.neck:
            over = free[:, level + 1]
            wider = np.asarray(ndimage.binary_dilation(over), bool) if level % STEEP == 0 else over
            free[:, level] &= wider
    return free


def with_hair(
    subject: CaptureSubject, capture: Capture, canonical_from_head: Float[Array, "4 4"], *, hollows: bool, layers: bool
) -> CaptureSubject:
    """The subject with standing hair joined to its template; the subject itself where there is none.

    Template faces inside the hair are dropped, with `layers` into `under_hair`; vertices keep their numbers. Hair
    vertices move with the head; above the neck they belong to the head part, below it to the body.
    """
    head = subject.vertices[(subject.part == PARTS.index("head")) & ~subject.hair]
    scalp = scalp_of(head)
    around = np.array(AROUND)
    low, high = head.min(0) - around, head.max(0) + [around[0], 0.06, around[2]]
    body = capture.videos["body"]
    assert body.axis_angle is not None and body.root is not None
    held, visible = under_held_head(subject, body.axis_angle.mean(0)), visible_faces(subject)

    def distance_of(held: CaptureSubject) -> DistanceGrid:
        cloud = surface_cloud(held, PARTS.index("head"), visible, 0.004, 0.008)
        return distance_grid(cloud, low, high, CELL, (held, scalp.neck))

    # no place is hair's that shoulders take when they rise
    risen = even(len(body.axis_angle), RISEN) if capture.fitted_here else []
    grids = list(on_all_cores(distance_of, [held, *(under_held_head(subject, body.axis_angle[i]) for i in risen)]))
    template = grids[0]._replace(values=np.min([grid.values for grid in grids], 0))
    head_video = capture.videos["head"]
    count = len(head_video.cameras)
    views = mask_views(head_video, [np.linalg.inv(canonical_from_head)] * count)
    # what hangs from the head moves with its bone
    views += mask_views(body, skin_transforms(body.axis_angle, subject.joints, body.root)[:, HEAD])
    pictures = None
    if hollows and capture.fitted_here:
        # under the chin a close-up's mask is not to be believed, but hair would have hair's color there too
        films = (head_video, views[:count]), (body, views[count:])
        colored = [view for film, seen in films for view in color_views(
            film.images, ~np.stack([v.beside for v in seen]), [v.camera for v in seen], (low, high))]  # fmt: skip
        pictures = Pictures(held, colored, bare_vertices(subject, scalp))
    elif hollows:
        cameras = [view.camera for view in views[:count]]
        pictures = Pictures(subject, color_views(head_video.images, head_video.masks, cameras))
    hair = carve(views, template, scalp, pictures, ESTIMATED if capture.fitted_here else GIVEN)
    if hair is None:
        return subject

    vertices, faces = closed_surface(0.5 - hair.share, hair.low, hair.cell, 0.5)
    # what of the hair lies under the skin is no surface, and what of the skin lies under the hair neither
    under = template.at(vertices[faces].mean(1))
    mesh, _ = compact(vertices, faces[under > -0.003])
    covered = trilinear(*hair, held.vertices[subject.faces].mean(1), 0.0) > 0.75
    bone = skin_transforms(BIG_POSE, subject.joints, rest=np.zeros((52, 3)))[HEAD]
    rest = np.linalg.solve(bone[:3, :3], (mesh.vertices - bone[:3, 3]).T).T
    part = np.where(mesh.vertices[:, 1] > scalp.neck, PARTS.index("head"), PARTS.index("body"))
    out = subject.joined(subject.faces[~covered], mesh, rest, rigid_weights(len(rest)), part, hair=True)
    out = replace(out, carved=(len(subject.vertices), len(out.vertices)))
    return replace(out, under_hair=subject.faces[covered]) if layers else out


def bare_vertices(subject: CaptureSubject, scalp: Scalp) -> Bool[Array, "vertices"]:
    """The face, and the trunk in front under the neckline: no hair covers them."""
    x, y, z = subject.vertices.T
    front = z > scalp.middle[1]
    face = (subject.part == PARTS.index("head")) & (y < scalp.brow) & (np.abs(x - scalp.middle[0]) < FACE)
    return front & (face & ~subject.hair | (subject.part == PARTS.index("body")) & (y < scalp.neck - THROAT))


def under_held_head(subject: CaptureSubject, axis_angle: Float[Array, "52 3"]) -> CaptureSubject:
    """The subject in a pose of the body's video, its head where it rests canonically: the trunk bends, and hair lies on
    shoulders where they are."""
    B = skin_transforms(axis_angle, subject.joints, np.zeros(3))
    return replace(subject, vertices=skin_points(subject.vertices, subject.skin, np.linalg.inv(B[HEAD]) @ B))
