"""Landmarks and COLMAP models: exact where the file is right, refused at once where it lies."""

import json
import struct
import time
from dataclasses import replace

import numpy as np
import pytest
from foreign_layouts import colmap_files, write_colmap
from refusals import refused

from avatar.body import builtin_body
from avatar.camera import Camera, orbit_camera, project
from capture.read.colmap import read_colmap
from capture.read.landmarks import read_pixels, triangulated
from capture.read.places import SMPLH_COUNT, SMPLH_VERTICES, landmark_vertices
from capture.read.template import part_of
from command.errors import AssetError

POINT = np.array([0.03, 0.05, -0.02])


def cameras(*degrees: float) -> list[Camera]:
    lens = np.array([0.08, -0.03, 0.002, -0.001, 0.01])
    views = (orbit_camera([0, 0, 0], 0.9, np.radians(angle), 0.2, (640, 480)) for angle in degrees)
    return [replace(view, distortion=lens) for view in views]


def pixels(views: list[Camera]) -> np.ndarray:
    return np.concatenate([project(view, POINT[None])[0] for view in views])


@pytest.mark.parametrize("degrees", [(0, 10), (0, 90), (-40, 0, 35, 60), (0, 180)])
def test_exact_pixels_give_the_point(degrees):
    views = cameras(*degrees)
    point, error = triangulated("file: nose", views, pixels(views))
    np.testing.assert_allclose(point, POINT, atol=1e-8)
    assert error < 1e-5


def test_noisy_pixels_give_the_point_of_least_squares_and_what_no_point_explains_is_refused():
    views = cameras(-50, -20, 10, 40)
    seen = pixels(views) + np.random.default_rng(0).normal(size=(4, 2))
    point, error = triangulated("file: nose", views, seen)
    assert np.linalg.norm(point - POINT) < 0.003  # a pixel is 1.2 mm there

    def cost(p):
        return sum(((project(v, p[None])[0][0] - s) ** 2).sum() for v, s in zip(views, seen))

    assert error == pytest.approx(np.sqrt(cost(point) / 4))
    for step in 1e-5 * np.concatenate([np.eye(3), -np.eye(3)]):
        assert cost(point + step) > cost(point)
    views = cameras(0, 40, 80)
    seen = pixels(views)
    near, apart = cameras(0, 1), cameras(0, 20)
    for message, *given in (
        (r"one place in all its pictures within 6\.4 pixels, its", views, seen + [[0, 0], [0, 40], [0, -40]]),
        ("be marked in at least 2 registered pictures, is in 1", views[:1], seen[:1]),
        (r"be marked in pictures from 3 degrees apart or more, they are 0\.9", near, pixels(near)),
        # rays that diverge in front meet behind
        ("lie before its cameras, its pixels meet behind one", apart, pixels(apart) + [[-300, 0], [300, 0]]),
    ):
        refused(AssetError, f"file: nose should .*{message}", triangulated, "file: nose", *given)


@pytest.mark.parametrize(
    "content, message",
    [
        ("[]", 'expected {"pixels"'),
        ('{"pixels": {"nose_tip": [1, 2]}}', r"pixels\.nose_tip should be \{picture"),
        ('{"pixels": {"nose_tip": {"a.png": [1]}}}', r"pixels\.nose_tip\.a\.png should be \[x, y\]"),
        ('{"pixels": {"nose_tip": {"a.png": [1, NaN]}}}', r"expected landmarks \(JSON\), found: NaN, which is not a"),
        ('{"pixels": {}, "vertices": {"mole": -1}}', r"vertices\.mole should be the number of a vertex"),
    ],
)
def test_files_that_are_none_are_refused(tmp_path, content, message):
    (tmp_path / "l.json").write_text(content)
    refused(AssetError, rf"l\.json: {message}", read_pixels, tmp_path / "l.json")


def test_pixels_and_own_vertices_are_read_and_subfolders_looked_into(tmp_path, source):
    (tmp_path / "l.json").write_text(json.dumps({"pixels": {"mole": {"a.png": [1, 2.5]}}, "vertices": {"mole": 7}}))
    seen, own = read_pixels(tmp_path / "l.json")
    assert seen["mole"]["a.png"].tolist() == [1, 2.5] and own == {"mole": 7}
    write_colmap(source, tmp_path / "work/sparse/0")
    assert len(read_colmap(tmp_path / "work")) == 3
    refused(AssetError, "expected a COLMAP model", read_colmap, tmp_path)


@pytest.mark.parametrize("sex", ["male", "female"])
def test_places_of_the_free_body_are_where_their_names_say(sex):
    body = builtin_body(sex)
    found = landmark_vertices(body.vertices, part_of(body.skin) == 1)
    assert len(found) >= 12
    at = {name: body.vertices[v] for name, v in found.items()}
    assert at["nose_tip"][2] == max(p[2] for p in at.values())
    for left in ("left_eye", "left_ear", "left_mouth"):
        right = at[left.replace("left", "right")]
        np.testing.assert_allclose(at[left][1:], right[1:], atol=1e-4)
        assert at[left][0] - at["nose_tip"][0] == pytest.approx(at["nose_tip"][0] - right[0], abs=0.003)
        assert at[left][0] > 0.015
    assert at["chin"][1] < at["left_mouth"][1] < at["nose_tip"][1] < at["left_eye"][1] < at["forehead"][1]


