"""Bad captures: each is refused in one clear line that names the file, or still gives what can be had."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from filmed_part import filmed_part, rays_of
from painted_capture import write_capture
from PIL import Image

from avatar.skeleton import PARTS
from capture.folder import read_capture
from command.errors import AssetError
from selfscan.__main__ import main
from train.preset import DEMO


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


def test_the_capture_the_others_are_made_from_is_good(folder):
    assert set(read_capture(folder).videos) == set(PARTS)


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


def test_a_frame_without_a_person_gives_no_rays_and_the_others_do(folder):
    _paint(folder / "hand_left" / "masks" / "000001.png", value=0)
    capture = read_capture(folder)
    rays = rays_of(filmed_part(capture), DEMO.parts[2], ends=8, per_frame=200)
    assert set(np.unique(rays.frame)) == {0, 2}
    assert np.isfinite(rays.ends).all() and 0 < rays.mask.mean() < 1


@pytest.mark.parametrize("pixels", [1, 2])
def test_masks_of_a_pixel_or_two_give_finite_rays_or_none(folder, pixels):
    capture = read_capture(folder)
    video = capture.videos["hand_left"]
    masks = np.zeros_like(video.masks)
    on = np.argwhere(video.masks[0])
    for row, column in on[len(on) // 2 :][:pixels]:
        masks[:, row, column] = True
    rays = rays_of(filmed_part(capture, video=replace(video, masks=masks)), DEMO.parts[2], ends=8, per_frame=200)
    assert np.isfinite(rays.ends).all() and rays.mask.sum() <= 3 * pixels


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
