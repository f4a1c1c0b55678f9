"""Videos are read when they are asked for, and large ones not kept beside each other."""

import gc
from weakref import ref

import numpy as np
import pytest
from PIL import Image

import capture.videos
from avatar.camera import Camera, look_at, pinhole
from capture.fit.refine import _with_poses
from capture.folder import PartVideo
from capture.frame_files import FrameFiles
from capture.videos import Videos, changed, let_go, only, size_of
from command.errors import AssetError

PARTS = ("body", "head", "hand_left", "hand_right")


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


def test_a_video_that_somebody_holds_is_not_read_again(counted):
    videos, reads, held = counted
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


def test_frames_that_are_left_out_take_their_doubts_along():
    one = video("body")
    kept = _with_poses(one, one.axis_angle[[2]], one.root[[2]], np.array([2]))
    np.testing.assert_array_equal(kept.unsure, one.unsure[[2]])
    np.testing.assert_array_equal(kept.images, one.images[[2]])
    whole = _with_poses(one, one.axis_angle, one.root + 1, np.arange(3))
    assert whole.images is one.images  # all frames: no second copy


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
