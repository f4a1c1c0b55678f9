"""Held-out pictures scored by region: PSNR over the posed box and over the mask, SSIM and FLIP on its rectangle.

Box: pixels whose rays meet the axis-aligned box of the posed true region, 2 cm wider, ground black. The total is
scored on the body view; head and hands on their close-ups, both pictures blacked out beyond the true part mask
dilated by 5 px; the eyes on the head's close-ups, over the truth's visible eyeballs grown by 3 mm (eye_region.py),
box and mask being that region itself. Frames in the T-pose are kept apart.
"""

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation

from avatar.camera import Camera, pixel_rays
from avatar.progress import progress
from avatar.skeleton import PARTS
from bench import metrics
from bench.eye_region import eye_region
from bench.posed_field import MaskedPicture
from bench.true_mesh import TrueMesh
from capture.held_out import HeldOutView
from player.raster import Rasteriser

Perceive = Callable[[Float[np.ndarray, "height width 3"], Float[np.ndarray, "_ _ 3"]], metrics.Score]  # LPIPS

# pose, root, camera, squared samples a pixel, pixels that are looked at (others may be left black)
Draw = Callable[
    [Float[np.ndarray, "52 3"], Float[np.ndarray, "3"], Camera, int, Bool[np.ndarray, "height width"]], MaskedPicture
]

REGIONS = ("head", "left_hand", "right_hand", "total")
VIEW_REGION = {"body": "total", "head": "head", "hand_left": "left_hand", "hand_right": "right_hand"}
REGION_PART = {
    "head": PARTS.index("head"),
    "left_hand": PARTS.index("hand_left"),
    "right_hand": PARTS.index("hand_right"),
}
BOX_MARGIN = 0.02  # metres round the posed true region
# squared rays a pixel of ours; the truth is smoothed as well, by 3 x 3
SAMPLES = 2
DILATION = 5  # pixels of the true part mask
# a frame whose joints all turn less is a T-pose frame
T_POSE = np.radians(5.0)


@dataclass
class ImageScores:
    """Scores of one region gathered over pictures."""

    box: metrics.PooledError = field(default_factory=metrics.PooledError)
    mask: metrics.PooledError = field(default_factory=metrics.PooledError)
    ssim: list[metrics.Score] = field(default_factory=list)
    flip: list[metrics.Score] = field(default_factory=list)
    lpips: list[metrics.Score] = field(default_factory=list)

    def merged(self, other: "ImageScores") -> "ImageScores":
        return ImageScores(
            self.box.merged(other.box),
            self.mask.merged(other.mask),
            self.ssim + other.ssim,
            self.flip + other.flip,
            self.lpips + other.lpips,
        )

    def add(
        self,
        truth: Float[np.ndarray, "height width 3"],
        image: Float[np.ndarray, "height width 3"],
        box: Bool[np.ndarray, "height width"],
        mask: Bool[np.ndarray, "height width"],
        perceive: Perceive | None = None,
    ) -> None:
        where = metrics.rectangle(box)
        if where is None:
            # the region is outside this picture
            return
        self.box.add(truth, image, box)
        self.mask.add(truth, image, mask)
        self.ssim.append(metrics.ssim(truth[where], image[where]))
        self.flip.append(metrics.flip(truth[where], image[where]))
        self.lpips.append((perceive or metrics.lpips)(truth[where], image[where]))

    def scores(self) -> dict[str, metrics.Score]:
        return {
            "psnr_db": self.box.psnr(),
            "psnr_mask_db": self.mask.psnr(),
            "ssim": metrics.mean_score(self.ssim),
            "flip": metrics.mean_score(self.flip),
            "lpips": metrics.mean_score(self.lpips),
        }


