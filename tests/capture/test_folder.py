"""Capture folders read back, and their videos: read when they are asked for, and large ones not kept side by side."""

import gc
import json
import shutil
from weakref import ref

import numpy as np
import pytest
from painted_capture import write_capture
from PIL import Image

import capture.videos
from avatar.camera import Camera, look_at, pinhole
from avatar.skeleton import PARTS
from capture.fit.refine import _with_poses
from capture.folder import PartVideo, read_capture
from capture.frame_files import FrameFiles
from capture.videos import Videos, changed, let_go, only, size_of
from command.errors import AssetError
from selfscan.__main__ import main


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("good") / "test", size=32, frames=3)


@pytest.fixture
def folder(good, tmp_path):
    return shutil.copytree(good, tmp_path / "capture")


def _rewrite(path, **change):
    """Fields of an .npz file, changed."""
    with np.load(path) as data:
        fields = {name: data[name] for name in data.files}
    for name, edit in change.items():
        fields[name] = edit(fields[name])
    np.savez(path, **fields)


def _paint(path, size=None, value=None):
    with Image.open(path) as image:
        changed = image.resize(size) if size else image.point(lambda _: value)
    changed.save(path)


def _put(row, value):
    def edit(array):
        array[row] = value
        return array

    return edit


def _json(path, **change):
    path.write_text(json.dumps(json.loads(path.read_text()) | change))


def _black(folder):
    for path in (folder / "hand_left" / "masks").iterdir():
        _paint(path, value=0)


def _head_away(folder):
    content = json.loads((folder / "head" / "landmarks.json").read_text())
    _json(
        folder / "head" / "landmarks.json", points={k: [p[0], p[1], p[2] + 1e3] for k, p in content["points"].items()}
    )
    _rewrite(folder / "head" / "cameras.npz", camera_from_world=lambda m: np.tile(m[:1], (3, 1, 1)))


PER_FRAME = ("K", "camera_from_world", "distortion")
BAD = {
    "no masks": (lambda f: shutil.rmtree(f / "body" / "masks"), r"body/masks: expected frames 000000\.png"),
    "one mask missing": (
        lambda f: (f / "body/masks/000001.png").unlink(),
        r"body/masks: every image.*3 images and 2 masks do not; 000001\.png is in images alone",
    ),
    "one image missing": (lambda f: (f / "head/images/000002.png").unlink(), r"000002\.png is in masks alone"),
    "three of four videos": (
        lambda f: shutil.rmtree(f / "hand_right"),
        r"capture: no folder hand_right; all four videos are needed: body, head, hand_left",
    ),
    "three of four listed": (lambda f: _json(f / "capture.json", parts=list(PARTS[:3])), r"lacks \['hand_right'\]"),
    "frames of different sizes": (
        lambda f: _paint(f / "body/images/000002.png", size=(32, 30)),
        r"images/000002\.png: should be \(32, 32\) pixels as the first frame, is \(32, 30\)",
    ),
    "masks of another size": (
        lambda f: [_paint(p, size=(16, 20)) for p in (f / "head/masks").iterdir()],
        r"head/masks: should be \(32, 32\) pixels as the images, are \(16, 20\)",
    ),
    "cameras for two of three frames": (
        lambda f: _rewrite(f / "body/cameras.npz", **dict.fromkeys(PER_FRAME, lambda rows: rows[:2])),
        r"cameras\.npz: should hold 1 or 3 cameras, holds 2",
    ),
    "landmarks behind the cameras": (
        _head_away,
        r"landmarks\.json: points should be in the frame of head/cameras\.npz",
    ),
    "five landmarks": (
        lambda f: _json(
            f / "head/landmarks.json", points={n: [0, 0, 0] for n in "abcde"}, vertices=dict.fromkeys("abcde", 1)
        ),
        r"at least 6 landmarks, found 5",
    ),
    "a trunk of two frames": (
        lambda f: np.savez(f / "head/trunk.npz", axis_angle=np.zeros((2, 52, 3))),
        r"trunk\.npz: axis_angle should be \(3, 52, 3\), is \(2, 52, 3\)",
    ),
    "no person in any frame": (_black, r"hand_left/masks: no pixel of any frame shows the person"),
    "no capture": (lambda f: (f / "capture.json").unlink(), r"capture\.json: no such file"),
}
EYE = (..., slice(3), 3)
# an archive, a field, what is done to it, the complaint
SPOILT_FIELDS = [
    ("body/cameras", "size", lambda s: 2 * s, r"size should be \(32, 32\) as the images, is \(64, 64\)"),
    ("hand_left/poses", "poses", lambda p: p[:2], r"poses should hold one row for each of 3 frames, holds 2"),
    ("body/poses", "poses", lambda p: p[:, :72], r"poses should be \(3, 156\), is \(3, 72\)"),
    ("body/poses", "poses", _put((1, 47), np.nan), r"poses should be finite, is not in frame 1, joint 15"),
    ("body/cameras", "camera_from_world", lambda m: m * [-1, 1, 1, 1], r"camera_from_world should hold a rotation"),
    ("subject", "v_template", lambda v: 1000 * v, r"should be a standing person in metres.*: millimetres\?"),
    ("subject", "joints", lambda v: 1000 * v, r"joints should lie in the template, in metres; joint \d+"),
    ("body/poses", "trans", lambda t: 1000 * (t + [1, 0.9, 2.0]), r"poses\.npz should be in metres of one world"),
    ("body/cameras", "camera_from_world", _put(EYE, [0, 0, 3500.0]), r"is 3500 m from the camera: millimetres\?"),
    ("body/cameras", "camera_from_world", _put(EYE, [0, 0, -3.5]), r"the person should be in front of the camera"),
]
BAD |= {
    f"{name} {field}: {message}": (lambda f, n=name, k=field, e=edit: _rewrite(f / f"{n}.npz", **{k: e}), message)
    for name, field, edit, message in SPOILT_FIELDS
}


