"""Every reader of files from outside, given its own file cut, flipped, with absurd numbers and wrong types.

Each is read, and then keeps what its reader promises, or is refused: one short line that names the file, within
seconds and little memory. FORMATS lists the readers; what only one of them can get wrong has its tests beside it.
"""

import json
import os
import pickle
import random
import re
import time
import tracemalloc
import wave
from collections.abc import Callable
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from foreign_layouts import write_colmap
from pictures import film, radiance_bytes
from PIL import Image
from pose_twins import landmarks, points, sam3d_fields
from rigs import animated_glb, rigged_glb
from smplh_model import write_model
from tiny_avatar import join_glb, split_glb, tiny_avatar, tiny_face

from avatar.baked_avatar import check_avatar
from avatar.body import builtin_body, read_body
from avatar.camera import Camera, pinhole, read_camera
from avatar.face import SHAPES
from avatar.gltf.avatar_file import read_avatar, write_avatar
from avatar.head_landmarks import read_head_landmarks
from avatar.motion.bvh_write import write_bvh
from avatar.motion.clip import Clip
from avatar.motion.face_csv import HEAD
from avatar.motion.read import read_motion
from capture.folder import read_subject, write_subject
from capture.keypoints.orders import described
from capture.keypoints.read import read_keypoints
from capture.own_face import OwnFace, read_own_face
from capture.read.colmap import _images, _lenses
from capture.read.landmarks import read_pixels
from capture.read.opencv_yaml import read_opencv_yaml
from command.errors import AssetError
from experiments.fuzz_mutators import mutated, noise
from files.npz import read_npy, read_npz
from files.picture import WITH_WEBP, read_picture
from files.sound import read_wav
from files.unpickle import read_pickle
from player.effects.background import Background, opened_source
from player.effects.radiance import read_radiance
from player.face.speech import Speech
from player.scene.camera_path import CameraPath
from player.scene.scene_file import read_scene
from synth.subject import read_subject as read_rigged_subject

# Seconds of processor time, since a loaded machine is no defect, and bytes
SECONDS, BYTES = 2.0, 64 << 20


class Format(NamedTuple):
    """A kind of file: an honest one, what reads it, and how many of a hundred damaged ones are refused at least."""

    name: str
    whole: Callable[[Path], bytes]
    read: Callable[[Path], object]
    refused: int = 15
    text: bool = False
    # Some beginnings of it are files of their own
    parts: bool = False
    # JSON of the file and the file of a JSON, where every value is tried with wrong types
    split: Callable[[bytes], tuple] | None = None
    join: Callable[..., bytes] | None = None


def written(write: Callable[[Path], object]) -> Callable[[Path], bytes]:
    """The bytes of what a function writes to a path."""

    def whole(folder: Path) -> bytes:
        write(folder / "honest")
        return next(folder.glob("honest*")).read_bytes()

    return whole


def finite_motion(path: Path) -> None:
    motion = read_motion(path)
    clip = motion.read(0, min(motion.frames, 50))
    assert np.isfinite(clip.axis_angle).all() and np.isfinite(clip.root).all()
    assert clip.face is None or (clip.face.min() >= 0 and clip.face.max() <= 1 and np.isfinite(clip.gaze).all())


def checked(path: Path) -> None:
    check_avatar(read_avatar(path))


def archive(write) -> Callable[[Path], bytes]:
    poses = np.random.default_rng(1).normal(size=(4, 156))
    return written(lambda path: write(path, poses=poses, trans=np.zeros((4, 3)), mocap_framerate=30.0))


def sequence(protocol: int) -> Callable[[Path], bytes]:
    fields = {"poses": np.random.default_rng(4).normal(size=(3, 72)), "trans": np.zeros((3, 3)), "betas": np.zeros(10)}
    return lambda _: pickle.dumps(fields | {"gender": "male", "fps": 30.0, "n": [1, 2.5, (3, b"x")]}, protocol)


def picture(kind: str) -> Callable[[Path], bytes]:
    pixels = np.random.default_rng(0).integers(0, 256, (30, 40, 3), np.uint8)

    def whole(_: Path) -> bytes:
        out = BytesIO()
        Image.fromarray(pixels).save(out, kind)
        return out.getvalue()

    return whole


