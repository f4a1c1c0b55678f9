"""COLMAP models: cameras as they were written, and files that lie are refused at once."""

import struct
import time

import numpy as np
import pytest
from foreign_layouts import colmap_files, write_colmap

from capture.read.colmap import read_colmap
from command.errors import AssetError


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


def test_the_usual_subfolders_are_looked_into(source, tmp_path):
    write_colmap(source, tmp_path / "work/sparse/0")
    assert len(read_colmap(tmp_path / "work")) == 3
    with pytest.raises(AssetError, match="expected a COLMAP model"):
        read_colmap(tmp_path)


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
    with pytest.raises(AssetError, match=name.replace(".", r"\.")):
        read_colmap(tmp_path / "m")
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
    with pytest.raises(AssetError, match=message):
        read_colmap(colmap_files(tmp_path, [camera], images))
