"""Poses moved until the template's outline lies on the masks' outline: before any field is trained.

The template is the registered person, so its outline is known from the start. Per frame, with increments d of the
joints' rotations (R_j exp d_j) and of the root, least squares of

    sum over outline pixels  (n . (q - p(d)) - e)^2 / s^2      p on the template's outline, q on the mask's, n normal
    + sum over samples       |I(p(d)) - mean color|^2 / s_c^2  the same spot has one color in all frames
    + |d from the given pose|^2 / s_prior^2
    + |second difference in time|^2 / s_smooth^2                people move smoothly; robust, jumps are let through

is solved by Gauss-Newton for all frames at once: frames meet only in the last term, the system is banded. After each
round e, how far the person stands off the template there, is set to what the frames agree on: clothes, hair and masks
that are all too large are no error of a pose.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage

from avatar.camera import project
from avatar.kinematics import DESCENDS, Posed, increment_rows, pixel_rows, posed_canonical, second_turns, turned
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import PARENTS, PARTS
from avatar.skinning import dense_weights, skin_points
from capture.fit.contours import Contour, pixel_contour
from capture.fit.outline import ShapeCells, placement
from capture.fit.pixels import bilinear
from capture.folder import CaptureSubject, PartVideo
from capture.videos import even
from geometry.least_squares import NormalEquations, robust_weight
from geometry.mesh import vertex_normals
from geometry.rasterise import FaceBuffer, rasterise

# standard deviations. Pixels of one outline pixel: neighbours err together, so more than a pixel
OUTLINE = 3.0
COLOR = 0.15  # one sample's, sRGB
PRIOR = 3.0  # degrees, each joint about each axis
ROOT = 0.01  # metres
SMOOTH = 1.0  # degrees a frame a frame
# pixels of an image 256 high: over this much of the surface the shape is off alike
CELL = 10.0
# outline pixels that have to agree before the shape is believed to be off
PSEUDOCOUNT = 10.0
# the last COLORED of the rounds use colors too
ROUNDS, COLORED = 12, 5


class Aligned(NamedTuple):
    """Poses on the masks, and how well each frame's outline lies there."""

    axis_angle: Float[Array, "frames 52 3"]
    root: Float[Array, "frames 3"]
    # mean distance of the outlines, pixels of an image 256 high; inf: none in view
    edge: Float[Array, "frames"]


class _Scene(NamedTuple):
    """What is aligned: the same in all rounds."""

    video: PartVideo
    subject: CaptureSubject
    # joints that may turn
    moving: Int[Array, "m"]
    # faces whose outline places the part
    near: Bool[Array, "faces"]

    @property
    def part(self) -> int:
        return PARTS.index(self.video.part)

    @property
    def scale(self) -> float:
        """Pixels of the video for one of an image 256 high."""
        return self.video.masks.shape[1] / 256


class _SeenVertices(NamedTuple):
    """Vertices of the part that one frame shows well."""

    frame: Posed
    at: Int[Array, "n"]
    places: Float[Array, "n 3"]  # world
    pixels: Float[Array, "n 2"]


class _DrawnTemplate(NamedTuple):
    """One frame's template: world, and drawn."""

    frame: Posed
    posed: Float[Array, "vertices 3"]
    drawn: FaceBuffer
    outline: Contour
    face: Int[Array, "n"]  # drawn at the outline's pixels
    # how far the outline pixels were slid from where they are drawn
    slid: Float[Array, "n 2"]


def metres_of_a_pixel(video: PartVideo) -> float:
    """How large a pixel is at the person, middle frame."""
    assert video.root is not None
    sizes = [np.linalg.norm(root - camera.eye) / camera.K[0, 0] for root, camera in zip(video.root, video.cameras)]
    return float(np.median(sizes))