def any_picture(path: Path) -> None:
    read_picture(path, formats=WITH_WEBP)


def shown(path: Path) -> None:
    source = opened_source(Background("video", path=str(path)))
    for seconds in (0.0, 0.9, 1e9):
        source.pixels(seconds, (16, 12))
    source.close()


def surface(path: Path) -> None:
    from train.run import read_surface

    read_surface(path)


def surface_bytes(folder: Path) -> bytes:
    run = pytest.importorskip("train.run", reason="torch is not installed")
    rows = {name: np.full((4, *c), 0.25).astype(kind) for name, (kind, c) in run.SURFACE.items()}
    return written(lambda path: np.savez(path, **(rows | {"faces": np.zeros((2, 3), np.uint32)})))(folder)


def pickled_model(folder: Path) -> bytes:
    return pickle.dumps(dict(np.load(write_model(folder / "model.npz"))), 2)


def subject_bytes(folder: Path) -> bytes:
    from painted_capture import free_subject

    return written(lambda path: write_subject(path.with_suffix(".npz"), free_subject("male")))(folder)


def mediapipe_bytes(_: Path) -> bytes:
    body, left, right, _ = landmarks(np.zeros((1, 52, 3)), builtin_body("male").joints, np.zeros((1, 3)))
    frame = {"pose_world_landmarks": points(body[0]), "left_hand_world_landmarks": points(left[0])}
    return json.dumps({"frames": [frame | {"right_hand_world_landmarks": points(right[0])}]}).encode()


def faces_bytes(_: Path) -> bytes:
    scores = [{"category_name": name, "score": 0.01 * k, "index": k} for k, name in enumerate(SHAPES)]
    frame = {"face_blendshapes": [scores], "facial_transformation_matrixes": [np.eye(4).tolist()]}
    return json.dumps({"frames": [frame], "fps": 25}).encode()


def table_bytes(_: Path) -> bytes:
    rows = [f"10:00:00:{k:02}.5,61," + ",".join(f"{0.01 * (i + k):.2f}" for i in range(55)) for k in range(3)]
    return "\n".join([",".join(["Timecode", "BlendShapeCount", *SHAPES, *HEAD]), *rows]).encode()


def voice_bytes(folder: Path) -> bytes:
    with wave.open(str(folder / "honest.wav"), "wb") as file:
        file.setparams((1, 2, 16_000, 0, "NONE", ""))
        file.writeframes(np.random.default_rng(0).integers(-9999, 9999, 4000).astype("<i2").tobytes())
    return (folder / "honest.wav").read_bytes()


def spoken(path: Path) -> None:
    weights = Speech(read_wav(path)).frames
    assert weights.min() >= 0 and weights.max() <= 1


def found(path: Path) -> None:
    keypoints = read_keypoints(path, frames=9)
    assert np.isfinite(keypoints.pixels[keypoints.confidence > 0]).all() and len(described(keypoints)) < 200


def sam3d_bytes(folder: Path) -> bytes:
    return written(lambda path: np.savez(path, **sam3d_fields(np.zeros((1, 52, 3)), np.zeros((1, 3)))))(folder)


def standing(path: Path) -> None:
    write_bvh(path, Clip(np.zeros((2, 52, 3)), np.zeros((2, 3)), 30.0), builtin_body("male").joints)


def objects(path: Path) -> None:
    np.save(path, np.array({"a": np.arange(3)}, object), allow_pickle=True)


def colmap(name: str) -> Callable[[Path], bytes]:
    filmed: Any = SimpleNamespace(videos={"head": SimpleNamespace(cameras=[LENS, LENS])})
    return lambda folder: (write_colmap(filmed, folder / "model") / name).read_bytes()


