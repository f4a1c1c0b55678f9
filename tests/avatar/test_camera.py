"""Cameras: OpenGL matrices against projection, rays against projection, files; mipmaps against means."""

import numpy as np
import pytest

from avatar.camera import (
    Camera,
    clip_from_view,
    look_at,
    orbit_camera,
    pinhole,
    pixel_rays,
    project,
    read_camera,
    read_cameras,
    view_from_world,
    write_camera,
    write_cameras,
)
from avatar.kinematics import pixel_rows
from avatar.texture import mipmaps


@pytest.fixture
def camera():
    K = np.array([[700.0, 3.0, 250.5], [0, 690, 199], [0, 0, 1]])
    return Camera(K, look_at((1, 2, 3), (0.1, 0, 0)), (512, 384), np.array([0.1, -0.05, 0.001, -0.002, 0.01]))


def test_opengl_matrices_put_a_point_on_the_pixel_of_project(camera):
    undistorted = Camera(camera.K, camera.camera_from_world, camera.size)
    points = np.random.default_rng(0).normal(size=(50, 3)) * 0.5
    pixels, depth = project(undistorted, points)
    clip = np.c_[points, np.ones(50)] @ (clip_from_view(undistorted, 0.1, 100.0) @ view_from_world(undistorted)).T
    ndc = clip[:, :3] / clip[:, 3:]
    window = np.stack([(ndc[:, 0] + 1) / 2 * 512, 384 - (ndc[:, 1] + 1) / 2 * 384], 1)
    np.testing.assert_allclose(window, pixels, atol=1e-9)
    np.testing.assert_allclose(clip[:, 3], depth, atol=1e-12)


def test_rays_run_through_their_pixels_with_distortion_and_by_default_row_by_row(camera):
    pixels = np.random.default_rng(0).uniform(0, 380, (100, 2))
    origins, directions = pixel_rays(camera, pixels)
    again, depth = project(camera, origins + 2.5 * directions)
    np.testing.assert_allclose(again, pixels, atol=1e-6)
    assert (depth > 0).all()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-14)
    small = camera.resized((4, 3))
    origins, directions = pixel_rays(small)
    pixels, _ = project(small, origins + directions)
    np.testing.assert_allclose(pixels[[0, 1, 4]], [[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]], atol=1e-6)


def test_an_orbit_at_azimuth_zero_looks_at_the_chest_and_files_round_trip(camera, tmp_path):
    camera = orbit_camera((0, 1, 0), 3, 0, 0, (100, 100))
    np.testing.assert_allclose(camera.eye, [0, 1, 3], atol=1e-12)
    pixels, _ = project(camera, np.array([[0, 1, 0], [0.1, 1, 0], [0, 1.1, 0]]))
    np.testing.assert_allclose(pixels[0], [50, 50])
    assert pixels[1, 0] > 50 and pixels[2, 1] < 50  # the subject's left is the viewer's right; up is up
    write_camera(tmp_path / "c.json", camera)
    write_cameras(tmp_path / "c.npz", [camera, camera])
    for again in (read_camera(tmp_path / "c.json"), read_cameras(tmp_path / "c.npz")[1]):
        np.testing.assert_array_equal(again.K, camera.K)
        np.testing.assert_array_equal(again.camera_from_world, camera.camera_from_world)
        np.testing.assert_array_equal(again.distortion, camera.distortion)
        assert again.size == camera.size


@pytest.mark.parametrize("up", [(0, 1, 0), (0, 5, 0)])
def test_looking_straight_down_is_a_proper_camera(up):
    R = look_at((0, 3, 0), (0, 0, 0), up)[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) > 0


@pytest.mark.parametrize("channels", [1, 3, 4, 8])
def test_a_mipmap_is_the_rounded_mean_of_blocks_of_the_one_before(channels):
    image = np.random.default_rng(channels).integers(0, 256, (16, 8, channels), dtype=np.uint8)
    chain = mipmaps(image, 4)
    assert [mip.shape for mip in chain] == [(16 >> k, 8 >> k, channels) for k in range(4)]
    assert chain[0] is image or np.array_equal(chain[0], image)
    for fine, coarse in zip(chain, chain[1:], strict=False):
        height, width = coarse.shape[:2]
        mean = fine.reshape(height, 2, width, 2, channels).mean((1, 3), dtype=np.float64)
        np.testing.assert_array_equal(coarse, np.floor(mean + 0.5))  # halves go up


def test_an_odd_size_loses_its_last_row_and_one_texel_stays():
    image = np.random.default_rng(1).integers(0, 256, (7, 3, 3), dtype=np.uint8)
    chain = mipmaps(image, 5)
    assert [mip.shape[:2] for mip in chain] == [(7, 3), (3, 1), (1, 1), (1, 1), (1, 1)]
    np.testing.assert_array_equal(chain[1], mipmaps(image[:6, :2], 2)[1])
    mean = chain[1][:2].mean((0, 1), dtype=np.float64)
    np.testing.assert_array_equal(chain[2][0, 0], np.floor(mean + 0.5))


def test_points_at_the_camera_and_behind_it_have_finite_pixels_and_slopes():
    camera = Camera(pinhole((64, 48), 0.6), np.eye(4), (64, 48))
    points = np.array([[0.1, 0.2, 0.0], [0.1, 0.2, -1.0], [0.1, 0.2, 1e-300]])
    with np.errstate(all="raise"):
        pixels, rows = pixel_rows(camera, points)
    assert np.isfinite(pixels).all() and np.isfinite(rows).all()
    # as at the nearest depth there is: a fit is pushed the way it was
    assert np.array_equal(rows[0], rows[1]) and (rows[:, 0, 0] > 0).all()
