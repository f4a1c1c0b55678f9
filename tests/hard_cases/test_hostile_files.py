"""Avatar and glTF files that are cut short, damaged, or lie: one clear refusal, soon and cheaply."""

import json
import os
import struct
import time
import tracemalloc
from functools import reduce
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from memory_use import at_most
from pictures import png
from tiny_avatar import join_glb, split_glb, tiny_avatar, tiny_face

from avatar.camera import read_camera
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.gltf.document import Gltf
from avatar.motion.gltf import Channel, _channels
from avatar.motion.read import read_motion
from command.errors import AssetError
from files.input_file import read_bytes
from player.scene.scene_file import read_scene

# of processor time: a loaded machine is no defect
SECONDS, BYTES = 2.0, 64 << 20


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("avatar") / "tiny.glb"
    write_avatar(path, tiny_avatar())
    return path.read_bytes()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "hostile.glb"


def refused(path, data: bytes, match: str = "", *, memory: bool = True) -> None:
    """The file is refused with an AssetError of one short line that names it, within the time and memory."""
    path.write_bytes(data)
    if memory:  # counting slows the reader five times
        tracemalloc.start()
    started = time.process_time()
    with pytest.raises(AssetError, match=match) as error:
        read_avatar(path)
    seconds, peak = time.process_time() - started, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    message = str(error.value)
    assert message.startswith(str(path)) and "\n" not in message and len(message) < len(str(path)) + 400
    assert seconds < SECONDS and peak < BYTES


def test_cut_anywhere_with_lengths_mended(path, whole):
    """The container is honest about what is left; its buffer is not."""
    document, binary = split_glb(whole)
    for length in np.random.default_rng(1).integers(0, len(binary) - 4, 50):
        path.write_bytes(join_glb(document, binary[:length]))
        with pytest.raises(AssetError, match=r"buffers\[0\].byteLength should be at most"):
            read_avatar(path)


def lying(whole: bytes, place: str, value=...) -> bytes:
    """The file with a value at a dotted place of its JSON ("accessors.0.count"), or without that key."""
    document, binary = split_glb(whole)
    *way, last = (int(key) if key.isdigit() else key for key in place.split("."))
    holder = reduce(lambda inner, key: inner[key], way, document)
    if value is ...:
        del holder[last]
    else:
        holder[last] = value
    return join_glb(document, binary)


