"""The head's place on the body, read off the body's video: Eq. 5 refined by pixels.

Eq. 5 compares the head's surface with that of the body's field, whose face is a few pixels wide and whose hair is
shapeless. The body's video knows more: in each of its frames the head field's outline and colors have to fall on
the pixels. With S a similarity of the head, D(u; S) its drawing in a frame (coverage and color) and O the frame,

    min over S of  sum over frames and pixels  rho(O(u) - D(u; S))  +  sum |S a_i - b_i|^2 / spread^2

(rho: Geman and McClure 1985; a_i, b_i the landmarks of Eq. 6) is solved by Gauss-Newton as image alignment (Lucas and
Kanade 1981): moving what is drawn by m pixels changes it by -gradient . m.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage

from avatar.camera import Camera, project
from avatar.kinematics import pixel_rows
from avatar.skeleton import JOINTS, skin_transforms
from avatar.skinning import skin_points
from capture.fit.pixels import compare_pixels
from capture.folder import CaptureSubject, PartVideo
from capture.register.placement import PlaceEquations, refine
from capture.videos import even
from geometry.cells import nearest_marked
from geometry.icp import Anchors
from geometry.rasterise import rasterise

HEAD = JOINTS.index("head")
FRAMES = 20  # at most, spread over the video
ROUNDS = 8
# metres: farther than this the start was wrong
MOST = 0.03
# drawn so many times finer than the frame, then averaged
FINER = 2
# pixels around the drawn head that count: farther is background or someone else
RIM = 4
# pixels a side of the head's crop; larger ones are averaged down
LARGEST = 160
# standard deviation of a pixel's residual: neighbours err together, so more than the noise
PIXEL = 0.3
# residuals beyond it lose their weight: a hand before the face, light that differs
OUTLIER = 0.2


class ColoredHead(NamedTuple):
    """What the head's field shows at the template's head."""

    vertices: Int[Array, "n"]  # the template's
    # where the field shows them, in the frame that the similarity moves
    points: Float[Array, "n 3"]
    colors: Float[Array, "n 3"]  # sRGB, [0, 1]


class VideoFit(NamedTuple):
    transform: Float[Array, "4 4"]  # canonical_from_head_field, a similarity
    # root of the mean rho over coverage and color (0 to 1), at the start
    before: float
    after: float


def refine_on_video(
    subject: CaptureSubject, head: ColoredHead, video: PartVideo, start: Float[Array, "4 4"], anchors: Anchors,
) -> VideoFit:  # fmt: skip
    """The similarity `start` of the head, refined until what it draws lies on the pixels of the body's video.

    Raises:
        ValueError: the head is in no frame, or the answer does not lie nearer to the pixels, or moves the head by
            more than MOST metres: the start, the poses or the masks are wrong.
    """
    shown = np.zeros(len(subject.vertices), bool)
    shown[head.vertices] = True
    colors = np.zeros((len(subject.vertices), 3))
    colors[head.vertices] = head.colors
    scene = _PaintedTemplate(subject, np.asarray(shown[subject.faces].all(1), bool), colors[subject.faces].mean(1))
    chosen = even(len(video.images), FRAMES)

    def equations_at(transform: Float[Array, "4 4"]) -> PlaceEquations:
        """What the pixels of all frames and the landmarks say at a place."""
        placed = subject.vertices.copy()
        placed[head.vertices] = head.points @ transform[:3, :3].T + transform[:3, 3]
        equations = PlaceEquations(transform, placed[head.vertices].mean(0))
        equations.add_landmarks(anchors)
        for frame in chosen:
            _add_frame(equations, scene, placed, video, frame)
        if equations.count == 0:
            raise ValueError("the body's video shows no head")
        return equations

    tried, _ = refine(start, equations_at, ROUNDS + 1)
    before, after, answer = tried[0].residual, tried[-1].residual, tried[-1].transform
    # the anchors and a changing set of pixels may cost a little
    if not after <= 1.05 * before:
        raise ValueError(f"the pixels of the body's video fit worse than before ({before:.4f} -> {after:.4f})")
    moved = (head.points @ (answer - start)[:3, :3].T + (answer - start)[:3, 3]).astype(float)
    shift = float(np.linalg.norm(moved, axis=1).max())
    if shift > MOST:
        raise ValueError(f"the body's video would move the head by {shift:.3f} m, more than {MOST}")
    return VideoFit(answer, before, after)


class _PaintedTemplate(NamedTuple):
    subject: CaptureSubject
    head: Bool[Array, "faces"]  # faces of the head that the field shows
    color: Float[Array, "faces 3"]


def _add_frame(
    equations: PlaceEquations, scene: _PaintedTemplate, placed: Float[Array, "vertices 3"], video: PartVideo, frame: int
) -> None:
    assert video.axis_angle is not None and video.root is not None
    subject = scene.subject
    B = skin_transforms(video.axis_angle[frame], subject.joints, video.root[frame])
    posed = skin_points(placed, subject.skin, B)
    cropped = _crop(video, frame, posed[np.unique(subject.faces[scene.head])])
    if cropped is None:
        return
    camera, image, mask = cropped
    width, height = camera.size
    drawn = rasterise(posed, subject.faces, camera.resized((FINER * width, FINER * height)))
    hit = drawn.face >= 0
    is_head = hit & scene.head[drawn.face]
    colors = np.where(is_head[..., None], scene.color[drawn.face], 0)
    coverage, own, colors = (_averaged(a, FINER) for a in (hit[..., None], is_head[..., None], colors))
    near = np.asarray(ndimage.binary_dilation(own[..., 0] > 0, iterations=RIM), bool)
    if not is_head.any():
        return
    y, x = np.nonzero(near)
    rows, columns = nearest_marked(hit)
    finer = y * FINER + FINER // 2, x * FINER + FINER // 2
    face = drawn.face[rows[finer], columns[finer]]
    keep = scene.head[face]
    y, x, face = y[keep], x[keep], face[keep]
    corners = subject.faces[face]
    turn = B[HEAD, :3, :3]  # the head follows its bone (Eq. 4)
    motion = pixel_rows(camera, posed[corners].mean(1))[1] @ turn @ equations.rows(placed[corners].mean(1))

    def add(drawn: Float[Array, "height width"], seen: Float[Array, "height width"], where: Bool[Array, "n"]) -> None:
        found = compare_pixels(drawn, seen, (y[where], x[where]), OUTLIER)
        J = np.einsum("ni,nij->nj", found.slope, motion[where])
        equations.add(J, found.residual, found.weight / PIXEL**2)
        equations.cost += found.cost
        equations.count += len(found.weight)

    add(_blurred(coverage[..., 0], 1.0), _blurred(mask, 1.0), np.ones(len(y), bool))
    deep = np.asarray(ndimage.binary_erosion(own[..., 0] > 0.99, iterations=2), bool)
    deep &= np.asarray(ndimage.binary_erosion(mask > 0.99, iterations=2), bool)
    inside = deep[y, x]
    if inside.any():
        for channel in range(3):
            drawn_, seen = (_blurred(a[..., channel], 0.6) for a in (colors, image))
            light = np.median((seen - drawn_)[y[inside], x[inside]])  # exposure and light differ between the videos
            add(drawn_ + light, seen, inside)


def _crop(
    video: PartVideo, frame: int, head: Float[Array, "n 3"]
) -> tuple[Camera, Float[Array, "height width 3"], Float[Array, "height width"]] | None:
    """The frame around the head, at most LARGEST pixels a side, with its camera; None where it is out of view."""
    camera = video.cameras[frame]
    pixels, depth = project(camera, head)
    if not (depth > 0.05).all():
        return None
    low = np.floor(pixels.min(0)) - 3 * RIM
    high = np.ceil(pixels.max(0)) + 3 * RIM
    by = max(1, int(np.ceil((high - low).max() / LARGEST)))
    low = np.maximum(np.floor(pixels.min(0)) - 3 * RIM * by, 0).astype(int)
    high = np.minimum(np.ceil(pixels.max(0)) + 3 * RIM * by, camera.size).astype(int)
    (left, top), (width, height) = low.tolist(), ((high - low) // by).tolist()
    if min(width, height) < 8:
        return None
    window = np.s_[top : top + by * height, left : left + by * width]
    image = _averaged(video.images[frame][window].astype(np.float64) / 255, by)
    mask = _averaged(video.masks[frame][window][..., None].astype(np.float64), by)[..., 0]
    return camera.cropped(left, top, (by * width, by * height)).resized((width, height)), image, mask


def _averaged(image: Array, by: int) -> Float[Array, "height width c"]:
    """Means of squares of by x by pixels."""
    height, width, channels = image.shape
    return image.reshape(height // by, by, width // by, by, channels).mean((1, 3))


def _blurred(image: Float[Array, "height width"], sigma: float) -> Float[Array, "height width"]:
    return np.asarray(ndimage.gaussian_filter(image, sigma), np.float64)