def test_frames_left_out_take_their_doubts_along_and_the_folder_is_good(folder):
    assert set(read_capture(folder).videos) == set(PARTS)
    one = video("body")
    kept = _with_poses(one, one.axis_angle[[2]], one.root[[2]], np.array([2]))
    np.testing.assert_array_equal(kept.unsure, one.unsure[[2]])
    np.testing.assert_array_equal(kept.images, one.images[[2]])
    whole = _with_poses(one, one.axis_angle, one.root + 1, np.arange(3))
    assert whole.images is one.images  # all frames: no second copy


def test_the_trunk_under_a_head_is_read_where_it_is_known_and_frames_left_out_take_it_along(folder):
    assert read_capture(folder, parts=("head",)).videos["head"].trunk is None
    angles = np.random.default_rng(0).normal(size=(3, 52, 3))
    np.savez(folder / "head" / "trunk.npz", axis_angle=angles)
    head = read_capture(folder, parts=("head",)).videos["head"]
    np.testing.assert_array_equal(head.trunk, angles)
    np.testing.assert_array_equal(_with_poses(head, None, None, np.array([0, 2])).trunk, angles[[0, 2]])


@pytest.mark.parametrize("case", BAD)
def test_a_bad_capture_is_refused_in_one_line_that_says_what_and_where(folder, case):
    spoil, message = BAD[case]
    spoil(folder)
    with pytest.raises(AssetError, match=message) as refusal:
        read_capture(folder)
    assert "\n" not in str(refusal.value) and len(str(refusal.value)) < 400


@pytest.mark.parametrize("command", ["train", "check"])
def test_commands_print_that_line_and_leave_nothing(folder, tmp_path, capsys, command):
    shutil.rmtree(folder / "hand_right")
    assert main([command, str(folder), "-o", str(tmp_path / "out")]) == 1
    out, err = capsys.readouterr()
    assert err.count("\n") == 1 and "no folder hand_right" in err
    assert not (tmp_path / "out").exists()


def test_mixed_pixels_of_soft_masks_supervise_nothing(tmp_path):
    folder = write_capture(tmp_path / "anna", size=32, frames=3)
    assert read_capture(folder).videos["body"].unsure is None
    path = folder / "body" / "masks" / "000001.png"
    mask = np.asarray(Image.open(path)).copy()
    mask[4, :3] = (100, 200, 12)
    Image.fromarray(mask).save(path)
    video = read_capture(folder).videos["body"]
    assert video.unsure is not None and video.unsure.sum() == 2 and video.unsure[1, 4, :2].all()
    assert video.masks[1, 4, :3].tolist() == [False, True, False]