OURS = "extensions.SELFSCAN_avatar"
POSITION, WEIGHTS, INDICES = 1, 5, 10  # accessors of the finest level; 0 holds the inverse bind matrices
TARGET = 11  # the first morph target of a face
VIEW = 2  # the buffer view of POSITION
HUGE = [2**31, 2**63, 10**200, -1, 1.5, True, "7", None, [], {}]
LIES = [
    *((f"accessors.{POSITION}.count", value, r"accessors\[1\]") for value in [*HUGE, 0, 9, 2**29]),
    *((f"accessors.{POSITION}.byteOffset", value, r"accessors\[1\]") for value in [*HUGE[:-1], 1, 2**29]),
    *((f"bufferViews.{VIEW}.byteOffset", value, r"bufferViews\[2\]") for value in HUGE),
    *((f"bufferViews.{VIEW}.byteLength", value, r"bufferViews\[2\]|accessors\[1\]") for value in [*HUGE, 8]),
    *((f"bufferViews.{VIEW}.byteStride", value, r"byteStride|accessors\[1\]") for value in [*HUGE, 0, 4, 16]),
    *((f"bufferViews.{VIEW}.buffer", value, r"bufferViews\[2\].buffer") for value in [*HUGE, 1]),
    *((f"accessors.{POSITION}.componentType", value, r"accessors\[1\]|positions") for value in [*HUGE, 5124, 5125]),
    *((f"accessors.{POSITION}.type", value, r"accessors\[1\]|positions") for value in [*HUGE, "VEC4", "VEC2", "MAT4"]),
    *((f"accessors.{INDICES}.count", value, "indices") for value in [1, 17]),
    *(("buffers.0.byteLength", value, r"buffers\[0\]") for value in [*HUGE, 0]),
    *(("buffers.0.uri", value, r"buffers\[0\].uri") for value in ["../../etc/passwd", 3, "data:,", "a\0b"]),
    *((key, value, key) for key in ("accessors", "nodes", "meshes", "images", "skins") for value in [3, {}, [3]]),
    ("skins", [], r"nodes\[52\].skin"),
    ("nodes.10.children", [0], r"nodes\[0\]|cycle"),
    ("nodes.0.children", [1, 2, 3, 0], "cycle"),
    ("nodes.4.children", [1], r"nodes\[1\] should be the child of one node"),
    ("nodes.4.children", [-1], r"nodes\[4\].children"),
    ("nodes.4.children", 7, r"nodes\[4\].children"),
    ("nodes.4.translation", [0, 0], r"nodes\[4\].translation should be 3 numbers"),
    ("nodes.4.translation", [0, 0, 0], "default nodes of left_knee should be as the extension says"),
    ("nodes.4.rotation", [0, 0, 0, 0], r"nodes\[4\].rotation should be a unit quaternion"),
    ("nodes.4.scale", [1e29, 1e29, 1e29], "default nodes of left_knee"),
    ("nodes.4.name", "knee", "skin joint 4 should be .* left_knee, is 'knee'"),
    ("nodes.52.mesh", 1, "nodes should be one with the finest mesh"),
    ("skins.0.joints", list(range(51)), "skin joint 51 should be .*, is .absent"),
    ("skins.0.joints", [1, 0, *range(2, 52)], "skin joint 0 should be .* pelvis, is 'left_hip'"),
    ("skins.0.joints", [0] * 52, r"skins\[0\].joints should be different nodes"),
    ("skins.0.inverseBindMatrices", POSITION, "inverseBindMatrices should be 4x4"),
    ("meshes.0.primitives", [], r"meshes\[0\].primitives"),
    ("meshes.0.primitives.0.mode", 1, "triangles"),
    ("meshes.0.primitives.0.material", 9, "material"),
    ("meshes.0.primitives.0.attributes._VIEW_DIR", POSITION, r"levels\[0\].view_dir should be of unit length"),
    ("meshes.0.primitives.0.attributes._VIEW_SEEN", POSITION, r"_VIEW_SEEN should be 1 number and 2 of 0 for each"),
    ("meshes.0.primitives.0.attributes.JOINTS_0", WEIGHTS, r"levels\[0\].joints should be"),
    ("meshes.0.primitives.0.attributes.WEIGHTS_0", WEIGHTS - 1, "WEIGHTS_0 should be normalised"),
    ("meshes.0.primitives.0.attributes", {}, "attributes should be an object with POSITION"),
    ("materials.0.pbrMetallicRoughness", {}, "base colour texture"),
    ("images.0.bufferView", 0, r"images\[0\] should be a PNG"),
    ("asset.version", "1.0", "asset.version should be 2.x"),
    ("extensionsRequired", ["EXT_meshopt_compression"], "npx @gltf-transform/cli copy"),
    (f"{OURS}.version", 2, "version should be 1, is 2"),
    (f"{OURS}.canonicalPose", [0.0] * 156, "inverse bind matrices of left_hip should be as the extension says"),
    (f"{OURS}.canonicalPose", [1e29] * 156, "canonical_pose should be below"),
    (f"{OURS}.jointPositions", [0.0] * 156, "default nodes of left_foot should be as the extension says"),
    (f"{OURS}.jointPositions", [0.0] * 155, "jointPositions should be 156 numbers"),
    (f"{OURS}.network.w1", [0.0] * 127, r"network.w1 should be 128 numbers"),
    (f"{OURS}.network.w2", [0.0] * 47 + [None], r"network.w2 should be 48 finite numbers"),
    (f"{OURS}.network.b1", [0.0] * 15 + [1e20], "network.b1 should be below"),
    (f"{OURS}.network", [], "network should be an object"),
    (f"{OURS}.linear", [0.0] * 35, "linear should be 36 numbers"),
    (f"{OURS}.amplitude", 10**400, "a whole number of 401 digits"),
    (f"{OURS}.amplitude", True, "amplitude should be a number"),
    (f"{OURS}.amplitude", 1.01, "amplitude should be from 0 to 1"),
    (f"{OURS}.defaultView", "neural", "defaultView should be network, linear or off"),
    (f"{OURS}.defaultView", ["off"], "defaultView should be a str"),
    (f"{OURS}.levels", [], "levels should be a list"),
    (f"{OURS}.levels", [{"mesh": 0}] * 8, "levels should be with a mesh of their own each"),
    (f"{OURS}.levels", [{"mesh": 0, "featureImage": 0}], "levels should be with a image of their own each"),
    (f"{OURS}.levels", [{"mesh": 0, "featureImage": 2}], r"images\[2\] should be an 8-bit L PNG, is 8-bit RGB"),
    (f"{OURS}.network.w3", [0.0], r"network should be of w1, b1, w2, b2 alone, is \['w3'\]"),
    (f"{OURS}.network.b2", [0.0, 0.0, 1e999], r"JSON|network.b2"),
    (f"{OURS}.network.b2", [0.0, 0.0, 1e20], "network.b2 should be below"),
    (f"{OURS}.levels.0.featureImage", 99, r"levels\[0\].featureImage should be an index below"),
    (f"{OURS}.levels.0.featureImage", True, r"levels\[0\].featureImage"),
    (f"{OURS}.levels.0.featureImage", "2", r"levels\[0\].featureImage"),
    (f"{OURS}.levels", [{"mesh": 9}], r"levels\[0\].mesh should be an index below 2"),
    (f"{OURS}.provenance", 5, "provenance should be a dict"),
]  # fmt: skip


