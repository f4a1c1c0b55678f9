"""Held-out pictures scored by region: PSNR over the posed box and over the mask, SSIM and FLIP on its rectangle.

Box: pixels whose rays meet the axis-aligned box of the posed true region, 2 cm wider, ground black. The total is
scored on the body view; head and hands on their close-ups, both pictures blacked out beyond the true part mask
dilated by 5 px; the eyes on the head's close-ups, over the truth's visible eyeballs grown by 3 mm (`eye_region`),
box and mask being that region itself.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.ndimage import binary_dilation

from avatar.camera import Camera, pixel_rays, project
from avatar.skeleton import PARTS
from bench.field.posed_field import MaskedPicture
from bench.score.metrics import ComparedPicture, ImageScores, Perceive, rectangle
from bench.score.true_mesh import TrueMesh
from capture.held_out import HeldOutView
from capture.template.eyes import GROWN
from command.progress import progress
from geometry.cells import distance_to
from player.draw.raster import Rasteriser

# pose, root, camera, squared samples a pixel, pixels that are looked at (others may be left black)
Draw = Callable[[Float[Array, "52 3"], Float[Array, "3"], Camera, int, Bool[Array, "height width"]], MaskedPicture]

# the view that each region is scored on
REGIONS = {"total": "body", "head": "head", "left_hand": "hand_left", "right_hand": "hand_right"}
VIEW_REGION = {view: region for region, view in REGIONS.items()}
REGION_PART = {region: PARTS.index(view) for region, view in REGIONS.items() if region != "total"}
BOX_MARGIN = 0.02  # metres round the posed true region
# squared rays a pixel of ours, as of the true pictures (synth/command.py)
SAMPLES = 2
DILATION = 5  # pixels of the true part mask
# a frame whose joints all turn less is a T-pose frame
T_POSE = np.radians(5.0)

NO_EYES = "the capture's truth/rest.npz does not say which surface is eye; `selfscan synth` of today writes it"


def box_pixels(camera: Camera, low: Float[Array, "3"], high: Float[Array, "3"]) -> Bool[Array, "height width"]:
    """Pixels whose rays meet an axis-aligned box (slab test, Kay and Kajiya 1986)."""
    origins, directions = pixel_rays(camera)
    safe = np.where(np.abs(directions) > 1e-12, directions, 1e-12)
    near, far = (low - origins) / safe, (high - origins) / safe
    enter, leave = np.minimum(near, far).max(1), np.maximum(near, far).min(1)
    width, height = camera.size
    return (leave >= np.maximum(enter, 0)).reshape(height, width)


def region_of(view: HeldOutView, region: str) -> tuple[Bool[Array, "height width"], Bool[Array, "height width"]]:
    """A region's true pixels, and the pixels looked at; both pictures are black elsewhere."""
    if region == "total":
        mask = view.mask()
        return mask, np.ones_like(mask)
    mask = view.parts() == REGION_PART[region] + 1
    return mask, binary_dilation(mask, np.ones((3, 3), bool), iterations=DILATION)


def eye_region(
    raster: Rasteriser, truth: TrueMesh, posed: Float[Array, "vertices 3"], camera: Camera
) -> Bool[Array, "height width"]:
    """Pixels within GROWN of those that show an eyeball of the posed truth; none where no eye is seen."""
    width, height = camera.size
    if truth.eye is None:
        return np.zeros((height, width), bool)
    drawn = raster.draw(posed, truth.faces, camera).face
    shown = (drawn >= 0) & truth.eye[truth.faces[drawn]].all(-1)
    if not shown.any():
        return shown
    _, depth = project(camera, posed[truth.faces[np.unique(drawn[shown])].ravel()])
    return distance_to(shown) <= GROWN * camera.K[0, 0] / float(np.median(depth))


class PictureJudge(NamedTuple):
    """How pictures are drawn, and beside what they are scored."""

    mesh: TrueMesh
    draw: Draw
    # LPIPS, where its weights are at hand
    perceive: Perceive | None = None
    # draws the truth's eyes; None: the eye region is not scored
    raster: Rasteriser | None = None


def score_images(
    judge: PictureJudge, views: Sequence[HeldOutView], label: str, ours: Sequence[HeldOutView] | None = None
) -> dict[str, ImageScores]:
    """Draw every picture of a set and score it, by region.

    `ours`: the same views in the poses that are drawn, where the skeleton is another than the truth's.
    With a raster and a truth that knows its eyes, the eye region of the head's close-ups is scored as well.
    """
    mesh, draw, perceive, raster = judge
    with_eyes = raster is not None and mesh.eye is not None
    scores = {region: ImageScores() for region in (*REGIONS, *["eyes"] * with_eyes)}
    vertices_of = {region: np.flatnonzero(mesh.part == part) for region, part in REGION_PART.items()}
    vertices_of["total"] = np.unique(mesh.faces)
    posed: tuple[int, Array] = (-1, np.zeros((0, 3)))
    for view, own in progress(zip(views, ours or views, strict=True), label, len(views)):
        if posed[0] != view.pose_index:
            posed = view.pose_index, mesh.posed(view.axis_angle, view.root)
        region = VIEW_REGION[view.view]
        points = posed[1][vertices_of[region]]
        box = box_pixels(view.camera, points.min(0) - BOX_MARGIN, points.max(0) + BOX_MARGIN)
        mask, around = region_of(view, region)
        looked_at = np.zeros_like(around)
        # the whole outline of the person counts, the box's rectangle of a part
        where = np.s_[:, :] if region == "total" else rectangle(box) or np.s_[:0, :0]
        looked_at[where] = around[where]
        drawn = draw(own.axis_angle, own.root, view.camera, SAMPLES, looked_at)
        image = drawn.color * around[..., None]
        truth = view.image() * around[..., None]
        compared = {region: (box, mask)}
        if region == "head" and raster is not None and with_eyes:
            eyes = eye_region(raster, mesh, posed[1], view.camera) & around
            compared["eyes"] = eyes, eyes
        for name, (box, mask) in compared.items():
            where = rectangle(box)
            # what lies outside the picture counts as no picture
            if where is not None:
                shown = drawn.mask if name == "total" else None
                scores[name].add(ComparedPicture(truth, image, where, box, mask, perceive, shown))
    return scores


def is_t_pose(view: HeldOutView) -> bool:
    return bool(np.linalg.norm(view.axis_angle[1:], axis=-1).max() < T_POSE)
