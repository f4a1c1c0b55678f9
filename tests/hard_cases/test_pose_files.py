"""Pose files that lie, are damaged, or are longer than memory."""

import copy
import json
import pickle
import tracemalloc
import zipfile

import numpy as np
import pytest
from smplh_model import model_body
from tiny_avatar import join_glb

from avatar.body import builtin_body
from avatar.errors import AssetError
from avatar.motion.read import read_motion
from avatar.rotation import quaternion_from_axis_angle
from avatar.skeleton import JOINTS, PARENTS

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
    with pytest.raises(AssetError, match=rf"walk\.npz: poses is not finite at frame 2, joint {JOINTS[joint]}"):
        motion.read(1, 3)


def test_one_bad_root_position_is_named(tmp_path):
    trans = TRANS.copy()
    trans[1, 2] = np.nan
    with pytest.raises(AssetError, match="trans is not finite at frame 1"):
        read_motion(save(tmp_path / "a.npz", trans=trans)).read()


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
    with pytest.raises(AssetError, match=rf"has {columns}: .*components and the mean of the MANO hands.*--body"):
        read_motion(path)
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
    with pytest.raises(AssetError, match=r"no poses \(a shape file\?\)"):
        read_motion(tmp_path / "shape.npz")


def test_pickled_arrays_are_never_read(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (open, (str(tmp_path / "executed"), "w"))

    np.savez(tmp_path / "a.npz", poses=np.array([Bomb()], object), trans=TRANS, mocap_framerate=30)
    (tmp_path / "executed").unlink(missing_ok=True)
    with pytest.raises(AssetError, match="pickles are not read"):
        read_motion(tmp_path / "a.npz")
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize(
    "field, value", [("trans", np.zeros((2, 3))), ("trans", np.zeros((3, 2))), ("trans", np.zeros(3))]
)
def test_fields_that_disagree_are_named(tmp_path, field, value):
    with pytest.raises(AssetError, match=f"{field} should be"):
        read_motion(save(tmp_path / "a.npz", **{field: value}))


@pytest.mark.parametrize("deflated", [False, True])
def test_a_file_cut_anywhere_is_refused(tmp_path, deflated):
    rng = np.random.default_rng(1)
    write = np.savez_compressed if deflated else np.savez
    write(tmp_path / "a.npz", poses=rng.normal(size=(20, 156)), trans=np.zeros((20, 3)), mocap_framerate=30.0)
    whole = (tmp_path / "a.npz").read_bytes()
    for cut in [0, 1, 30, 100, 1000, len(whole) // 2, len(whole) - 30, len(whole) - 1]:
        (tmp_path / "cut.npz").write_bytes(whole[:cut])
        with pytest.raises(AssetError, match=r"cut\.npz"):
            read_motion(tmp_path / "cut.npz").read()


def test_flipped_bytes_give_an_error_or_finite_frames(tmp_path):
    rng = np.random.default_rng(2)
    save(tmp_path / "a.npz", poses=rng.normal(size=(4, 156)), trans=np.zeros((4, 3)))
    whole = (tmp_path / "a.npz").read_bytes()
    refused = 0
    for _ in range(300):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            damaged[place] ^= 1 << rng.integers(8)
        (tmp_path / "b.npz").write_bytes(damaged)
        try:
            clip = read_motion(tmp_path / "b.npz").read()
        except AssetError:
            refused += 1
        else:
            assert np.isfinite(clip.axis_angle).all() and np.isfinite(clip.root).all()
    assert refused > 250  # the archive's checksums see nearly all of it


@pytest.mark.parametrize(
    "shape", ["(9000000000000, 156)", "(-3, 156)", "(3, 156, 4294967296, 4294967296)", "(3.5, 156)"]
)
def test_a_header_that_promises_more_than_there_is_costs_no_memory(tmp_path, shape):
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}"
    header = header.ljust(117) + "\n"
    member = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(8 * 156 * 3)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("poses.npy", member)
    tracemalloc.start()
    with pytest.raises(AssetError, match=r"a\.npz: poses"):
        read_motion(tmp_path / "a.npz")
    assert tracemalloc.get_traced_memory()[1] < 10e6
    tracemalloc.stop()


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
    with pytest.raises(AssetError, match=r"a\.bvh: line \d+: .*[Ff]rames"):
        read_motion(tmp_path / "a.bvh")


def test_a_damaged_bvh_gives_an_error_or_finite_frames(tmp_path, data):
    rng = np.random.default_rng(3)
    whole = (data / "bvh" / "geno_stance.bvh").read_bytes()
    refused = 0
    for n in range(150):
        damaged = bytearray(whole)
        for place in rng.integers(0, 12_000, 4):
            damaged[place] = rng.integers(256) if n % 2 else rng.choice(list(b"{}\n 0-9eEJR"))
        (tmp_path / "b.bvh").write_bytes(damaged[: rng.integers(len(whole))] if n % 5 == 0 else damaged)
        try:
            clip = read_motion(tmp_path / "b.bvh").read()
        except AssetError as error:
            assert "b.bvh" in str(error)
            refused += 1
        else:
            assert np.isfinite(clip.axis_angle).all() and np.isfinite(clip.root).all()
    assert refused > 30


def fuzzed(whole: bytes, rng, n: int) -> bytes:
    """The file with a few bytes changed; every fifth also cut."""
    damaged = bytearray(whole)
    for place in rng.integers(0, len(whole), 1 + n % 4):
        damaged[place] = rng.integers(256)
    return bytes(damaged[: rng.integers(len(whole))]) if n % 5 == 0 else bytes(damaged)


def refused_or_finite(path) -> bool:
    """Whether the motion is refused, by its name and in one line; what is read instead is finite."""
    try:
        motion = read_motion(path)
        clip = motion.read(0, min(motion.frames, 50))
    except AssetError as error:
        assert path.name in str(error) and "\n" not in str(error) and len(str(error)) < 600 + len(str(path))
        return True
    assert np.isfinite(clip.axis_angle).all() and np.isfinite(clip.root).all()
    return False


@pytest.mark.parametrize("protocol", [0, 2, 5])
def test_a_damaged_pickled_sequence_gives_an_error_or_finite_frames(tmp_path, protocol):
    rng = np.random.default_rng(4)
    fields = {
        "poses": rng.normal(size=(3, 72)),
        "trans": np.zeros((3, 3)),
        "betas": np.zeros(10),
        "gender": "male",
    }
    whole = pickle.dumps(fields | {"fps": 30.0}, protocol)
    refused = 0
    for n in range(120):
        (tmp_path / "b.pkl").write_bytes(fuzzed(whole, rng, n))
        refused += refused_or_finite(tmp_path / "b.pkl")
    assert refused > 25


def test_a_pickled_sequence_runs_nothing(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (open, (str(tmp_path / "executed"), "w"))

    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        data = pickle.dumps({"poses": np.zeros((1, 72)), "extra": Bomb()}, protocol)
        (tmp_path / "a.pkl").write_bytes(data)
        with pytest.raises(AssetError, match=r"open', which is not one of .*nothing was run"):
            read_motion(tmp_path / "a.pkl")
    assert not (tmp_path / "executed").exists()


def easymocap_person() -> str:
    person = {"id": 0, "Rh": [[0.1, 0, 0]], "Th": [[0, 1, 0]], "poses": [[0.1] * 72], "shapes": [[0.0] * 10]}
    return json.dumps([person])


def test_a_damaged_easymocap_frame_gives_an_error_or_finite_frames(tmp_path):
    rng = np.random.default_rng(5)
    whole, refused = easymocap_person().encode(), 0
    for n in range(200):
        (tmp_path / "000000.json").write_bytes(fuzzed(whole, rng, n))
        refused += refused_or_finite(tmp_path / "000000.json")
    assert refused > 40


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", "null", "3", "[" * 100_000, "[1]", '{"annots": 1}', "9" * 5000, "\xff"]
)
def test_a_frame_that_is_no_frame_is_refused(tmp_path, text):
    (tmp_path / "000000.json").write_text(text, "utf-8")
    with pytest.raises(AssetError, match=r"000000\.json"):
        read_motion(tmp_path)


def test_a_longer_easymocap_folder_takes_hardly_more_memory(tmp_path, within):
    peaks = []
    text = easymocap_person()
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


def animated_glb() -> tuple[dict, bytes]:
    """A rig with our names, no mesh, its knees bending; JSON and binary chunk."""
    joints = builtin_body("male").joints
    times = np.arange(8, dtype="<f4") / 30
    values = quaternion_from_axis_angle(np.linspace([0, 0, 0], [1.0, 0, 0], 8)).astype("<f4")
    binary = times.tobytes() + values.tobytes()
    nodes = []
    for k, name in enumerate(JOINTS):
        place = joints[k] - (joints[PARENTS[k]] if k else 0)
        children = [int(c) for c in np.flatnonzero(k == PARENTS)]
        nodes.append({"name": name, "translation": place.tolist()} | ({"children": children} if children else {}))
    document = {
        "asset": {"version": "2.0"},
        "nodes": nodes,
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 32},
            {"buffer": 0, "byteOffset": 32, "byteLength": 128},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "SCALAR"},
            {"bufferView": 1, "componentType": 5126, "count": 8, "type": "VEC4"},
        ],
        "animations": [
            {
                "samplers": [{"input": 0, "output": 1}],
                "channels": [
                    {"sampler": 0, "target": {"node": JOINTS.index(f"{side}_knee"), "path": "rotation"}}
                    for side in ("left", "right")
                ],
            }
        ],
    }
    return document, binary