@pytest.mark.parametrize("place, value, match", LIES)
def test_a_lie_in_the_json_is_named(path, whole, place, value, match):
    refused(path, lying(whole, place, value), match, memory=isinstance(value, int) and value >= 2**29)


@pytest.mark.parametrize("place", [f"{OURS}.{key}" for key in ("network.w1", "linear", "levels", "amplitude")])
def test_every_part_of_the_extension_may_be_absent_only_where_it_is_optional(path, whole, place):
    if place.endswith("linear"):
        path.write_bytes(lying(whole, place))
        assert read_avatar(path).linear is None
    else:
        refused(path, lying(whole, place), place.rpartition(".")[2])


FACE_LIES = [
    (f"{OURS}.face", 3, r"face should be an object of version 1"),
    (f"{OURS}.face.version", 2, r"face should be an object of version 1"),
    (f"{OURS}.face.eyes", [{}], "the left and the right one"),
    (f"{OURS}.face.eyes.1.center", [0, 0], r"eyes\[1\].center should be 3 numbers"),
    (f"{OURS}.face.eyes.1.center", [0, 0, 0], "of right_eye should be as the extension says"),
    (f"{OURS}.face.eyes.0.axis", [0, 0, 2], "eyes.left.axis should be of unit length"),
    *((f"{OURS}.face.eyes.0.radius", value, "radius should be") for value in [None, True, 0, 1e9, "1"]),
    *((f"{OURS}.levels.0.balls", value, r"balls should be") for value in [3, [8, 2, 10], [8, 2, 10, 3], [8, 2, -1, 2],
      [8.5, 2, 10, 2], [8, 0, 10, 2]]),
    (f"{OURS}.levels.0.balls", [6, 2, 10, 2], "of the left ball left_eye alone"),
    (f"{OURS}.levels.0.balls", [8, 1, 10, 2], "of the balls alone those of the eyes, is 'vertex 9'"),
    (f"{OURS}.levels.1.balls", [1, 1, 2, 2], "of the balls alone those of the eyes"),
    *((f"{OURS}.levels.1.follow", value, "follow should be an object") for value in [3, []]),
    (f"{OURS}.levels.0.follow", {}, "follow should be an object, of a level below"),
    *((f"{OURS}.levels.1.follow.{key}", value, rf"follow.{key} should be")
      for key in ("vertices", "sources", "weights") for value in [*HUGE, "0"]),
    *((f"{OURS}.levels.1.follow.{key}", 0, r"follow should be at most 32768 rows")
      for key in ("vertices", "sources", "weights")),
    ("meshes.0.extras.targetNames.3", "smile", "targetNames should be ARKit's 52 names"),
    ("meshes.0.extras", [], "targetNames should be ARKit's 52 names"),
    ("meshes.0.primitives.0.targets", [{}], "targets should be a list of 52 objects"),
    ("meshes.0.primitives.0.targets.7", {"NORMAL": 1}, r"targets\[7\] should be of POSITION alone"),
    ("meshes.0.primitives.0.targets.7.POSITION", 0, r"targets\[7\].POSITION should be \(12, 3\) floats"),
    ("skins.0.joints", list(range(52)), "skin joint 52 should be .* then the eyes, here left_eye, is .absent"),
    ("nodes.15.children", [53], "parent of right_eye should be head|child of one"),
    *((f"accessors.{TARGET}.count", value, rf"accessors\[{TARGET}\]|floats") for value in [*HUGE, 0, 11, 2**27]),
    *((f"accessors.{TARGET}.sparse", value, "sparse should be") for value in [3, {}, {"indices": {}}]),
    *((f"accessors.{TARGET}.sparse.count", value, "sparse") for value in [*HUGE, 0, 4, 2**27]),
    *((f"accessors.{TARGET}.sparse.indices.{key}", value, r"sparse.indices")
      for key in ("bufferView", "componentType", "byteOffset") for value in [*HUGE[:-4], 5126]),
    (f"accessors.{TARGET}.sparse.indices.componentType", 5121, r"sparse.indices should be ascending and below 12"),
]  # fmt: skip


