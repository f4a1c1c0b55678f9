"""A figure before rooms of all kinds: its outline is the same whatever is behind."""

import numpy as np
import pytest
from filmed_figure import COLORS, SIZE, painted, wall

from capture.keypoints.record import Keypoints
from capture.raw.masks import soft_mask
from capture.raw.plate import Plate, plate_of_free
from geometry.cells import distance_to

TURNS = np.linspace(0, 0.9, 10)
SHAPE = (SIZE[1], SIZE[0], 3)
PATCHES = COLORS[np.random.default_rng(2).integers(0, len(COLORS), (SIZE[1] // 6, SIZE[0] // 6))]
# what is behind; bounds in pixels where the empty room was filmed, and where it was not: gaps of a pixel or two between
# the legs are taken for the figure, which is most of it
GROUNDS = {
    "a furnished wall": (wall(), 2.0, 2.0),
    "white": (np.full(SHAPE, 255.0), 2.0, 2.0),
    "grey": (np.full(SHAPE, 128.0), 2.0, 2.0),
    "black": (np.full(SHAPE, 0.0), 2.5, 2.0),
    "noise": (np.random.default_rng(1).uniform(0, 255, SHAPE), 2.0, 4.0),
    "patches of the figure's own colors": (PATCHES.repeat(6, 0).repeat(6, 1).astype(float), 2.5, 4.0),
}


def beside(found, true):
    """Mean distance of each outline's pixels from the other's, the larger one."""
    a, b = (mask & (distance_to(~mask) < 1.5) for mask in (found, true))
    return max(distance_to(a)[b].mean(), distance_to(b)[a].mean())


@pytest.mark.parametrize("empty", [True, False], ids=["empty room filmed", "none filmed"])
@pytest.mark.parametrize("ground", GROUNDS)
def test_a_figure_stands_out_before(within, ground, empty):
    if not empty:
        pytest.importorskip("cv2", reason="OpenCV is not installed")
    room, *bounds = GROUNDS[ground]
    rng, drawn = np.random.default_rng(0), [painted("body", turn, room) for turn in TURNS]
    names = tuple(drawn[0][2])
    points = np.array([[at[name] for name in names] for _, _, at in drawn])
    seen = Keypoints(names, points, np.ones(points.shape[:2]), SIZE)
    pictures = [np.uint8(np.clip(picture + rng.normal(0, 1.5, SHAPE), 0, 255)) for picture, _, _ in drawn]
    plate = Plate(np.float32(room), np.ones(SHAPE[:2], bool), 1.5) if empty else plate_of_free(pictures, seen)
    found = [soft_mask(picture, plate, seen, i) > 127 for i, picture in enumerate(pictures)]
    off = [beside(mask, true) for mask, (_, true, _) in zip(found, drawn, strict=True)]
    within(off, bounds[not empty], f"pixels, {ground}")