def test_a_damaged_animation_gives_an_error_or_finite_frames(tmp_path):
    rng = np.random.default_rng(6)
    document, binary = animated_glb()
    (tmp_path / "good.glb").write_bytes(join_glb(document, binary))
    assert not refused_or_finite(tmp_path / "good.glb")
    whole, refused = (tmp_path / "good.glb").read_bytes(), 0
    tail = len(whole) - len(binary) - 700  # the animation's JSON and numbers; the rest is mostly digits of places
    for n in range(200):
        damaged = bytearray(whole)
        for place in rng.integers(tail if n % 2 else 20, len(whole), 1 + n % 3):
            damaged[place] = rng.integers(256)
        (tmp_path / "b.glb").write_bytes(damaged)
        refused += refused_or_finite(tmp_path / "b.glb")
    assert refused > 80


@pytest.mark.parametrize("key", ["nodes", "animations", "accessors", "bufferViews"])
@pytest.mark.parametrize("value", [None, -1, 1e300, "x", [], {}, [[]], True])
def test_a_gltf_animation_with_one_wrong_value_is_refused_or_finite(tmp_path, key, value):
    document, binary = animated_glb()

    def places(item, path=()):
        entries = item.items() if isinstance(item, dict) else enumerate(item)
        for k, inner in entries:
            yield (*path, k)
            if isinstance(inner, (dict, list)):
                yield from places(inner, (*path, k))

    for path in [p for p in places(document[key]) if key != "nodes" or p[0] in (0, 4)]:
        changed = copy.deepcopy(document)
        target = changed[key]
        for k in path[:-1]:
            target = target[k]
        target[path[-1]] = value
        (tmp_path / "b.glb").write_bytes(join_glb(changed, binary))
        refused_or_finite(tmp_path / "b.glb")