@pytest.mark.parametrize("place, value, match", FACE_LIES)
def test_a_lie_about_a_face_is_named(path, place, value, match):
    write_avatar(path, tiny_face())
    refused(path, lying(path.read_bytes(), place, value), match)


SPOILT = [
    (POSITION, 20, struct.pack("<f", np.nan), r"accessors\[1\] should be finite, is nan at \(1, 2\)"),
    (POSITION, 20, struct.pack("<f", -np.inf), r"accessors\[1\] should be finite, is -inf at \(1, 2\)"),
    (WEIGHTS, 0, b"\0\0\0\xfe", r"levels\[0\].weights should be a sum of 255, is \[0, 0, 0, 254\] in row 0"),
    (WEIGHTS, 8, b"\xff\xff\xff\xff", r"levels\[0\].weights should be a sum of 255"),
    (4, 4, b"\0\1\2\x34", r"levels\[0\].joints should be below 52, is \[0, 1, 2, 52\] in row 1"),
    (6, 0, struct.pack("<3f", 0, 0, 0), r"levels\[0\].view_dir should be of unit length"),
    (INDICES, 2, b"\xff\xff", r"indices should be below the 8 vertices, is 65535"),
    (0, 4 * 64, struct.pack("<f", 3), "inverse bind matrices of knee|inverse bind matrices of left_knee"),
]


@pytest.mark.parametrize("accessor, offset, value, match", SPOILT)
def test_a_spoilt_value_is_named(path, whole, accessor, offset, value, match):
    document, binary = split_glb(whole)
    start = document["bufferViews"][document["accessors"][accessor]["bufferView"]]["byteOffset"] + offset
    binary[start : start + len(value)] = value
    refused(path, join_glb(document, binary), match, memory=False)