def moving_joints(subject: CaptureSubject, video: PartVideo, *, least: float = 20.0) -> Int[Array, "m"]:
    """Joints whose turning shows in the video: some vertex of the part moves `least` pixels a radian or more."""
    assert video.axis_angle is not None and video.root is not None
    chosen = np.ones(len(subject.rest), bool) if video.part == "body" else subject.part == PARTS.index(video.part)
    # how much of a vertex follows joint j
    moves = dense_weights(subject.skin.of(chosen)) @ DESCENDS
    away = np.linalg.norm(subject.rest[chosen][:, None] - subject.joints, axis=2)
    camera = video.cameras[0]
    depth = max(float((camera.camera_from_world[:3] @ np.append(video.root[0], 1))[2]), 0.1)
    return np.flatnonzero((moves * away).max(0) * camera.K[0, 0] / depth >= least)


def align(
    video: PartVideo, subject: CaptureSubject, each_round: Callable[[int], None] = lambda number: None
) -> Aligned:
    """Poses of a posed video moved onto its masks (see the top of this file)."""
    assert video.axis_angle is not None and video.root is not None
    moving = moving_joints(subject, video)
    scene = _Scene(video, subject, moving, _near_faces(subject, PARTS.index(video.part)))
    given = matrix_from_axis_angle(video.axis_angle)
    R, root = given.copy(), video.root.copy()
    frames, params = len(root), 3 * len(moving) + 3
    sigma = np.r_[np.full(3, ROOT), np.full(params - 3, np.radians(PRIOR))]
    scale = scene.scale
    outlines = [pixel_contour(mask) for mask in video.masks]
    edge, beyond = np.zeros(frames), np.zeros(len(subject.vertices))
    cells = ShapeCells(subject, CELL * metres_of_a_pixel(video) * scale)
    cuts = scale * np.geomspace(40.0, 3.0, ROUNDS)
    for number, cut in enumerate(cuts):
        first, colored = number == 0, number >= ROUNDS - COLORED
        equations = NormalEquations(frames, params)
        away: list[Array] = []
        corners: list[Array] = []
        seen: list[_SeenVertices] = []
        # a drawing at a time: on its canvas one of 1080 x 1080 has 170 MB
        for f in range(frames):
            view = _view(scene, f, R[f], root[f], slide=first)
            edge[f], r, corner = _add_outline(equations, scene, f, view, outlines[f], cut, beyond)
            away.append(r)
            corners.append(corner)
            if colored:
                seen.append(_seen(scene, view, f))
        if cut < 15 * scale:
            beyond = cells.shared(np.concatenate(corners), np.concatenate(away), PSEUDOCOUNT)
        if colored:
            _add_colors(equations, scene, seen)
        _add_smoothness(equations, R[:, moving])
        delta = axis_angle_from_matrix(np.swapaxes(given, -1, -2) @ R)[:, moving].reshape(frames, -1)
        equations.hold(np.arange(params), np.c_[root - video.root, delta], 1 / sigma**2)
        step, _ = equations.solve()
        R[:, moving] = turned(R[:, moving], step[:, 3:].reshape(frames, -1, 3))
        root = root + step[:, :3]
        each_round(number)
    return Aligned(axis_angle_from_matrix(R), root, edge / scale)


def _near_faces(subject: CaptureSubject, part: int) -> Bool[Array, "faces"]:
    """Faces whose outline places the part: its own and those of the bone it hangs from; of the body all."""
    if part == 0:
        return np.ones(len(subject.faces), bool)
    own = subject.part == part
    heaviest = np.bincount(subject.skin.joints[own, 0], minlength=52).argmax()
    # the part's own joint nearest to the pelvis: the wrist of a hand
    top = heaviest
    while own[subject.skin.joints[:, 0] == PARENTS[top]].mean() > 0.5:
        top = PARENTS[top]
    own |= ((subject.skin.joints == PARENTS[top]) & (subject.skin.weights > 0.5)).any(1)
    return own[subject.faces].all(1)


