"""Faults that were found once: each is refused soon, in one line that names file and field, before memory is taken."""

import json
import os
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from memory_use import at_most
from painted_capture import free_subject
from pictures import film
from smplh_model import write_model
from tiny import TINY

from avatar.body import read_body
from avatar.motion.read import read_motion
from capture.folder import read_capture
from capture.keypoints.read import read_keypoints
from capture.raw.video_file import open_video
from command.errors import AssetError
from player.effects.background import Background, opened_source
from player.scene.capture_view import head_from_world
from player.scene.scene_file import read_scene
from train.run import SURFACE, build_field, read_part, read_surface, write_part
from train.template_grid import TemplateGrid

POINTS = {"pose_landmarks": [{"x": 0.25, "y": 0.5, "z": 0}] * 33}
NOBODY = '{"instances": []}'
FACE = {"points": {n: [k, k * k, 1.5] for k, n in enumerate("abcdef")}, "vertices": dict.fromkeys("abcdef", 3)}


def refused(read: Callable[[Path], object], path: Path, message: str, most: float = 64 << 20) -> None:
    """Refused by the file's name and this message, one line, with at most so many bytes on the way."""
    with at_most(most), pytest.raises(AssetError, match=message) as caught:
        read(path)
    assert path.name in str(caught.value) and str(caught.value).isprintable()


@pytest.mark.parametrize("code", [b"encv", b"zzzz", b"mp4a"])
def test_a_film_that_is_encrypted_or_in_an_unknown_code_is_refused_by_every_reader(tmp_path, code):
    film(tmp_path / "a.mp4")
    data = (tmp_path / "a.mp4").read_bytes()
    assert b"avc1" in data
    (tmp_path / "a.mp4").write_bytes(data.replace(b"avc1", code))
    for read in (open_video, lambda path: opened_source(Background("video", path=str(path)))):
        refused(read, tmp_path / "a.mp4", "found a film in a code that is not read here")


@pytest.mark.parametrize("size", [(2048, 64), (64, 2048), (8000, 16)])
def test_a_film_longer_than_any_phones_is_refused_before_it_is_looked_at(tmp_path, size):
    film(tmp_path / "a.mp4", [np.zeros((size[1], size[0], 3), np.uint8)])
    refused(open_video, tmp_path / "a.mp4", f"4 times as long as wide, found {size[0]} x {size[1]}")


@pytest.mark.parametrize(
    "text",
    [
        '{"instance_info": [' + f"{NOBODY}, " * 60_000 + NOBODY + "]}",
        '{"image_width": 9, "image_height": 9, "frames": [' + json.dumps(POINTS) + ", null" * 60_000 + "]}",
        '{"image_width": 9, "image_height": 9, "frames": [' + json.dumps(POINTS) + ", null" * 900_000 + "]}",
    ],
    ids=["nobody", "null", "a million null"],
)
def test_empty_frames_take_no_memory(tmp_path, text):
    path = tmp_path / "a.json"
    path.write_text(text)
    refused(read_keypoints, path, r"at most 54000 frames, found 6000\d|1 to 216000")
    refused(read_motion, path, "hips and shoulders|frames|EasyMocap", 128 << 20)


@pytest.mark.parametrize("far", ["1e17", "-1e17", "1.001e6"])
def test_an_avatar_where_a_pixel_is_more_than_numbers_tell_apart_is_refused(tmp_path, far):
    (tmp_path / "a.toml").write_text(f'[[avatar]]\npath = "builtin"\nat = [0.0, {far}, 0.0]\n')
    refused(read_scene, tmp_path / "a.toml", r"a\.toml:3: avatar 1\.at: expected at (most 1e\+06|least -1e\+06)")


@pytest.fixture(scope="module")
def part():
    """Subject, and a field of its body with few weights."""
    subject = free_subject("male")
    template = TemplateGrid(torch.zeros(2, 2, 2), torch.zeros(3), 0.1)
    return subject, build_field(subject, 0, TINY.parts[0], template, 3)


def test_a_trained_part_comes_back_to_the_bit(tmp_path, part):
    write_part(tmp_path / "body.pt", part[1])
    back = read_part(tmp_path / "body.pt", part[0], 0, TINY.parts[0]).state_dict()
    assert all(torch.equal(back[name], value) for name, value in part[1].state_dict().items())


def _packed(path: Path) -> None:
    with zipfile.ZipFile(path) as plain, zipfile.ZipFile(path.with_name("packed"), "w", zipfile.ZIP_DEFLATED) as packed:
        for name in plain.namelist():
            packed.writestr(name, plain.read(name))
    path.with_name("packed").replace(path)


def _spread(path: Path) -> None:
    torch.save({"state": {"template.values": torch.zeros(1).expand(9999, 9999, 99)}, "cell": 1.0, "frames": 3}, path)


def _of_frames(path: Path) -> None:
    torch.save(torch.load(path, weights_only=True) | {"frames": 10_000_000}, path)


