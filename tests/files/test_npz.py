"""Archives of arrays: only what is asked for is unpacked, damage is one line; objects are rebuilt by unpickle."""

import io
import os
import struct
import time
import tracemalloc
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from memory_use import at_most

from avatar.camera import Camera, pinhole, read_cameras, write_cameras
from avatar.motion.read import read_motion
from command.errors import AssetError
from files.npz import NpzFile, read_npy, read_npz

MANY = 1 << 29  # bytes of zeros, 520 kB deflated


@pytest.fixture(scope="module")
def zeros(tmp_path_factory) -> bytes:
    """A deflated member of half a gigabyte of numbers, as it stands in an archive by itself."""
    path = tmp_path_factory.mktemp("zeros") / "zeros.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive, archive.open("x.npy", "w") as f:
        f.write(npy_header((MANY // 8,)))
        for _ in range(MANY >> 20):
            f.write(bytes(1 << 20))
    return path.read_bytes()


def npy_header(shape, fortran=False, descr="<f8"):
    return headed(f"{{'descr': {descr!r}, 'fortran_order': {fortran}, 'shape': {shape}, }}")


def headed(text):
    text = text.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def with_member(path: Path, name: str, zeros: bytes) -> None:
    """Adds the half gigabyte to an archive, under a name of the same length as `x`."""
    assert len(name) == 1
    with zipfile.ZipFile(path) as archive:
        members = {n: archive.read(n) for n in archive.namelist()}
    data = zeros.replace(b"x.npy", f"{name}.npy".encode())
    path.write_bytes(data)
    with zipfile.ZipFile(path, "a") as archive:
        for key, content in members.items():
            archive.writestr(key, content)


def peak(read) -> float:
    tracemalloc.start()
    try:
        read()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_members_not_asked_for_and_arrays_too_large_are_never_unpacked(tmp_path, zeros):
    write_cameras(tmp_path / "cameras.npz", [Camera(pinhole((64, 48), 0.6), np.eye(4), (64, 48))])
    np.savez(tmp_path / "poses.npz", poses=np.zeros((3, 156)), trans=np.zeros((3, 3)), mocap_framerate=30.0)
    for path, read in ((tmp_path / "cameras.npz", read_cameras), (tmp_path / "poses.npz", read_motion)):
        plain = peak(partial(read, path))
        with_member(path, "x", zeros)
        assert peak(partial(read, path)) < plain + (4 << 20), path
    np.savez(tmp_path / "a.npz", size=np.array([64, 48]), camera_from_world=np.eye(4)[None])
    with_member(tmp_path / "a.npz", "K", zeros)
    refused = pytest.raises(AssetError, match=r"a\.npz: cameras should take at most \d+ bytes, would take 536871")
    with at_most(4 << 20), refused:
        read_cameras(tmp_path / "a.npz")


def test_rows_of_an_archive_that_is_not_compressed_are_read_where_they_stand(tmp_path):
    """A million frames, forwards, backwards and across: only what is asked for is read, and it is right."""
    frames = 1_000_000
    values = (np.arange(3 * frames) % 251).astype(np.uint8).reshape(frames, 3)
    np.savez(tmp_path / "long.npz", other=np.zeros(7), poses=values)
    npz = NpzFile(tmp_path / "long.npz", "a pose file")
    poses, read = npz.member("poses"), []

    class Counted(io.BufferedReader):
        def read(self, size=-1, /):
            read.append(size)
            return super().read(size)

    # its checksum was compared before
    poses.checked = True
    npz.file.close()
    npz.file = Counted(io.FileIO(tmp_path / "long.npz"))
    with at_most(1e6):
        for start in (999_000, 998_000, 500_000, 500_256, 3):
            assert np.array_equal(poses.rows(start, start + 256), values[start : start + 256])
    assert read == [3 * 256] * 5
    npz.close()


def test_an_array_in_fortran_order_is_held_once_and_only_when_it_is_small(tmp_path):
    poses = np.asfortranarray(np.random.default_rng(0).normal(size=(30_000, 156)))
    np.savez(tmp_path / "a.npz", poses=poses, trans=np.zeros((30_000, 3)))
    motion = read_motion(tmp_path / "a.npz")
    assert peak(lambda: motion.read(10, 20)) < 1.2 * poses.nbytes
    with (
        zipfile.ZipFile(tmp_path / "b.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("poses.npy", "w") as file,
    ):
        file.write(npy_header((500_000, 156), fortran=True))
        for _ in range(500):
            file.write(bytes(156 * 8 * 1000))
    motion = read_motion(tmp_path / "b.npz")
    with at_most(4 << 20), pytest.raises(AssetError, match=r"poses \(500000, 156\) should take at most"):
        motion.read(0, 1)


def archive(path, method=zipfile.ZIP_STORED, member=b""):
    with zipfile.ZipFile(path, "w", method) as file:
        file.writestr("K.npy", member or npy_header((1,)) + bytes(8))
    return path


@pytest.mark.parametrize(
    "member, match",
    [
        (b"\x93NUMPY\x02\x00" + struct.pack("<I", 1 << 31), "an .npy header of 2147483648 bytes"),
        (npy_header((-1,)) + bytes(8), "the shape"),
        (npy_header((1,), descr="<U0"), "empty items"),
        (npy_header((1 << 62, 1 << 62)), "should take"),
        (npy_header((1,), descr="|O") + bytes(8), "pickles are not read|expected numbers, found"),
        (npy_header((2,)) + bytes(8), "should take 16 bytes, there are 8"),
        (npy_header(3) + bytes(8), "found|damaged"),
        (npy_header((1,), descr="V8") + bytes(8), "should hold numbers or text"),
        (npy_header((1,), descr=[("a", "<f8")]) + bytes(8), "should hold numbers or text"),
        (npy_header("(" * 3000) + bytes(8), "found|damaged"),
        (headed("__import__('os').system('true')"), "found|damaged"),
        (b"no array", "magic string"),
    ],
)
def test_headers_that_lie_are_one_line_at_once(tmp_path, member, match):
    (tmp_path / "a.npy").write_bytes(member)
    archive(tmp_path / "a.npz", member=member)
    for read in (
        lambda: read_npz(tmp_path / "a.npz", "numbers", ("K",)),
        lambda: read_npy(tmp_path / "a.npy", "numbers"),
    ):
        began = time.process_time()
        with pytest.raises(AssetError, match=match) as error:
            read()
        assert time.process_time() - began < 1 and "\n" not in str(error.value)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_ways_of_packing_are_refused(tmp_path, method):
    with pytest.raises(AssetError, match="compression method"):
        read_npz(archive(tmp_path / "a.npz", method), "cameras", ("K",))


def test_a_directory_of_gigabytes_is_not_read(tmp_path):
    """The end record claims what a sparse file of 2 GB could hold."""
    path = tmp_path / "a.npz"
    with open(path, "wb") as file:
        file.truncate(1 << 31)
        file.seek(0, io.SEEK_END)
        file.write(b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 9, 9, (1 << 31) - 64, 64, 0))
    with at_most(8 << 20), pytest.raises(AssetError, match="a list of members of more than"):
        NpzFile(path, "cameras")


def saved(path, value, **options):
    np.save(path, value, **options)
    return path


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3),
        np.asfortranarray(np.arange(6).reshape(2, 3)),
        np.arange(3, dtype=">i4"),
        np.float32(2),
        np.zeros((0, 3)),
        np.array(["a", "bc"]),
        np.array([True, False]),
    ],
)
def test_numbers_and_text_come_back_equal(tmp_path, array):
    found = read_npy(saved(tmp_path / "a.npy", array), "numbers")
    assert found.shape == array.shape and found.dtype == array.dtype.newbyteorder("=")
    np.testing.assert_array_equal(found, array)


def test_objects_come_as_lists_and_code_in_them_is_not_run(tmp_path):
    record = {"K": [np.eye(3)], "ims": [{"ims": ["images/000500.jpg"]}]}
    (found,) = read_npy(saved(tmp_path / "a.npy", np.array(record, object), allow_pickle=True), "a record")
    assert found["ims"] == record["ims"]
    np.testing.assert_array_equal(found["K"][0], np.eye(3))
    several = np.empty(2, object)
    several[:] = [{"R": np.ones((1, 3))}, {"R": np.zeros((1, 3))}]
    found = read_npy(saved(tmp_path / "b.npy", several, allow_pickle=True), "records")
    assert [item["R"].sum() for item in found] == [3, 0]
    path = saved(tmp_path / "a.npy", np.array({"cams": os.mkdir}, object), allow_pickle=True)
    message = r"a\.npy: expected cameras, found: .*the name '(posix|nt)\.mkdir'.*nothing was run"
    with pytest.raises(AssetError, match=message):
        read_npy(path, "cameras")