def video(part: str, frames: int = 3) -> PartVideo:
    masks = np.arange(frames * 16).reshape(frames, 4, 4) % 3 == 0
    camera = Camera(pinhole((4, 4), 1.0), look_at((0, 0, 3), (0, 0, 0)), (4, 4))
    images = np.repeat(np.arange(frames, dtype=np.uint8), 48).reshape(frames, 4, 4, 3)
    poses = np.zeros((frames, 52, 3)), np.zeros((frames, 3))
    return PartVideo(part, images, masks, (camera,) * frames, *poses, None, None, ~masks)


@pytest.fixture
def counted(monkeypatch):
    """Videos of which one and a half may be kept; the parts that were read, in order; how many are in memory."""
    reads: list[str] = []
    pixels: list[ref] = []

    def read(part):
        reads.append(part)
        made = video(part)
        # the pixels are what counts: a changed video has the same
        pixels.append(ref(made.images))
        return made

    def held() -> int:
        gc.collect()
        return sum(one() is not None for one in pixels)

    monkeypatch.setattr(capture.videos, "KEPT", 3 * size_of(video("body")) // 2)
    monkeypatch.setattr(capture.videos, "SHARE", 0)
    return Videos({part: lambda part=part: read(part) for part in PARTS}), reads, held


def test_going_through_large_videos_keeps_one(counted):
    videos, reads, held = counted
    for part in PARTS:
        assert videos[part].part == part
        assert held() == 1
    assert reads == list(PARTS)
    # the last is kept, the first read again
    assert videos["hand_right"].part == "hand_right" and len(reads) == 4
    assert videos["body"].part == "body" and len(reads) == 5
    let_go(videos)
    assert held() == 0


def test_small_videos_are_read_once(counted, monkeypatch):
    videos, reads, held = counted
    monkeypatch.setattr(capture.videos, "KEPT", 10**9)
    for _ in range(3):
        assert [one.part for one in videos.values()] == list(PARTS)
    assert reads == list(PARTS)


def test_a_machine_with_memory_keeps_more(counted, monkeypatch):
    videos, reads, _ = counted
    monkeypatch.setattr(capture.videos, "SHARE", 0.1)
    for _ in range(2):
        assert len(list(videos.values())) == 4
    assert reads == list(PARTS)


def test_a_video_that_is_in_use_is_not_read_again(counted):
    videos, reads, _ = counted
    body = videos["body"]
    assert videos["head"].part == "head" and videos["body"] is body
    assert reads == ["body", "head"]


def test_changed_videos_are_changed_when_they_are_asked_for_and_share_the_room(counted):
    videos, reads, held = counted
    turned = changed(videos, lambda part, one: _with_poses(one, one.axis_angle, one.root + 1, np.arange(3)))
    assert reads == [] and list(turned) == list(PARTS)
    assert videos["body"].root[0, 0] == 0 and turned["head"].root[0, 0] == 1
    assert held() == 1
    assert list(only(turned, ("head",))) == ["head"]
    # plain dictionaries stay what they are
    assert changed({"body": 1}, lambda part, one: one + 1) == {"body": 2}


def test_frames_on_demand_are_those_that_are_read_at_once(tmp_path):
    """A worker that draws rays looks at one picture at a time, also where frames were left out."""
    pixels = np.random.default_rng(0).integers(0, 255, (4, 6, 5, 3), np.uint8)
    for i, one in enumerate(pixels):
        Image.fromarray(one).save(tmp_path / f"{i:06d}.png")
    files = FrameFiles(tuple(sorted(tmp_path.glob("*.png"))), (6, 5))
    assert files.shape == pixels.shape and files.dtype == pixels.dtype and files.nbytes == 0
    np.testing.assert_array_equal(np.stack(list(files)), pixels)
    some = files[np.array([3, 1])]
    assert len(some) == 2
    np.testing.assert_array_equal(some[0], pixels[3])
    np.testing.assert_array_equal(files[2], pixels[2])
    Image.fromarray(pixels[0, :5]).save(tmp_path / "000001.png")
    with pytest.raises(AssetError, match=r"000001\.png: should be \(5, 6\) pixels as before, is \(5, 5\)"):
        files[1]
