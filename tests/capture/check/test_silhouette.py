"""The template's outline against the mask's: exact where the pose is, large where it is not."""

import numpy as np
import pytest
from turning_capture import with_video

from avatar.skeleton import PARTS
from capture.check.silhouette import MISALIGNED, agreement, outline, outline_errors


def test_exact_poses_are_not_off_at_all(turning):
    assert outline_errors(turning) == dict.fromkeys(PARTS, 0.0)


def test_the_head_counts_by_its_landmarks_alone(turning):
    moved = with_video(turning, "head", landmarks=turning.videos["head"].landmarks + [0.1, 0, 0])
    off = outline_errors(moved)
    assert off.pop("head") > 1.5
    assert set(off.values()) == {0.0}


@pytest.mark.parametrize("part", ["body", "hand_left"])
def test_a_pose_that_is_off_moves_the_outline(turning, part):
    poses = turning.videos[part].axis_angle.copy()
    poses[:, [1, 2, 16, 17, 20, 21], 2] += np.radians(15)  # hips, shoulders and wrists
    off = outline_errors(with_video(turning, part, axis_angle=poses))
    assert off.pop(part) > MISALIGNED
    assert set(off.values()) == {0.0}


def test_a_template_that_is_nowhere_in_the_picture_is_infinitely_off(turning):
    away = turning.videos["body"].root + [50.0, 0, 0]
    assert outline_errors(with_video(turning, "body", root=away))["body"] == np.inf


@pytest.mark.parametrize("shift", [0, 1, 3, 8])
def test_a_shifted_square_is_off_by_its_shift(shift):
    parts = np.full((64, 64), -1)
    parts[20:44, 20:44] = 0
    mask = np.zeros((64, 64), bool)
    mask[20:44, 20 + shift : 44 + shift] = True
    edge, offset, spread, iou, fill = agreement(parts, mask, 0)
    # two of four sides move by the shift, the others slide along themselves
    assert edge == pytest.approx(shift / 2, rel=0.35, abs=1e-12)
    assert spread == pytest.approx(edge, abs=1e-12) and abs(offset) < 1 and fill == pytest.approx(1, abs=0.1)
    if shift <= 6:  # nearer than a tenth of the image
        assert iou == pytest.approx((24 - shift) / (24 + shift), abs=1e-12)


def test_an_outline_at_the_image_border_is_no_outline():
    parts = np.zeros((32, 32), int)
    mask = np.ones((32, 32), bool)
    found = agreement(parts, mask, 0)
    assert np.isnan(found[:3]).all() and found.iou == found.fill == 1.0
    found = agreement(parts, np.zeros((32, 32), bool), 0)
    assert np.isnan(found[:3]).all() and found.iou == 0.0


@pytest.mark.parametrize("grown", [-4, -1, 2, 5])
def test_a_mask_too_large_or_small_all_round_is_an_offset_and_no_spread(grown):
    parts = np.full((80, 80), -1)
    parts[20:60, 20:60] = 0
    mask = np.zeros((80, 80), bool)
    mask[20 - grown : 60 + grown, 20 - grown : 60 + grown] = True
    found = agreement(parts, mask, 0)
    assert found.offset == -grown and found.spread < 0.1 * abs(grown) and abs(found.edge - abs(grown)) < 0.5
    assert found.fill == pytest.approx((40 + 2 * grown) ** 2 / 40**2)


def test_a_large_image_is_compared_on_fewer_pixels_and_reported_in_its_own(turning, monkeypatch):
    poses = turning.videos["hand_left"].axis_angle.copy()
    poses[:, 20, 2] += 0.3
    off = with_video(turning, "hand_left", axis_angle=poses)
    fine = outline(off, "hand_left", 0)
    monkeypatch.setattr("capture.check.silhouette.ROWS", 32)
    coarse = outline(off, "hand_left", 0)
    assert (fine.step, coarse.step) == (1, 2) and coarse.parts.shape == (32, 32)
    assert coarse.agreement.edge == pytest.approx(fine.agreement.edge, rel=0.3)
    assert coarse.agreement.iou == pytest.approx(fine.agreement.iou, abs=0.1)
