"""The avatar file in three.js, in a browser without a display: the same picture as ours."""

import dataclasses

import numpy as np
import pytest
from chromium import chromium, three_frames
from node_packages import package_folder
from scipy import ndimage

from avatar.camera import orbit_camera
from avatar.gltf.avatar_file import write_avatar
from player.scene.mannequin import mannequin
from player.scene.renderer import Renderer

pytestmark = pytest.mark.slow

BLACK = (0.0, 0.0, 0.0, 1.0)


def bent():
    """Elbows, a knee, the head, all fingers bent; turned and moved."""
    axis_angle = np.zeros((52, 3))
    axis_angle[0, 1] = 0.4
    axis_angle[[18, 19], 1] = [-1.2, 1.0]
    axis_angle[[16, 17], 2] = [-0.9, 0.7]
    axis_angle[4, 0], axis_angle[15, 1] = 0.8, 0.5
    axis_angle[22:37, 2], axis_angle[37:52, 2] = -0.4, 0.4
    return axis_angle, np.array([0.1, 0.05, -0.2])


def painted():
    """The built-in body in soft stripes a few centimetres wide: no texel finer than a pixel, where filters differ."""
    avatar = mannequin()
    y, x = np.mgrid[:512, :512] / 512
    waves = [np.sin(2 * np.pi * (a * x + b * y) + c) for a, b, c in ((9, 2, 0), (-3, 11, 1), (7, 7, 2))]
    color = (128 + 100 * np.stack(waves, -1)).astype(np.uint8)
    return dataclasses.replace(avatar, levels=(dataclasses.replace(avatar.levels[0], base_color=color),))


def decibels(ours, theirs, pixels):
    return -10 * np.log10(np.square((ours[pixels].astype(float) - theirs[pixels]) / 255).mean())


def compared(ours, theirs):
    """dB in the rectangle round the person, outlines and the black around included; and inside the outlines."""
    drawn = (ours.max(-1) > 0) | (theirs.max(-1) > 0)
    assert 0.05 < drawn.mean() < 0.6
    rows, columns = np.flatnonzero(drawn.any(1)), np.flatnonzero(drawn.any(0))
    box = np.zeros_like(drawn)
    box[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] = True
    both = (ours.max(-1) > 0) & (theirs.max(-1) > 0)
    return decibels(ours, theirs, box), decibels(ours, theirs, ndimage.binary_erosion(both, iterations=2))


def test_three_js_draws_the_same_frame_as_paper_mode(context, tmp_path):
    folder = package_folder("three")
    chromium()
    avatar = painted()
    write_avatar(tmp_path / "mannequin.glb", avatar)
    camera = orbit_camera(np.array([0.0, -0.1, 0.0]), 2.6, 0.3, 0.1, (480, 480), np.radians(45))
    poses = [(np.zeros((52, 3)), np.zeros(3)), bent()]
    (tmp_path / "browser").mkdir()
    theirs = three_frames(tmp_path / "mannequin.glb", poses, camera, folder, tmp_path / "browser")
    renderer = Renderer(context, [avatar], camera.size, view="off", background=BLACK)
    ours = [renderer.draw([pose], camera)[..., :3] for pose in poses]
    renderer.release()
    for mine, other in zip(ours, theirs, strict=True):
        box, inside = compared(mine, other)
        assert box >= 35 and inside >= 39
    assert compared(ours[1], theirs[0])[0] < 20  # and the measure tells poses apart