def _view(scene: _Scene, f: int, R: Array, root: Array, *, slide: bool) -> _DrawnTemplate:
    """The template in frame f. With `slide` its outline is first slid and turned as a whole onto the mask."""
    video, subject = scene.video, scene.subject
    camera = video.cameras[f]
    frame = posed_canonical(axis_angle_from_matrix(R), subject.joints, root)
    posed = skin_points(subject.vertices, subject.skin, frame.transforms)
    size = np.array(camera.size)
    if slide:
        # the picture in the middle of a canvas three times as large
        width, height = camera.size
        camera = camera.cropped(-width, -height, (3 * width, 3 * height))
    drawn = rasterise(posed, subject.faces, camera)
    outline, shown = pixel_contour(drawn.face >= 0), (drawn.face >= 0) & scene.near[drawn.face]
    x, y = outline.at.astype(int).T
    face, slid = drawn.face[y, x], np.zeros_like(outline.at)
    if slide and shown.any():
        centre = project(camera, posed[subject.part == scene.part] if scene.part else posed)[0].mean(0)
        turn, shift = placement(shown, video.masks[f], centre, 0.5 * size[0])
        turn = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        moved = (outline.at - centre) @ turn + centre + shift
        slid = moved - outline.at
        outline = Contour(moved - size, outline.normals @ turn)
    return _DrawnTemplate(frame, posed, drawn, outline, face, slid)


def _add_outline(
    equations: NormalEquations, scene: _Scene, f: int, view: _DrawnTemplate, mask: Contour, cut: float,
    beyond: Float[Array, "vertices"],
) -> tuple[float, Float[Array, "n"], Int[Array, "n"]]:  # fmt: skip
    """Add the outline term of one frame, the person `beyond` (metres) the template's vertices; outlines more than
    `cut` pixels apart weigh little.

    Returns the mean distance of the outlines near the part, how far outside (metres) the mask's pixels are, and the
    vertices that they belong to.
    """
    template, camera, subject = view.outline, scene.video.cameras[f], scene.subject
    if len(template.at) == 0 or len(mask.at) == 0:
        return np.inf, np.zeros(0), np.zeros(0, int)
    there, d_there = mask.nearest(*template, cut)
    back, d_back = template.nearest(*mask, cut)
    inside = ((template.at > 0) & (template.at < camera.size)).all(1)
    # what the image does not show agrees with nothing
    d_there = np.where(inside, d_there, np.inf)
    p = np.r_[np.arange(len(template.at)), back]
    q = np.r_[there, np.arange(len(mask.at))]
    length = np.r_[d_there, d_back]
    face, n = view.face[p], mask.normals[q]
    r = ((mask.at[q] - template.at[p] + view.slid[p]) * n).sum(1)
    weight = robust_weight(length**2, cut) / (OUTLINE * scene.scale) ** 2
    if view.slid.any():
        weight = weight * scene.near[face]
    # stands for the pixel: its derivative varies slowly over a face
    corner = subject.faces[face, 0]
    moves = pixel_rows(camera, view.posed[corner])[1]
    pixels = np.linalg.norm(moves[:, 0], axis=1)  # pixels per metre
    away, r = r / pixels, r - beyond[corner] * pixels
    g = np.einsum("ni,nij->nj", n, moves)
    rows = increment_rows(view.frame, subject.vertices[corner], subject.skin.of(corner), g, scene.moving)
    equations.add(f, rows, r, weight)
    close = scene.near[face] & np.isfinite(length)
    if not close.any():
        return np.inf, np.zeros(0), np.zeros(0, int)
    near_by = close & (length < cut)
    return float(length[close].mean()), away[near_by], corner[near_by]


def outline_offset(video: PartVideo, subject: CaptureSubject) -> float:
    """How far outside the posed template's outline the masks' is, mean over eight frames, pixels of 256 a height.

    Only outlines within 5 pixels of each other are compared, where the template shows the part.
    """
    assert video.axis_angle is not None and video.root is not None
    scene = _Scene(video, subject, np.zeros(0, int), _near_faces(subject, PARTS.index(video.part)))
    scale, found = scene.scale, []
    for f in even(len(video.masks), 8):
        view = _view(scene, f, matrix_from_axis_angle(video.axis_angle[f]), video.root[f], slide=False)
        template, mask = view.outline, pixel_contour(video.masks[f])
        if len(template.at) == 0 or len(mask.at) == 0:
            continue
        index, length = mask.nearest(*template, 5.0 * scale)
        away = ((mask.at[index] - template.at) * mask.normals[index]).sum(1)
        found.append(away[scene.near[view.face] & (length < 5 * scale)])
    found = np.concatenate(found) if found else np.zeros(0)
    return float(found.mean()) / scale if len(found) else 0.0


