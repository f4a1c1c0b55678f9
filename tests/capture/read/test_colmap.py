"""COLMAP models: text and binary say the same, and files that lie are refused at once."""

import struct
import time

import numpy as np
import pytest
from foreign_layouts import write_colmap

from capture.read.colmap import read_colmap
from command.errors import AssetError


@pytest.mark.parametrize("model", ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"])
@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
def test_cameras_are_those_written(source, tmp_path, model, binary):
    found = read_colmap(write_colmap(source, tmp_path / "model", binary=binary, model=model))
    assert list(found) == ["000000.png", "000001.png", "000002.png"]
    for camera, expected in zip(found.values(), source.videos["head"].cameras):
        np.testing.assert_allclose(camera.camera_from_world, expected.camera_from_world, atol=1e-12)
        np.testing.assert_array_equal(camera.K, expected.K)
        assert camera.size == expected.size


def test_parameters_go_where_each_model_has_them(tmp_path):
    cases = {
        "SIMPLE_PINHOLE 64 48 50 31 23": (50, 50, 31, 23, [0, 0, 0, 0, 0]),
        "PINHOLE 64 48 50 51 31 23": (50, 51, 31, 23, [0, 0, 0, 0, 0]),
        "SIMPLE_RADIAL 64 48 50 31 23 .1": (50, 50, 31, 23, [0.1, 0, 0, 0, 0]),
        "RADIAL 64 48 50 31 23 .1 .2": (50, 50, 31, 23, [0.1, 0.2, 0, 0, 0]),
        "OPENCV 64 48 50 51 31 23 .1 .2 .3 .4": (50, 51, 31, 23, [0.1, 0.2, 0.3, 0.4, 0]),
    }
    lines = [f"{i} {text}" for i, text in enumerate(cases)]
    (tmp_path / "cameras.txt").write_text("\n".join(lines))
    # x, y, z of a quarter turn about z; a name with a space; no line of points after the last
    images = [f"{i} .70710678 0 0 .70710678 1 2 3 {i} a {i}.png\n" for i in range(5)]
    (tmp_path / "images.txt").write_text("# w x y z\n" + "\n".join(images))
    for i, (camera, (fx, fy, cx, cy, d)) in enumerate(zip(read_colmap(tmp_path).values(), cases.values())):
        np.testing.assert_array_equal(camera.K, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        np.testing.assert_array_equal(camera.distortion, d)
        np.testing.assert_allclose(camera.camera_from_world[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
        np.testing.assert_array_equal(camera.camera_from_world[:3, 3], [1, 2, 3])
        assert f"a {i}.png" in read_colmap(tmp_path)


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


CAMERA, IMAGE = "1 PINHOLE 64 48 50 50 32 24", "1 1 0 0 0 0 0 0 1 a.png"
BAD = [
    ("1 FOV 64 48 50 50 32 24 .9", IMAGE, r"camera 1: camera model should be one of SIMPLE_PINHOLE, .* is FOV"),
    ("1 PINHOLE 64 48 50 50 32", IMAGE, r"camera 1: PINHOLE has 4 parameters, found 3"),
    ("1 PINHOLE 64 48 50 nan 32 24", IMAGE, r"camera 1: K should be finite"),
    ("1 PINHOLE wide 48 50 50 32 24", IMAGE, r"expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, found"),
    ("2 PINHOLE 64 48 50 50 32 24", IMAGE, r"image a\.png: no camera 1"),
    (CAMERA, "1 2 0 0 0 0 0 0 1 a.png", r"image a\.png: the quaternion should have length 1, has 2"),
    (CAMERA, "1 1 0 0 0 0 0 inf 1 a.png", r"image a\.png: camera_from_world should be finite"),
    (CAMERA, "1 1 0 0 0 0 0 0 1", r"expected IMAGE_ID"),
    (CAMERA, f"{IMAGE}\n\n2{IMAGE[1:]}", r"image a\.png: is there twice"),
]


@pytest.mark.parametrize("camera, image, message", BAD)
def test_cameras_and_images_that_are_none_are_refused_by_name(tmp_path, camera, image, message):
    (tmp_path / "cameras.txt").write_text(camera)
    (tmp_path / "images.txt").write_text(image + "\n\n")
    with pytest.raises(AssetError, match=message):
        read_colmap(tmp_path)
