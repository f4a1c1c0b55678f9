"""The template's outline against the mask's: exact where the pose is, large where it is not."""

from dataclasses import replace

import numpy as np
import pytest
from painted_capture import write_capture

from train.capture import PARTS, read_capture
from train.check import MISALIGNED, misalignment, outline_errors
from train.check.silhouette import agreement, outline


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """The painted capture with the template itself as its masks."""
    found = read_capture(write_capture(tmp_path_factory.mktemp("silhouette") / "test"))
    for part, video in found.videos.items():
        masks = [outline(found, part, frame)[1].face >= 0 for frame in range(len(video.masks))]
        found = _with(found, part, masks=np.stack(masks))
    return found


def _with(capture, part, **changes):
    return replace(capture, videos={**capture.videos, part: replace(capture.videos[part], **changes)})


def test_exact_poses_are_not_off_at_all(capture):
    assert outline_errors(capture) == dict.fromkeys(PARTS, 0.0)
    assert misalignment(capture) == 0


def test_the_head_counts_by_its_landmarks_alone(capture):
    moved = _with(capture, "head", landmarks=capture.videos["head"].landmarks + [0.1, 0, 0])
    assert outline_errors(moved)["head"] > 5
    assert misalignment(moved) == 0


@pytest.mark.parametrize("part", ["body", "hand_left"])
def test_a_pose_that_is_off_moves_the_outline(capture, part):
    poses = capture.videos[part].axis_angle.copy()
    poses[:, [1, 2, 16, 17, 20, 21], 2] += np.radians(15)  # hips, shoulders and wrists
    off = outline_errors(_with(capture, part, axis_angle=poses))
    assert off.pop(part) > MISALIGNED
    assert set(off.values()) == {0.0}


def test_a_template_that_is_nowhere_in_the_picture_is_infinitely_off(capture):
    away = capture.videos["body"].root + [50.0, 0, 0]
    assert misalignment(_with(capture, "body", root=away)) == np.inf


@pytest.mark.parametrize("shift", [0, 1, 3, 8])
def test_a_shifted_square_is_off_by_its_shift(shift):
    parts = np.full((64, 64), -1)
    parts[20:44, 20:44] = 0
    mask = np.zeros((64, 64), bool)
    mask[20:44, 20 + shift : 44 + shift] = True
    edge, iou = agreement(parts, mask, 0)
    # two of four sides move by the shift, the others slide along themselves
    assert edge == pytest.approx(shift / 2, rel=0.35, abs=1e-12)
    if shift <= 6:  # nearer than a tenth of the image
        assert iou == pytest.approx((24 - shift) / (24 + shift), abs=1e-12)


def test_an_outline_at_the_image_border_is_no_outline():
    parts = np.zeros((32, 32), int)
    mask = np.ones((32, 32), bool)
    edge, iou = agreement(parts, mask, 0)
    assert np.isnan(edge) and iou == 1.0
    edge, iou = agreement(parts, np.zeros((32, 32), bool), 0)
    assert np.isnan(edge) and iou == 0.0
