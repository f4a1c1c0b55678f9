"""A sheet of one fit: the fitted body's outline, its bones and the detector's points over frames of the video."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image, ImageDraw
from scipy import ndimage

from avatar.camera import project
from avatar.kinematics import skinned
from avatar.skeleton import PARENTS
from bench.report.sheet import save_sheet, sheet
from capture.fit.body import MOVING
from capture.fit.footage import Estimate, Footage
from capture.fit.solve import posed_frames
from experiments.fitting_scores import Truth
from geometry.rasterise import rasterise
from synth.light import light_of
from synth.photo import Studio

# frames of a sheet
SHOWN = 4
OUTLINE, BONES, POINTS = (255, 120, 0), (0, 200, 255), (255, 255, 0)
# pixels, of the outline and across a point
WIDE, ACROSS = 2, 4


def shown_frames(footage: Footage) -> list[int]:
    """The frames of a sheet, evenly spread."""
    count = len(footage.pixels)
    return np.linspace(0, count - 1, min(SHOWN, count) + 1)[:-1].astype(int).tolist()


def overlay(picture: UInt8[np.ndarray, "height width 3"], estimate: Estimate, footage: Footage, frame: int
            ) -> UInt8[np.ndarray, "height width 3"]:  # fmt: skip
    """The picture of a frame with the estimate drawn over it."""
    posed, points, camera = posed_frames(estimate).each[frame], estimate.skin(), estimate.camera(footage)
    body = rasterise(skinned(posed, points), estimate.person.body.faces, camera)
    inside: Bool[np.ndarray, "height width"] = body.face >= 0
    drawn = picture.copy()
    drawn[np.asarray(ndimage.binary_dilation(inside, iterations=WIDE), bool) & ~inside] = OUTLINE
    page = Image.fromarray(drawn)
    pen = ImageDraw.Draw(page)
    joints = project(camera, posed.place)[0]
    for joint in MOVING:
        pen.line([tuple(joints[PARENTS[joint]]), tuple(joints[joint])], BONES, WIDE)
    for (x, y), sure in zip(footage.pixels[frame], footage.sure[frame]):
        if sure > 0:
            pen.ellipse((x - ACROSS / 2, y - ACROSS / 2, x + ACROSS / 2, y + ACROSS / 2), POINTS)
    return np.asarray(page)


def write_pictures(
    path: Path, studio: Studio, truth: Truth, footage: Footage, stages: dict[str, Estimate], heading: str
) -> None:
    """One row a stage, one column a frame, each cut to the height of the picture round the person."""
    frames, shots, light = shown_frames(footage), truth.shots, light_of("even", "body", 0)
    pictures = []
    for frame in frames:
        at = truth.frames[frame]
        photo = studio.take(studio.posed(shots.axis_angle[at], shots.root[at]), shots.camera, light)
        pictures.append(photo.image)
    height, width = pictures[0].shape[:2]
    left = max(0, (width - height) // 2)
    square = (slice(None), slice(left, left + height))
    rows = [[overlay(picture, estimate, footage, frame)[square] for picture, frame in zip(pictures, frames)]
            for estimate in stages.values()]  # fmt: skip
    titles = [[f"{stage}, frame {frame}" for frame in frames] for stage in stages]
    save_sheet(path, sheet(rows, titles, heading, columns=1))