LENS = Camera(pinhole((64, 48), 0.6), np.eye(4), (64, 48))
CAMERA = {"size": [64, 48], "K": [[50, 0, 32], [0, 50, 24], [0, 0, 1]], "camera_from_world": np.eye(4).tolist()}
KEYS = [{"t": 0, "eye": [0, 1, 3], "target": [0, 1, 0]}, {"t": 2.5, "eye": [1, 1, 3], "target": [0, 1, 0]}]
SHOWN = {"pose_landmarks": [{"x": 0.25, "y": 0.5, "z": 0, "visibility": 0.5}] * 33}
IN_PICTURE = {"image_width": 64, "image_height": 48, "frames": [None, SHOWN]}
FACE = {"points": {n: [k, k * k, 1.5] for k, n in enumerate("abcdef")}, "vertices": dict.fromkeys("abcdef", 3)}
LANDMARKS = {"pixels": {"nose_tip": {"a.png": [1, 2], "b.png": [3.5, 4]}}, "vertices": {"mole": 7}}
PERSON = [{"id": 0, "Rh": [[0.1, 0, 0]], "Th": [[0, 1, 0]], "poses": [[0.1] * 72], "shapes": [[0.0] * 10]}]
POINTS = (np.random.default_rng(3).uniform(0, 1, (25, 3)) * (900, 400, 1)).round(3).ravel().tolist()
NESTED = {"keypoints": [[9.5, 3], [4, 5]] * 13, "keypoint_scores": [0.5, 1] * 13}
SCENE = b'size = [64, 48]\nrate = 25.0\n[[avatar]]\nfile = "a.toml"\n[[camera]]\nkind = "orbit"\n'
YAML = b'%YAML:1.0\nnames:\n   - "1"\nK_1: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: d\n   data: [1., 2.]\n'
OWN_FACE = OwnFace(np.full(10, 0.9), np.zeros(10), teeth=np.array([1.1, 1.2, 1.3])).json()
JSON = {"text": True, "split": lambda data: (json.loads(data),), "join": lambda value: json.dumps(value).encode()}
GLTF = {"split": split_glb, "join": join_glb}


def plain(content: object) -> Callable[[Path], bytes]:
    return lambda _: content if isinstance(content, bytes) else json.dumps(content).encode()


