"""Pose files that lie, are damaged, or are longer than memory."""

import json
import tracemalloc
import zipfile

import numpy as np
import pytest
from refusals import refused
from smplh_model import model_body

from avatar.body import builtin_body
from avatar.motion.read import read_motion
from avatar.skeleton import JOINTS
from command.errors import AssetError

TRANS = np.zeros((3, 3))


def save(path, **fields):
    fields = dict({"poses": np.zeros((3, 156)), "trans": TRANS, "mocap_framerate": np.array(30.0)}, **fields)
    np.savez(path, **{k: v for k, v in fields.items() if v is not None})
    return path


@pytest.mark.parametrize("joint", [0, 20, 51])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_bad_number_is_named_by_file_field_frame_and_joint(tmp_path, joint, bad):
    poses = np.zeros((3, 156))
    poses[2, 3 * joint + 1] = bad
    motion = read_motion(save(tmp_path / "walk.npz", poses=poses))
    motion.read(0, 2)
    refused(AssetError, rf"walk\.npz: poses is not finite at frame 2, joint {JOINTS[joint]}", motion.read, 1, 3)


def test_one_bad_root_position_is_named(tmp_path):
    trans = TRANS.copy()
    trans[1, 2] = np.nan
    with pytest.raises(AssetError, match="trans is not finite at frame 1"):
        read_motion(save(tmp_path / "a.npz", trans=trans)).read()
    gaze = np.zeros((3, 2, 2))
    gaze[2, 0, 1] = np.inf
    with pytest.raises(AssetError, match="gaze is not finite at frame 2"):
        read_motion(save(tmp_path / "a.npz", gaze=gaze)).read(1, 3)


@pytest.mark.parametrize("columns", [63, 69, 75, 78, 87, 153, 155, 3, 0, 1 << 20])
def test_ambiguous_column_counts_are_refused_with_the_reason(tmp_path, columns):
    with pytest.raises(AssetError, match=rf"a\.npz: poses should have 156, 165, 66 or 72 columns, has {columns}"):
        read_motion(save(tmp_path / "a.npz", poses=np.zeros((3, columns))))


@pytest.mark.parametrize("columns", [66, 72, 156, 165])
def test_understood_column_counts_read_as_52_joints(tmp_path, columns):
    clip = read_motion(save(tmp_path / "a.npz", poses=np.ones((3, columns)))).read()
    assert clip.axis_angle.shape == (3, 52, 3)
    assert (clip.axis_angle[:, 1:22] == 1).all()
    assert (clip.axis_angle[:, 22:] == (1 if columns > 100 else 0)).all()


@pytest.mark.parametrize("columns", [78, 87])
def test_hand_coefficients_are_read_with_the_model_that_explains_them(tmp_path, columns):
    path = save(tmp_path / "a.npz", poses=np.zeros((3, columns)))
    refused(AssetError, rf"has {columns}: .*components and the mean of the MANO hands.*--body", read_motion, path)
    body = model_body(tmp_path)
    clip = read_motion(path, body=body).read()  # no coefficient: the mean, once
    np.testing.assert_allclose(clip.axis_angle[1, 22:].reshape(2, 45), body.hands.mean)


def test_no_frames_is_refused_and_one_frame_is_a_motion(tmp_path):
    with pytest.raises(AssetError, match="0 frames"):
        read_motion(save(tmp_path / "a.npz", poses=np.zeros((0, 156)), trans=np.zeros((0, 3))))
    motion = read_motion(save(tmp_path / "b.npz", poses=np.zeros((1, 156)), trans=np.zeros((1, 3))))
    assert motion.frames == 1 and motion.read().root.shape == (1, 3)


@pytest.mark.parametrize("rate", [0.0, -30.0, np.nan, np.inf])
def test_impossible_frame_rates_are_refused(tmp_path, rate):
    with pytest.raises(AssetError, match="mocap_framerate should be positive"):
        read_motion(save(tmp_path / "a.npz", mocap_framerate=np.array(rate)))