@pytest.mark.parametrize(
    "image, match",
    [
        (png(30000, 30000, b""), "images should be at most 67108864 pixels together"),
        (png(2**31, 1, b""), r"images\[1\] should be 1 to 32768 pixels a side"),
        (png(0, 4, b""), r"images\[1\] should be 1 to 32768 pixels a side"),
        (png(2, 8, bytes(10**7)), r"images\[1\] should be a whole PNG"),
        (png(2, 8, b"\0\1\2"), r"images\[1\] should be a whole PNG"),
        (png(2, 3, b"\0\1\2" * 3), r"images\[1\] height should be four planes, is 3"),
        (b"\x89PNG\r\n\x1a\n", r"images\[1\] should be a PNG"),
        (b"\xff\xd8\xff\xe0", r"images\[1\] should be a PNG"),
        (b"GIF89a" + bytes(40), r"images\[1\] should be a PNG, JPEG or WebP image"),
    ],
)
def test_an_image_that_lies_is_refused_before_it_costs(path, whole, image, match):
    document, binary = split_glb(whole)
    view = document["bufferViews"][document["images"][1]["bufferView"]]
    view["byteOffset"], view["byteLength"] = len(binary), len(image)
    binary += image + bytes(-len(image) % 4)
    document["buffers"][0]["byteLength"] = len(binary)
    refused(path, join_glb(document, binary), match)


@pytest.mark.parametrize(
    "text",
    ["", "[]", "nul", "[" * 100_000, '{"a":' * 100_000, "[" + "0," * 3_000_000 + "0]", '{"asset":NaN}', "9" * 5000],
)
def test_json_that_is_no_gltf_is_refused(path, text):
    refused(path, join_glb(text, b"\0\0\0\0"), "JSON|asset.version")


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999", "-1e999"])
def test_numbers_beyond_floats_are_refused(path, whole, number):
    document, binary = split_glb(whole)
    document["nodes"][3]["translation"][1] = "HERE"
    text = json.dumps(document).replace('"HERE"', number)
    refused(path, join_glb(text, binary), r"JSON|nodes\[3\].translation should be 3 finite numbers")


@pytest.mark.parametrize(
    "accessor",
    [
        {"componentType": 5126, "type": "VEC3", "count": 2**29},
        {"componentType": 5126, "type": "VEC3", "count": 8, "sparse": []},
    ],
)
def test_accessors_without_bytes_of_their_own_cannot_ask_for_much(path, whole, accessor):
    refused(path, lying(whole, f"accessors.{POSITION}", accessor), r"accessors\[1\]")


def test_channels_that_share_a_sampler_hold_its_keys_once(tmp_path):
    """300 channels of one sampler of half a million keys took 3.5 GB."""
    keys = 200_000
    times, values = np.arange(keys, dtype="<f4"), np.tile(np.array([0, 0, 0, 1], "<f4"), (keys, 1))
    binary = memoryview(times.tobytes() + values.tobytes())
    document = {
        "nodes": [{} for _ in range(300)],
        "bufferViews": [
            {"buffer": 0, "byteLength": times.nbytes},
            {"buffer": 0, "byteOffset": times.nbytes, "byteLength": values.nbytes},
        ],
        "buffers": [{"byteLength": len(binary)}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "type": "SCALAR", "count": keys},
            {"bufferView": 1, "componentType": 5126, "type": "VEC4", "count": keys},
        ],
        "animations": [{
            "samplers": [{"input": 0, "output": 1}],
            "channels": [{"sampler": 0, "target": {"node": n, "path": "rotation"}} for n in range(300)],
        }],
    }  # fmt: skip
    gltf = Gltf(tmp_path / "a.glb", document, (binary,))
    wanted = {(n, "rotation"): (n, 4) for n in range(300)}
    with at_most(BYTES):
        channels = _channels(gltf, wanted, [])
    assert len(channels) == 300 and isinstance(channels[0, "rotation"], Channel)
    many = document["animations"][0]
    many["samplers"] = [{"input": 0, "output": 1}] * 300
    for n, channel in enumerate(many["channels"]):
        channel["sampler"] = n
    with pytest.raises(AssetError, match="keys of at most"):
        _channels(gltf, wanted, [])


