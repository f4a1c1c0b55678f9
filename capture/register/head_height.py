"""How high the head lies, by the outline of its bare skin in its own video.

A head that turns about the vertical looks as consistent a millimetre higher (head_consistency.py), and a dozen
landmarks say its height to half a millimetre or worse. Chin, jaw, ears and a bald crown say it: with phi_f(u) the
signed distance of pixel u to the edge of frame f's mask (inside positive), v a vertex of bare skin on the template's
drawn outline and t a shift along the template's height,

    min over t, c of  1/s^2 mean rho(phi_f(project_f(v + t e_y)) - c)  +  k t^2 / spread^2

(rho: Geman and McClure 1985; s the residuals' own spread) is solved by Gauss-Newton. The constant c, pixels, is what
the template is too thick or thin all round, or the mask; the last term are the k landmarks of Eq. 6, which have put
the head where it is. Outlines err in patches: all together they count as INDEPENDENT rows.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage

from avatar.camera import Camera, project
from avatar.kinematics import pixel_rows
from avatar.skeleton import PARTS
from capture.folder import CaptureSubject, PartVideo
from capture.template.hull import head_cameras
from capture.template.surface import neck_height
from capture.videos import even
from geometry.cells import rim_of
from geometry.icp import INDEPENDENT, Anchors
from geometry.least_squares import robust_weight
from geometry.mesh import vertex_normals
from geometry.rasterise import rasterise

FRAMES = 20  # at most, spread over the video
ROUNDS = 6
# metres above the lowest skin of the head: below, the body's outline goes on
NECK = 0.01
# rows in all: fewer say nothing
FEWEST = 100
# metres: farther than this the landmarks were not those of this head
MOST = 0.01
# pixels: the mask's edge is blurred by so much, or its steps would be the slope
BLUR = 0.7


class HeadHeight(NamedTuple):
    canonical_from_head: Float[Array, "4 4"]
    shift: float  # metres that the template's place rose on the pictured head; what was placed sinks by it
    thickness: float  # pixels, c
    spread: float  # pixels, s
    rows: int


def height_by_outline(
    subject: CaptureSubject, video: PartVideo, canonical_from_head: Float[Array, "4 4"], anchors: Anchors
) -> HeadHeight:
    """The head's place moved along the template's height until its bare skin meets the outlines of its video.

    Raises:
        ValueError: hardly any bare skin is on an outline, or the answer lies farther than MOST away.
    """
    used = even(len(video.images), FRAMES)
    cameras = [head_cameras(video, canonical_from_head)[i] for i in used]
    edges = [edge_distance(video.masks[i]) for i in used]
    bare = (subject.part == PARTS.index("head")) & ~subject.hair
    bare &= subject.vertices[:, 1] > neck_height(subject) + NECK
    normals = vertex_normals(subject.vertices, subject.faces)
    known = len(anchors.source) / anchors.spread**2
    shift = thickness = spread = 0.0
    count = 0
    for _ in range(ROUNDS):
        placed = subject.vertices + [0.0, shift, 0.0]
        rows = [_outline(placed, subject.faces, normals, bare, *of) for of in zip(cameras, edges)]
        distance, slope = (np.concatenate(values) for values in zip(*rows))
        count = len(distance)
        if count < FEWEST:
            raise ValueError(f"only {count} places of bare skin lie on the outlines of the head's video")
        r = distance - np.median(distance)
        spread = max(1.4826 * float(np.median(np.abs(r))), 0.05)
        weight = robust_weight(r**2, 2 * spread)
        weight *= INDEPENDENT / weight.sum() / spread**2
        # c eliminated: both about their weighted means
        slope = slope - (weight * slope).sum() / weight.sum()
        step = -((weight * slope * r).sum() + known * shift) / ((weight * slope**2).sum() + known)
        shift, thickness = shift + float(step), float(np.median(distance))
        if abs(step) < 1e-5:
            break
    if abs(shift) > MOST:
        raise ValueError(f"the outlines would move the head by {abs(shift):.3f} m, more than {MOST}")
    lowered = np.eye(4)
    lowered[1, 3] = -shift
    return HeadHeight(lowered @ canonical_from_head, shift, thickness, spread, count)


def edge_distance(mask: Bool[Array, "h w"]) -> Float[Array, "h w"]:
    """Pixels from every pixel's centre to the edge of a mask, inside positive, smooth across it."""
    inside, outside = (np.asarray(ndimage.distance_transform_edt(m), np.float64) for m in (mask, ~mask))
    away = inside - outside
    return ndimage.gaussian_filter(away - 0.5 * np.sign(away), BLUR)


def _outline(
    placed: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], normals: Float[Array, "vertices 3"],
    bare: Bool[Array, "vertices"], camera: Camera, edge: Float[Array, "h w"],
) -> tuple[Float[Array, "n"], Float[Array, "n"]]:  # fmt: skip
    """For vertices of bare skin that the template's drawing has on its outline, pixels from the edge of the frame's
    mask (inside positive), and how they change per metre of height."""
    width, height = camera.size
    drawn = rasterise(placed, faces, camera).face
    corners = faces[drawn[rim_of(drawn >= 0)]]
    # each triangle's corner whose normal lies most across the view
    view = placed[corners] - camera.eye
    across = np.abs((normals[corners] * view).sum(2)) / np.linalg.norm(view, axis=2)
    vertex = np.unique(corners[np.arange(len(corners)), across.argmin(1)])
    vertex = vertex[bare[vertex]]
    pixels = project(camera, placed[vertex])[0]
    inside = ((pixels > 2) & (pixels < np.array([width - 2, height - 2]))).all(1)
    vertex, pixels = vertex[inside], pixels[inside]
    at = (pixels - 0.5).T[::-1]
    read = lambda y, x: ndimage.map_coordinates(edge, at + np.array([[y], [x]]), order=1)
    gradient = np.stack([read(0, BLUR) - read(0, -BLUR), read(BLUR, 0) - read(-BLUR, 0)], 1) / (2 * BLUR)
    slope = (gradient * pixel_rows(camera, placed[vertex])[1][:, :, 1]).sum(1)
    return read(0, 0), slope
