"""A head that is a ball, with hair that is a block behind and below it, filmed all round in silhouette."""

import numpy as np
from scipy import ndimage

from avatar.camera import orbit_camera, pixel_rays
from capture.template.grid import DistanceGrid
from capture.template.hull import STANDS_OFF, MaskView, Scalp, carve

RADIUS = 0.1  # metres, of the head, at the origin
HAIR = np.array([[-0.08, -0.16, -0.16], [0.08, 0.02, -0.03]])  # a block, behind and below
LOW, HIGH, CELL = np.array([-0.2, -0.25, -0.25]), np.array([0.2, 0.15, 0.2]), 0.006
SCALP = Scalp(neck=-0.05, brow=0.05, middle=(0.0, 0.0))
GRID = np.stack(np.meshgrid(*(np.arange(LOW[i], HIGH[i] + CELL, CELL) for i in range(3)), indexing="ij"), -1)


def ball() -> DistanceGrid:
    return DistanceGrid((np.linalg.norm(GRID, axis=-1) - RADIUS).astype(np.float32), LOW.astype(np.float32), CELL)


def filmed(hair: bool) -> list[MaskView]:
    """Exact silhouettes of the ball, with or without the block, from 30 places on three circles."""
    views = []
    for i in range(30):
        camera = orbit_camera(np.zeros(3), 1.0, np.radians(12.0 * i), np.radians((-25, 0, 25)[i % 3]), (160, 160), 0.6)
        origins, directions = pixel_rays(camera)
        along = -(origins * directions).sum(1)
        mask = np.linalg.norm(origins + along[:, None] * directions, axis=1) < RADIUS
        if hair:
            near, far = (HAIR[0] - origins) / directions, (HAIR[1] - origins) / directions
            mask |= np.minimum(near, far).max(1) < np.maximum(near, far).min(1)
        views.append(MaskView(~mask.reshape(160, 160), camera))
    return views


def grown(view: MaskView, pixels: int) -> MaskView:
    """The view with a person that is wider by some pixels."""
    change = ndimage.binary_erosion if pixels > 0 else ndimage.binary_dilation
    return view._replace(beside=np.asarray(change(view.beside, iterations=abs(pixels), border_value=1), bool))


def standing(views: list[MaskView]) -> np.ndarray | None:
    """The cells of the hair carved, farther off the ball than what counts as hair."""
    template = ball()
    hair = carve(views, template, SCALP)
    return None if hair is None else (hair.share > 0.5) & (template.values > STANDS_OFF)


def block() -> np.ndarray:
    inside = ((HAIR[0] < GRID) & (HAIR[1] > GRID)).all(-1)
    return inside & (np.linalg.norm(GRID, axis=-1) > RADIUS + STANDS_OFF)