def test_a_mesh_of_smplh_has_its_published_vertices():
    rest = np.zeros((SMPLH_COUNT, 3))
    rest[:, 1] = np.linspace(0, 0.2, SMPLH_COUNT)
    found = landmark_vertices(rest, np.ones(SMPLH_COUNT, bool))
    assert SMPLH_VERTICES.items() <= found.items()
    assert SMPLH_VERTICES["nose_tip"] == 332


@pytest.mark.parametrize("model", ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"])
def test_cameras_are_those_written(source, tmp_path, model):
    found = read_colmap(write_colmap(source, tmp_path / "model", model=model))
    assert list(found) == ["000000.png", "000001.png", "000002.png"]
    for camera, expected in zip(found.values(), source.videos["head"].cameras):
        np.testing.assert_allclose(camera.camera_from_world, expected.camera_from_world, atol=1e-12)
        np.testing.assert_array_equal(camera.K, expected.K)
        assert camera.size == expected.size


def test_parameters_go_where_each_model_has_them(tmp_path):
    cases = [
        (("SIMPLE_PINHOLE", 64, 48, 50, 31, 23), (50, 50, 31, 23, [0, 0, 0, 0, 0])),
        (("PINHOLE", 64, 48, 50, 51, 31, 23), (50, 51, 31, 23, [0, 0, 0, 0, 0])),
        (("SIMPLE_RADIAL", 64, 48, 50, 31, 23, 0.1), (50, 50, 31, 23, [0.1, 0, 0, 0, 0])),
        (("RADIAL", 64, 48, 50, 31, 23, 0.1, 0.2), (50, 50, 31, 23, [0.1, 0.2, 0, 0, 0])),
        (("OPENCV", 64, 48, 50, 51, 31, 23, 0.1, 0.2, 0.3, 0.4), (50, 51, 31, 23, [0.1, 0.2, 0.3, 0.4, 0])),
    ]
    turn = (0.70710678, 0, 0, 0.70710678)  # a quarter about z
    images = [(i, turn, (1, 2, 3), f"a {i}.png", i) for i in range(5)]
    found = read_colmap(colmap_files(tmp_path, [(i, *written) for i, (written, _) in enumerate(cases)], images))
    assert list(found) == [f"a {i}.png" for i in range(5)]
    for camera, (_, (fx, fy, cx, cy, d)) in zip(found.values(), cases):
        np.testing.assert_array_equal(camera.K, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        np.testing.assert_array_equal(camera.distortion, d)
        np.testing.assert_allclose(camera.camera_from_world[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
        np.testing.assert_array_equal(camera.camera_from_world[:3, 3], [1, 2, 3])


@pytest.mark.parametrize("count", [2, 1 << 20, 1 << 40, (1 << 64) - 1])
@pytest.mark.parametrize("name, at", [("cameras.bin", 0), ("images.bin", 0), ("images.bin", "points")])
def test_counts_beyond_the_file_are_refused_within_a_second(source, tmp_path, name, at, count):
    write_colmap(source, tmp_path / "m")
    data = bytearray((tmp_path / "m" / name).read_bytes())
    if at == "points":
        at = data.index(b"000000.png\0") + 11
    data[at : at + 8] = struct.pack("<Q", max(count, 4) if at == 0 else count)
    (tmp_path / "m" / name).write_bytes(data)
    began = time.process_time()
    refused(AssetError, name.replace(".", r"\."), read_colmap, tmp_path / "m")
    assert time.process_time() - began < 1


CAMERA, IMAGE = (1, "PINHOLE", 64, 48, 50, 50, 32, 24), (1, (1, 0, 0, 0), (0, 0, 0), "a.png", 1)
BAD = [
    ((1, "FOV", 64, 48, 50, 50, 32, 24, 0.9), [IMAGE], r"camera 1: camera model should be one of .* is FOV"),
    ((1, "PINHOLE", 64, 48, 50, np.nan, 32, 24), [IMAGE], r"camera 1: K should be finite"),
    ((2, *CAMERA[1:]), [IMAGE], r"image a\.png: no camera 1"),
    (CAMERA, [(1, (2, 0, 0, 0), *IMAGE[2:])], r"image a\.png: the quaternion should have length 1, has 2"),
    (CAMERA, [(*IMAGE[:2], (0, 0, np.inf), *IMAGE[3:])], r"image a\.png: camera_from_world should be finite"),
    (CAMERA, [IMAGE, IMAGE], r"image a\.png: is there twice"),
]


@pytest.mark.parametrize("camera, images, message", BAD)
def test_cameras_and_images_that_are_none_are_refused_by_name(tmp_path, camera, images, message):
    refused(AssetError, message, lambda: read_colmap(colmap_files(tmp_path, [camera], images)))
