"""Lines on the ground and the world's axes: where they lie."""

from dataclasses import replace

import numpy as np

from avatar.camera import Camera, orbit_camera
from player.effects.grid import Grid
from player.scene.effects import PLAIN

SIZE = (200, 160)
OFF = replace(PLAIN, view="off")
CAMERA = orbit_camera((0.1, 0.3, -0.2), 4.0, 0.5, 0.6, SIZE)
TOP = orbit_camera((0, 0, 0), 8.0, 0.0, np.pi / 2 - 1e-4, SIZE)
RED = (1.0, 0.0, 0.0, 1.0)
# nobody in the way of the lines
ABOVE = np.array([0.0, 50.0, 0.0])


def test_lines_are_where_whole_metres_are(render, avatar, pose):
    grid = Grid(color=RED, axes=0.0)
    image = render(avatar, SIZE, effects=replace(OFF, grid=grid)).draw([(pose[0], ABOVE)], TOP)
    alpha = image[..., 3].astype(float)
    assert (image[..., 1:3] == 0).all() and (image[..., 0] == image[..., 3]).all(), "premultiplied red"
    metre = TOP.K[0, 0] / 8.0
    for k in (-1, 0, 1):
        column, row = round(SIZE[0] / 2 + k * metre), round(SIZE[1] / 2 + k * metre)
        assert alpha[30, column - 1 : column + 1].max() > 100 and alpha[row - 1 : row + 1, 30].max() > 100
    between = alpha[10:150, round(SIZE[0] / 2 + 0.1 * metre)]
    assert np.median(between) < 5


def test_axes_point_along_the_world(render, avatar, pose):
    grid = replace(OFF, grid=Grid(color=RED))
    image = render(avatar, SIZE, effects=grid).draw([(pose[0], ABOVE)], CAMERA).astype(int)
    for axis, paint in zip(np.eye(3), ((230, 64, 64), (89, 191, 76), (76, 115, 242)), strict=True):
        at = CAMERA.K @ (CAMERA.camera_from_world[:3] @ np.append(0.6 * axis, 1.0))
        column, row = (at[:2] / at[2]).astype(int)
        assert np.abs(image[row, column, :3] - paint).max() <= 2
    inside = Camera(CAMERA.K, CAMERA.camera_from_world + np.array([[0] * 4] * 2 + [[0, 0, 0, -3.9]] + [[0] * 4]), SIZE)
    assert np.isfinite(render(avatar, SIZE, effects=grid).draw([(pose[0], ABOVE)], inside)).all()
