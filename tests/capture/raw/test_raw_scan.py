import pickle

import numpy as np
import pytest
from PIL import Image

from capture.keypoints.record import Keypoints
from capture.raw.scan import RawScan, RawVideo
from command.errors import AssetError


def video(folder, frames=3, size=(32, 24), part="body"):
    """Frames whose red counts them."""
    pictures = []
    for i in range(frames):
        pictures.append(folder / f"{i:06d}.png")
        Image.fromarray(np.full((size[1], size[0], 3), (i, 0, 7), np.uint8)).save(pictures[-1])
    keypoints = Keypoints(("nose",), np.full((frames, 1, 2), np.nan), np.zeros((frames, 1)), size)
    masks = np.zeros((frames, size[1], size[0]), np.uint8)
    return RawVideo(part, size, 30.0, 10 * np.arange(frames), tuple(pictures), masks, keypoints, None)


def test_pictures_are_read_when_asked_for_and_one_of_another_size_is_refused(tmp_path):
    raw = video(tmp_path)
    assert [raw.picture(i)[0, 0].tolist() for i in (2, 0)] == [[2, 0, 7], [0, 0, 7]]
    # none is held: what travels to a worker is names, masks and points
    assert len(pickle.dumps(raw)) < raw.masks.nbytes + 3000
    Image.new("RGB", (24, 32)).save(raw.pictures[1])
    with pytest.raises(AssetError, match=r"000001\.png: should be \(32, 24\) pixels as the video, is \(24, 32\)"):
        raw.picture(1)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("part", "left_hand", "part should be one of"),
        ("pictures", (), "should be 3 as frames, are .0, 3, 3."),
        ("size", (24, 32), r"masks should be \(24, 32\) pixels"),
    ],
)
def test_fields_that_disagree_are_refused(tmp_path, field, value, said):
    raw = video(tmp_path)
    with pytest.raises(ValueError, match=said):
        RawVideo(**(vars(raw) | {field: value}))


def test_a_scan_has_the_bodys_video(tmp_path):
    raw = video(tmp_path)
    assert set(RawScan({"body": raw}).videos) == {"body"}
    with pytest.raises(ValueError, match="the body's among them"):
        RawScan(dict.fromkeys(("head", "hand_left"), raw))