def box_pixels(
    camera: Camera, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]
) -> Bool[np.ndarray, "height width"]:
    """Pixels whose rays meet an axis-aligned box (slab test, Kay and Kajiya 1986)."""
    origins, directions = pixel_rays(camera)
    safe = np.where(np.abs(directions) > 1e-12, directions, 1e-12)
    near, far = (low - origins) / safe, (high - origins) / safe
    enter, leave = np.minimum(near, far).max(1), np.maximum(near, far).min(1)
    width, height = camera.size
    return (leave >= np.maximum(enter, 0)).reshape(height, width)


class Region(NamedTuple):
    """Where one region of one picture is compared."""

    mask: Bool[np.ndarray, "height width"]  # its true pixels
    # the pixels looked at; both pictures are black elsewhere
    around: Bool[np.ndarray, "height width"]


def region_of(view: HeldOutView, region: str) -> Region:
    if region == "total":
        mask = view.mask()
        return Region(mask, np.ones_like(mask))
    mask = view.parts() == REGION_PART[region] + 1
    return Region(mask, binary_dilation(mask, np.ones((3, 3), bool), iterations=DILATION))


class SetScores(NamedTuple):
    """Scores of one set of pictures by region; T-pose frames apart where that was asked for."""

    scored: dict[str, ImageScores]
    t_pose: dict[str, ImageScores]
    # those of `scored` that are of the few poses
    few: dict[str, ImageScores]


def score_images(
    views: list[HeldOutView],
    mesh: TrueMesh,
    draw: Draw,
    label: str,
    *,
    t_pose_apart: bool,
    perceive: Perceive | None = None,
    few: Set[int] = frozenset(),
    raster: Rasteriser | None = None,
    ours: Sequence[HeldOutView] | None = None,
) -> SetScores:
    """Draw and score every picture of a set; those of the `few` pose indices are also gathered by themselves.

    `ours`: the same views in the poses that are drawn, where the skeleton is another than the truth's.
    With a `raster` and a truth that knows its eyes, the eye region of the head's close-ups is scored as well.
    """
    regions = REGIONS if raster is None or mesh.eye is None else (*REGIONS, "eyes")
    scores = SetScores({region: ImageScores() for region in regions}, {}, {region: ImageScores() for region in regions})
    vertices_of = {region: np.flatnonzero(mesh.part == part) for region, part in REGION_PART.items()}
    vertices_of["total"] = np.unique(mesh.faces)
    posed: tuple[int, np.ndarray] = (-1, np.zeros((0, 3)))
    for view, own in progress(zip(views, ours or views, strict=True), label, len(views)):
        if posed[0] != view.pose_index:
            posed = view.pose_index, mesh.posed(view.axis_angle, view.root)
        region = VIEW_REGION[view.view]
        points = posed[1][vertices_of[region]]
        box = box_pixels(view.camera, points.min(0) - BOX_MARGIN, points.max(0) + BOX_MARGIN)
        mask, around = region_of(view, region)
        looked_at = np.zeros_like(around)
        where = metrics.rectangle(box)
        if where is not None:
            looked_at[where] = around[where]
        image = draw(own.axis_angle, own.root, view.camera, SAMPLES, looked_at).color * around[..., None]
        truth = view.image() * around[..., None]
        ones = {region: ImageScores()}
        ones[region].add(truth, image, box, mask, perceive)
        if region == "head" and raster is not None and "eyes" in regions:
            eyes = eye_region(raster, mesh, posed[1], view.camera) & around
            ones["eyes"] = ImageScores()
            ones["eyes"].add(truth, image, eyes, eyes, perceive)
        into = scores.t_pose if t_pose_apart and is_t_pose(view) else scores.scored
        for region, one in ones.items():
            into[region] = into.get(region, ImageScores()).merged(one)
            if into is scores.scored and view.pose_index in few:
                scores.few[region] = scores.few[region].merged(one)
    return scores


def is_t_pose(view: HeldOutView) -> bool:
    return bool(np.linalg.norm(view.axis_angle[1:], axis=-1).max() < T_POSE)