def test_a_shape_file_is_refused(tmp_path):
    np.savez(tmp_path / "shape.npz", betas=np.zeros(16), gender="male")
    refused(AssetError, r"no poses \(a shape file\?\)", read_motion, tmp_path / "shape.npz")


@pytest.mark.parametrize(
    "field, value", [("trans", np.zeros((2, 3))), ("trans", np.zeros((3, 2))), ("trans", np.zeros(3))]
)
def test_fields_that_disagree_are_named(tmp_path, field, value):
    refused(AssetError, f"{field} should be", read_motion, save(tmp_path / "a.npz", **{field: value}))


def test_a_million_frames_are_read_in_constant_memory(tmp_path, within):
    frames = 1_000_000
    header = f"{{'descr': '<f2', 'fortran_order': False, 'shape': ({frames}, 156), }}".ljust(117) + "\n"
    block = np.zeros((1000, 156), "<f2").tobytes()
    with (
        zipfile.ZipFile(tmp_path / "long.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("poses.npy", "w", force_zip64=True) as file,
    ):
        file.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode())
        for _ in range(frames // 1000):
            file.write(block)
    tracemalloc.start()
    motion = read_motion(tmp_path / "long.npz")
    assert motion.frames == frames
    for start in (0, 400_000, frames - 100):
        motion.read(start, start + 100)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    within(peak / 2**20, 16, "MiB")


@pytest.mark.slow
def test_a_longer_bvh_takes_no_more_memory(tmp_path, data, within):
    text = (data / "bvh" / "pybvh_cmu_12_01_walk.bvh").read_text()
    head, motion = text.split("Frames: 524")
    time, frames = motion.split("\n", 2)[1:]
    builtin_body("male")  # loaded once, whatever the motion
    peaks = []
    for times in (1, 1, 8):  # the first fills caches
        with open(tmp_path / "long.bvh", "w") as file:
            file.write(f"{head}Frames: {524 * times}\n{time}\n")
            for _ in range(times):
                file.write(frames.rstrip("\n") + "\n")
        tracemalloc.start()
        motion = read_motion(tmp_path / "long.bvh")
        a, b = motion.read(24, 34), motion.read(524 * (times - 1) + 24, 524 * (times - 1) + 34)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        np.testing.assert_allclose(a.axis_angle, b.axis_angle, atol=1e-12)
    within((peaks[2] - peaks[1]) / 2**20, 0.25, "MiB")


@pytest.mark.parametrize("frames", ["-1", "1e9", "999999999999", "9" * 5000, ""])
def test_a_bvh_that_promises_impossible_frames_is_refused(tmp_path, data, frames):
    text = (data / "bvh" / "geno_stance.bvh").read_text()
    (tmp_path / "a.bvh").write_text(text.replace("Frames: 2", f"Frames: {frames}"), "utf-8")
    refused(AssetError, r"a\.bvh: line \d+: .*[Ff]rames", read_motion, tmp_path / "a.bvh")


def test_a_longer_easymocap_folder_takes_hardly_more_memory(tmp_path, within):
    peaks = []
    person = {"id": 0, "Rh": [[0.1, 0, 0]], "Th": [[0, 1, 0]], "poses": [[0.1] * 72], "shapes": [[0.0] * 10]}
    text = json.dumps([person])
    for frames in (200, 200, 2000):  # the first fills caches
        folder = tmp_path / str(len(peaks))
        folder.mkdir()
        for number in range(frames):
            (folder / f"{number:06d}.json").write_text(text, "utf-8")
        tracemalloc.start()
        motion = read_motion(folder)
        motion.read(0, 10), motion.read(frames - 10, frames)
        del motion
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    within((peaks[2] - peaks[1]) / 1800, 400, "bytes a frame")  # while the names are sorted
