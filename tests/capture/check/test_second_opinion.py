"""COLMAP's cameras of the head beside ours: common turns and units are no difference, others are said."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from avatar.camera import Camera, orbit_camera
from avatar.errors import AssetError
from avatar.rotation import matrix_from_axis_angle
from capture.check.second_opinion import ask_colmap, compared
from capture.folder import PartVideo
from geometry.rasterise import rasterise
from selfscan.__main__ import main

TURNS = 0.12 * np.arange(14)
SIZE = (320, 320)


def cameras_round(turns) -> tuple[Camera, ...]:
    return tuple(orbit_camera(np.zeros(3), 0.6, turn, 0.1, SIZE) for turn in turns)


def video_of(images, masks, cameras) -> PartVideo:
    return PartVideo("head", images, masks, cameras, None, None, None, None)


@pytest.fixture(scope="module")
def video() -> PartVideo:
    """A bumpy ball with blotches, seen from one side to the other."""
    rng = np.random.default_rng(0)
    rows, columns = 160, 320
    theta, phi = np.meshgrid(np.linspace(0.02, np.pi - 0.02, rows), np.linspace(0, 2 * np.pi, columns), indexing="ij")
    bumps = gaussian_filter(rng.standard_normal(theta.shape), 12, mode="wrap")
    radius = 0.1 * (1 + 0.1 * bumps / bumps.std())
    at = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], -1) * radius[..., None]
    k = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel(), k[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    blotches = gaussian_filter(rng.standard_normal((*theta.shape, 3)), (1.5, 1.5, 0))
    colors = np.clip(128 + 200 * blotches.reshape(-1, 3), 0, 255)
    cameras, images, masks = cameras_round(TURNS), [], []
    for camera in cameras:
        drawn = rasterise(at.reshape(-1, 3), faces, camera)
        hit = drawn.face >= 0
        picture = np.zeros((*hit.shape, 3))
        picture[hit] = colors[faces[drawn.face[hit]]].mean(1)
        images.append(picture.astype(np.uint8))
        masks.append(hit)
    return video_of(np.stack(images), np.stack(masks), cameras)


def elsewhere(camera: Camera, turned=(0.0, 0.0, 0.0)) -> Camera:
    """The camera of a model with a frame and a unit of its own, itself turned."""
    R, t = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    W = np.eye(4)
    W[:3, :3] = matrix_from_axis_angle(np.array(turned)) @ R @ matrix_from_axis_angle(np.array([0.3, -1.1, 2.0]))
    W[:3, 3] = 7.3 * t
    return replace(camera, camera_from_world=W)


def test_another_frame_and_unit_are_no_difference(video, within):
    opinion = compared(video, {f: elsewhere(camera) for f, camera in enumerate(video.cameras)})
    within(max(opinion.degrees), 1e-5, "degrees")
    assert opinion.findings() == [] and opinion.registered == tuple(range(14))


def test_a_frame_that_lies_otherwise_is_named(video):
    found = {f: elsewhere(camera) for f, camera in enumerate(video.cameras)}
    found[5] = elsewhere(video.cameras[5], [0, np.radians(25.0), 0])
    (finding,) = compared(video, found).findings()
    assert finding.what == "COLMAP turns the head otherwise in frame 5" and not finding.fatal


def test_few_frames_say_nothing(video):
    opinion = compared(video, {f: elsewhere(video.cameras[f], [0.3 * f, 0, 0]) for f in range(4)})
    assert opinion.findings() == [] and "4 of 14 frames, too few" in opinion.line()
    assert "0 of 14 frames" in compared(video, {}).line()


def test_structure_from_motion_agrees_about_a_ball_that_turns(video):
    pytest.importorskip("pycolmap", reason="pycolmap is an optional extra")
    opinion = ask_colmap(video)
    assert len(opinion.registered) >= 10
    assert np.median(opinion.degrees) < 1.0
    # cameras that turn the other way round are not believed
    mirrored = video_of(video.images, video.masks, cameras_round(-TURNS))
    (finding,) = ask_colmap(mirrored).findings()
    assert "otherwise (median)" in finding.what


def test_without_pycolmap_it_says_what_to_install(video, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(AssetError, match="--colmap needs pycolmap: pip install pycolmap"):
        ask_colmap(video)


def test_check_prints_the_opinion(turning, monkeypatch, capsys):
    monkeypatch.setattr(
        "capture.check.command.ask_colmap", lambda video: compared(video, dict(enumerate(video.cameras)))
    )
    main(["check", str(turning.path), "--colmap"])
    assert "head: COLMAP registered" in capsys.readouterr().out