def _fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize(
    "spoil, message",
    [
        (lambda path: path.write_bytes(b""), "an empty file"),
        (_fifo, "is a device, pipe or socket"),
        (lambda path: path.write_bytes(b"\x80\x02}q\x00."), "found: "),
        (_packed, "found: an archive that is packed"),
        (_spread, "found: tensors of 39\\d* bytes in a file"),
        (_of_frames, r"the preset has torch\.Size\(\[10000000, 8\]\)"),
    ],
)
def test_what_is_no_trained_part_is_refused_before_memory_is_taken(tmp_path, part, spoil, message):
    write_part(tmp_path / "body.pt", part[1])
    spoil(tmp_path / "body.pt")
    refused(lambda path: read_part(path, part[0], 0, TINY.parts[0]), tmp_path / "body.pt", message)


def test_a_preset_of_ten_million_features_takes_no_memory(tmp_path, part):
    write_part(tmp_path / "body.pt", part[1])
    vast = replace(TINY.parts[0], networks=replace(TINY.parts[0].networks, feature=10_000_000, width=1 << 20))
    refused(lambda path: read_part(path, part[0], 0, vast), tmp_path / "body.pt", r"the preset has torch\.Size")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"vertices": 0, "faces": 0}, "faces should be triangles, one at least, are none"),
        ({"faces": 0}, "faces should be triangles, one at least, are none"),
        ({"vertices": 0}, "faces should index 0 vertices"),
        ({"skin_weights": np.zeros((4, 4))}, "skin_weights should be positive and sum to 1; row 0 sums to 0"),
        ({"skin_weights": np.full((4, 4), [2.0, -1, 0, 0])}, "skin_weights should be positive"),
        ({"skin_joints": np.full((4, 4), 52)}, "skin_joints should index 52 joints by whole numbers, holds 52 to 52"),
        ({"faces": np.full((2, 3), 0.5)}, "faces should index 4 vertices by whole numbers, holds 0.5 to 0.5"),
        ({"part": np.full(4, 9)}, "part should index 4 parts"),
    ],
)
def test_a_surface_without_a_mesh_or_without_bones_is_refused(tmp_path, change, message):
    vertices, faces = change.get("vertices", 4), change.get("faces", 2)
    counts = dict.fromkeys(SURFACE, vertices) | {"faces": 2 if isinstance(faces, np.ndarray) else faces}
    rows = {name: np.full((counts[name], *columns), 0.25).astype(kind) for name, (kind, columns) in SURFACE.items()}
    np.savez(tmp_path / "surface.npz", **(rows | {n: c for n, c in change.items() if isinstance(c, np.ndarray)}))
    refused(read_surface, tmp_path / "surface.npz", message)


@pytest.mark.parametrize("parts", [5, None, True, "body", {"body": 1}, [1]])
def test_parts_of_a_capture_that_are_no_list_are_named(tmp_path, parts):
    (tmp_path / "capture.json").write_text(json.dumps({"format": "selfscan-capture", "version": 1, "parts": parts}))
    with pytest.raises(AssetError, match=r"capture\.json: parts should hold \['body'"):
        read_capture(tmp_path)


@pytest.mark.parametrize("field", ["format", "version"])
def test_what_a_capture_says_is_quoted_in_short(tmp_path, field):
    said = {"format": "selfscan-capture", "version": 1} | {field: {"a": "b" * 100_000}}
    (tmp_path / "capture.json").write_text(json.dumps(said))
    with pytest.raises(AssetError, match=r"capture\.json: expected format 'selfscan-capture' version 1") as caught:
        read_capture(tmp_path)
    assert len(str(caught.value)) < 400 + len(str(tmp_path))


@pytest.mark.parametrize("vertex", [2**70, -1, 4, 1.5, True, "3", None])
def test_landmarks_of_vertices_that_are_not_there_are_named_by_the_window_too(tmp_path, vertex):
    (tmp_path / "head").mkdir()
    np.savez(tmp_path / "subject.npz", v_template=np.eye(4, 3))
    place = tmp_path / "head/landmarks.json"
    place.write_text(json.dumps(FACE | {"vertices": FACE["vertices"] | {"c": vertex}}))
    with pytest.raises(AssetError, match=r"landmarks\.json: vertices\.c should be an index below 4"):
        head_from_world(tmp_path)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"J": np.zeros((52, 3), bool)}, None),
        ({"f": np.full((9, 3), 1e300)}, "f should index .* holds 1e\\+300"),
        ({"vt": np.zeros((4, 2)), "ft": np.full((9, 3), 4), "f": np.zeros((9, 3))}, "ft should index 4 points of vt"),
    ],
)
def test_a_body_of_truth_values_or_vast_numbers_is_read_or_named(tmp_path, change, message):
    path = write_model(tmp_path / "model.npz", change)
    if message is None:
        assert (read_body(path).joints == 0).all()
    else:
        refused(read_body, path, message)


@pytest.mark.parametrize("read", [read_body, read_motion])
def test_a_refused_archive_is_closed(tmp_path, read):
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 and no archive")
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        refused(read, tmp_path / "a.npz", "found: File is not a zip file|cannot be read|not a zip")
    assert len(os.listdir("/proc/self/fd")) <= before + 1


def test_no_message_is_longer_than_a_screen():
    assert len(str(AssetError("a.glb: found " + "x" * 10**7))) < 2100


def test_no_message_carries_a_control_character():
    error = AssetError("a.glb: \x1b[2J\x07 is\nnot \u202eread \udc80")
    assert str(error) == r"a.glb: \x1b[2J\x07 is\nnot \u202eread \udc80" and str(error).isprintable()