FORMATS = {
    "avatar": Format("a.glb", written(lambda path: write_avatar(path, tiny_avatar())), checked, **GLTF),
    "avatar with a face": Format("a.glb", written(lambda path: write_avatar(path, tiny_face())), checked, **GLTF),
    "animation": Format("b.glb", lambda _: join_glb(*animated_glb()), finite_motion, **GLTF),
    "npz": Format("a.npz", archive(np.savez), finite_motion, 80),
    "deflated npz": Format("a.npz", archive(np.savez_compressed), finite_motion, 80),
    "arrays": Format("a.npz", archive(np.savez), lambda p: read_npz(p, "poses", ("poses", "trans")), 50),
    "surface": Format("surface.npz", surface_bytes, surface, 50),
    "npy": Format("a.npy", written(lambda path: np.save(path, np.arange(4.0))), lambda p: read_npy(p, "numbers")),
    "npy of objects": Format("a.npy", written(objects), lambda p: read_npy(p, "a record")),
    **{f"pickle {n}": Format("a.pkl", sequence(n), lambda p: read_pickle(p, "data")) for n in range(6)},
    **{f"sequence {n}": Format("a.pkl", sequence(n), finite_motion) for n in (0, 2, 5)},
    "bvh": Format("a.bvh", written(standing), finite_motion, parts=True),
    "EasyMocap": Format("000000.json", plain(PERSON), finite_motion, **JSON),
    "MediaPipe": Format("a.json", mediapipe_bytes, finite_motion, **JSON),
    "MediaPipe's scores": Format("a.json", faces_bytes, finite_motion, **JSON),
    "table of faces": Format("a.csv", table_bytes, finite_motion, text=True, parts=True),
    "sound": Format("a.wav", voice_bytes, spoken, 2, parts=True),
    "OpenPose's keypoints": Format("a.json", plain({"people": [{"pose_keypoints_2d": POINTS}] * 2}), found, **JSON),
    "results of keypoints": Format("a.json", plain([{"image_id": "1.jpg", "keypoints": POINTS}] * 2), found, **JSON),
    "MMPose's keypoints": Format("a.json", plain({"instance_info": [{"instances": [NESTED]}]}), found, **JSON),
    "SAM 3D Body": Format("a.npz", sam3d_bytes, finite_motion, 80),
    "camera": Format("camera.json", plain(CAMERA), read_camera, **JSON),
    "camera path": Format("path.json", plain({"keys": KEYS}), CameraPath.read, **JSON),
    "landmarks": Format("landmarks.json", plain(LANDMARKS), read_pixels, **JSON),
    "film of a face": Format("face.json", plain(OWN_FACE), read_own_face, **JSON),
    "scene": Format("scene.toml", plain(SCENE), read_scene, text=True, parts=True),
    "body model": Format("model.npz", written(lambda path: write_model(path.with_suffix(".npz"))), read_body, 50),
    "pickled body model": Format("model.pkl", pickled_model, read_body, 2),
    "subject": Format("subject.npz", subject_bytes, read_subject, 30),
    "rigged subject": Format("a.glb", lambda _: join_glb(*rigged_glb()), read_rigged_subject, 2, **GLTF),
    "landmarks in the picture": Format("0.json", plain(IN_PICTURE), read_keypoints, **JSON),
    "landmarks of a head": Format("landmarks.json", plain(FACE), lambda p: read_head_landmarks(p, 9), **JSON),
    "COLMAP cameras": Format("cameras.bin", colmap("cameras.bin"), _lenses),
    "COLMAP images": Format("images.bin", colmap("images.bin"), lambda p: _images(p, {3: LENS})),
    "OpenCV": Format("intri.yml", plain(YAML), read_opencv_yaml, text=True, parts=True),
    "sky": Format("sky.hdr", plain(radiance_bytes(np.ones((8, 16, 3)))), read_radiance),
    **{name: Format("a.bin", picture(name), any_picture, 2, parts=True) for name in WITH_WEBP},
    "mp4": Format("a.mp4", written(lambda path: film(path.with_suffix(".mp4"))), shown, 10, parts=True),
    "avi": Format("a.avi", written(lambda path: film(path.with_suffix(".avi"))), shown, 2, parts=True),
    "mkv": Format("a.mkv", written(lambda path: film(path.with_suffix(".mkv"))), shown, 2, parts=True),
}  # fmt: skip
every_format = pytest.mark.parametrize("kind", FORMATS)


def hostile(kind: Format, path: Path, data: bytes | None = None) -> bool:
    """Whether it is refused, soon, by its name and in one line; no other error is raised. None: what lies there."""
    if data is not None:
        path.write_bytes(data)
    began = time.process_time()
    try:
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            kind.read(path)
        refused = False
    except AssetError as error:
        message = str(error)
        assert path.name in message and message.isprintable() and len(message) < 600 + len(str(path))
        refused = True
    assert time.process_time() - began < SECONDS
    return refused