def _seen(scene: _Scene, view: _DrawnTemplate, f: int) -> _SeenVertices:
    """What frame f shows well."""
    video, subject, part = scene.video, scene.subject, scene.part
    camera = video.cameras[f]
    pixels, depth = project(camera, view.posed)
    inside = (pixels > 1).all(1) & (pixels < np.array(camera.size) - 1).all(1) & (depth > 0)
    if part:
        inside &= subject.part == part
    d = view.posed - camera.eye
    facing = -(d * vertex_normals(view.posed, subject.faces)).sum(1) / np.linalg.norm(d, axis=1)
    at = np.flatnonzero(inside & (facing > 0.35))
    x, y = np.floor(pixels[at]).astype(int).T
    open_ = depth[at] < view.drawn.depth[y, x] + 0.01
    deep = np.asarray(ndimage.binary_erosion(video.masks[f], iterations=2), bool)
    at = at[open_ & deep[y, x]]
    return _SeenVertices(view.frame, at, view.posed[at], pixels[at])


def _add_colors(equations: NormalEquations, scene: _Scene, seen: list[_SeenVertices]) -> None:
    """Add the color term of all frames: each vertex against its mean over the frames that see it, at least 4."""

    def blurred(f: int) -> Float[Array, "height width 3"]:
        return np.asarray(ndimage.gaussian_filter(video.images[f].astype(np.float32) / 255, (1.0, 1.0, 0)))

    video, subject = scene.video, scene.subject
    total, number = np.zeros((len(subject.vertices), 3)), np.zeros(len(subject.vertices))
    for f, vertices in enumerate(seen):
        total[vertices.at] += bilinear(blurred(f), vertices.pixels)
        number[vertices.at] += 1
    mean = total / np.maximum(number, 1)[:, None]
    for f, (frame, at, places, pixels) in enumerate(seen):
        keep = number[at] >= 4
        at, places, pixels = at[keep], places[keep], pixels[keep]
        if len(at) == 0:
            continue
        image = blurred(f)
        r = mean[at] - bilinear(image, pixels)
        r = r - np.median(r, 0)  # exposure
        weight = robust_weight((r**2).sum(1), COLOR) / COLOR**2 * _share_of_pixel(pixels)
        moves = pixel_rows(video.cameras[f], places)[1]
        dy, dx = (bilinear(slope, pixels) for slope in np.gradient(image, axis=(0, 1)))
        for c in range(3):
            g = np.einsum("ni,nij->nj", np.stack([dx[:, c], dy[:, c]], 1), moves)
            rows = increment_rows(frame, subject.vertices[at], subject.skin.of(at), g, scene.moving)
            equations.add(f, rows, r[:, c], weight)


def _share_of_pixel(pixels: Float[Array, "n 2"]) -> Float[Array, "n"]:
    """One over the number of points that share a pixel: a head's many vertices know no more than its pixels do."""
    _, of, count = np.unique(np.floor(pixels).astype(int), axis=0, return_inverse=True, return_counts=True)
    return 1 / count[of.ravel()]


def _add_smoothness(equations: NormalEquations, R: Float[Array, "frames m 3 3"]) -> None:
    """Add the second differences of the moving joints' rotations; jumps count less."""
    a, rows = second_turns(R)
    weight = robust_weight((a**2).sum(2), np.radians(12.0)) / np.radians(SMOOTH) ** 2
    equations.add_second_difference(3 + np.arange(3 * R.shape[1]).reshape(-1, 3), a, rows, weight)