@pytest.mark.skipif(not os.path.exists("/proc/self/maps"), reason="no files of the system")
def test_files_of_the_system_that_claim_to_be_empty_are_refused_before_they_are_read():
    """Reading some of them waits for ever."""
    with pytest.raises(AssetError, match="found an empty file"):
        read_bytes("/proc/self/maps", "a camera")


def camera(**changes) -> bytes:
    honest = {"size": [64, 48], "K": [[50, 0, 32], [0, 50, 24], [0, 0, 1]], "camera_from_world": np.eye(4).tolist()}
    return json.dumps(honest | changes).encode()


def motion(**more) -> bytes:
    out = BytesIO()
    np.savez(out, poses=np.zeros((2, 156)), trans=np.zeros((2, 3)), **more)
    return out.getvalue()


ACTOR = '[[avatar]]\npath = "mannequin"\n'
BEYOND = [
    ("a.json", camera(K=[[50, 0, 32], [0, 50, 24], [0, 0, 2]]), "its lower rows are"),
    ("a.json", camera(K=[[50, 0, 32], [3, 50, 24], [0, 0, 1]]), "its lower rows are"),
    ("a.json", camera(K=[[1e200, 0, 32], [0, 50, 24], [0, 0, 1]]), "K should be below 1e"),
    ("a.json", camera(K=[[10**400, 0, 32], [0, 50, 24], [0, 0, 1]]), "a whole number of 401 digits"),
    ("a.json", camera(camera_from_world=np.eye(4)[[0, 1, 2, 2]].tolist()), "should end in the row 0 0 0 1"),
    ("a.json", camera(camera_from_world=(np.eye(4) + 1e300 * np.eye(4, k=3)).tolist()), "should be below"),
    ("a.json", camera(size=[10**200, 48]), "size should be"),
    ("a.json", camera(size=[0, 5]), "size should be"),
    ("a.json", camera(K=[[0, 0, 1], [0, 1, 1], [0, 0, 1]]), "focal length should be positive"),
    ("a.json", camera(camera_from_world=np.diag([1.0, 1, -1, 1]).tolist()), "should hold a rotation"),
    ("a.json", camera(K="x"), "K should be numbers"),
    ("a.json", camera(K=[[1, 2], [3]]), "K should be numbers"),
    ("a.npz", motion(mocap_framerate=1e-5), "mocap_framerate"),
    ("a.npz", motion(mocap_framerate=1e300), "mocap_framerate"),
    ("a.npz", motion(mocap_framerate=5e-324), "mocap_framerate"),
    ("a.npz", motion(pelvis_height=1e-320), "pelvis_height"),
    ("a.npz", motion(pelvis_height=1e300), "pelvis_height"),
    ("a.npz", motion(face=np.zeros((2, 51))), "face should be"),
    ("a.npz", motion(betas=1e300), "betas"),
    ("a.toml", f"rate = 1e-5\n{ACTOR}".encode(), "rate: expected at least"),
    ("a.toml", f"rate = 1e5\n{ACTOR}".encode(), "rate: expected at most"),
    ("a.toml", f"{ACTOR}[[camera]]\nseconds = 5e-324".encode(), "seconds: expected at least"),
    ("a.toml", f"{ACTOR}[[camera]]\nfov_deg = 5e-324".encode(), "fov_deg: expected"),
    ("a.toml", (ACTOR * 301).encode(), "expected at most 256 .*, found 301"),
    # the parser of TOML takes the square of a key's parts
    ("a.toml", ("a" + ".a" * 100_000 + " = 1\n").encode(), "dots in a line"),
]


@pytest.mark.parametrize("name, data, match", BEYOND, ids=[match for *_, match in BEYOND])
def test_what_no_camera_motion_or_film_can_have_is_named_at_once(tmp_path, name, data, match):
    read = {".json": read_camera, ".npz": read_motion, ".toml": read_scene}[Path(name).suffix]
    (tmp_path / name).write_bytes(data)
    started = time.process_time()
    with pytest.raises(AssetError, match=match):
        read(tmp_path / name)
    assert time.process_time() - started < 1