@every_format
def test_an_honest_file_is_read_and_any_beginning_of_it_is_read_or_one_line(tmp_path, kind):
    kind = FORMATS[kind]
    whole = kind.whole(tmp_path)
    # a scene names an avatar that is not there
    assert not hostile(kind, tmp_path / kind.name, whole) or kind.name == "scene.toml"
    ends = [*range(min(64, len(whole))), *np.random.default_rng(7).integers(0, len(whole), 64)]
    refused = [hostile(kind, tmp_path / kind.name, whole[:end]) for end in ends]
    assert (sum(refused) > len(ends) // 4) if kind.parts else all(refused)


@every_format
def test_flipped_bytes_are_read_or_one_line(tmp_path, kind):
    kind = FORMATS[kind]
    whole, rng = kind.whole(tmp_path), np.random.default_rng(6)
    # the first and the last bytes are most of what a reader goes by
    ends = (min(len(whole), 2000), max(len(whole) - 2000, 0))
    refused = 0
    for n in range(100):
        data = bytearray(whole)
        low, high = ((0, ends[0]), (ends[1], len(whole)), (0, len(whole)))[n % 3]
        for place in rng.integers(low, high, 1 + n % 4):
            data[place] = rng.choice(list(b'0123456789.-+eE[]{}",:\n ')) if kind.text and n % 2 else rng.integers(256)
        refused += hostile(kind, tmp_path / kind.name, bytes(data))
    assert refused >= kind.refused


@pytest.mark.rows
@every_format
def test_what_lies_behind_lengths_and_checksums_may_be_wrong(tmp_path, within, kind):
    """Some of what experiments/fuzz.py tries by the million: mutators that mend both."""
    kind, rng = FORMATS[kind], random.Random(11)
    whole, strays = kind.whole(tmp_path), []
    for number in range(40):
        data = whole
        for _ in range(1 + number % 3):
            data = mutated(data, rng, noise(rng), text=kind.text)
        try:
            hostile(kind, tmp_path / kind.name, data)
        except Exception as error:
            strays.append(f"{type(error).__name__}: {error}, input {number}")
    assert not strays, strays
    within(len(strays), 0, "stray exceptions of 40 mended files")


@pytest.mark.parametrize("kind", [name for name, kind in FORMATS.items() if kind.text])
def test_every_number_may_be_absurd(tmp_path, kind):
    kind = FORMATS[kind]
    whole = kind.whole(tmp_path)
    absurd = (b"1e308", b"-1e308", b"5e-324", b"1e999", b"9" * 400, b"9" * 6000, b"-1", b"0", b"nan", b"[1]", b'"1"')
    for match in list(re.finditer(rb"\d+(\.\d+)?", whole))[:25]:
        for number in absurd:
            hostile(kind, tmp_path / kind.name, whole[: match.start()] + number + whole[match.end() :])


WRONG = [None, True, -1, 0, 1, 52, 5126, 2**40, 10**400, 1e29, -0.5, 2**70, "", "VEC3", "x\x1b[2J\x07", [], {}, [0],
         [[]], {"a": 1}]  # fmt: skip


def places(value) -> list:
    """Every (holder, key) below a JSON value."""
    keys = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    return [found for key in keys for found in [(value, key), *places(value[key])]]


@pytest.mark.parametrize("kind", [name for name, kind in FORMATS.items() if kind.split])
def test_any_value_may_be_of_a_wrong_type(tmp_path, kind):
    kind, rng = FORMATS[kind], random.Random(3)
    whole, refused = kind.whole(tmp_path), 0
    assert kind.split is not None and kind.join is not None
    _, *rest = kind.split(whole)
    for root in WRONG:
        assert hostile(kind, tmp_path / kind.name, kind.join(root, *rest))
    tries = 60 if kind.read is checked else 200
    for _ in range(tries):
        document, *rest = kind.split(whole)
        holder, key = rng.choice(places(document))
        other, other_key = rng.choice(places(document))
        holder[key] = json.loads(json.dumps(other[other_key])) if rng.random() < 0.2 else rng.choice(WRONG)
        refused += hostile(kind, tmp_path / kind.name, kind.join(document, *rest))
    assert refused > tries / 5


@every_format
def test_devices_pipes_folders_and_deep_or_endless_text_are_refused_at_once(tmp_path, kind):
    kind = FORMATS[kind]
    ending = Path(kind.name).suffix
    os.mkfifo(tmp_path / f"pipe{ending}")
    os.symlink("/dev/zero", tmp_path / f"zero{ending}")
    (tmp_path / f"folder{ending}").mkdir()
    (tmp_path / f"deep{ending}").write_bytes(b"a = " * (ending == ".toml") + b"[" * 200_000)
    (tmp_path / f"many{ending}").write_bytes(b"[" + b"0," * 3_000_000 + b"0]")
    (tmp_path / f"empty{ending}").touch()
    with suppress(AssetError):
        # what a reader imports costs seconds once
        kind.read(tmp_path / f"empty{ending}")
    tracemalloc.start()
    for name in ("pipe", "zero", "folder", "deep", "empty", "absent"):
        assert hostile(kind, tmp_path / f"{name}{ending}"), name
    assert tracemalloc.get_traced_memory()[1] < BYTES
    tracemalloc.stop()
    assert hostile(kind, tmp_path / f"many{ending}")
