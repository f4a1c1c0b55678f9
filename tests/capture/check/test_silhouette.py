"""The template's outline against the mask's, and places that no video shows, named with what to film."""

from dataclasses import replace

import numpy as np
import pytest
from turning_capture import with_video

from avatar.camera import Camera, look_at
from avatar.skeleton import PARTS
from capture.check.command import lines
from capture.check.report import examine, report_facts
from capture.check.silhouette import MISALIGNED, agreement, outline, outline_errors
from capture.check.unseen import frames_that_see, unseen_places
from capture.check.verdict import verdict


def test_exact_poses_are_not_off_and_the_head_counts_by_its_landmarks_alone(turning):
    assert outline_errors(turning) == dict.fromkeys(PARTS, 0.0)
    moved = with_video(turning, "head", landmarks=turning.videos["head"].landmarks + [0.1, 0, 0])
    off = outline_errors(moved)
    assert off.pop("head") > 1.5
    assert set(off.values()) == {0.0}
    away = turning.videos["body"].root + [50.0, 0, 0]
    assert outline_errors(with_video(turning, "body", root=away))["body"] == np.inf


@pytest.mark.parametrize("part", ["body", "hand_left"])
def test_a_pose_that_is_off_moves_the_outline(turning, part):
    poses = turning.videos[part].axis_angle.copy()
    poses[:, [1, 2, 16, 17, 20, 21], 2] += np.radians(15)  # hips, shoulders and wrists
    off = outline_errors(with_video(turning, part, axis_angle=poses))
    assert off.pop(part) > MISALIGNED
    assert set(off.values()) == {0.0}


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


def test_an_outline_at_the_border_is_none_and_a_large_image_is_compared_on_fewer_pixels(turning, monkeypatch):
    parts = np.zeros((32, 32), int)
    mask = np.ones((32, 32), bool)
    found = agreement(parts, mask, 0)
    assert np.isnan(found[:3]).all() and found.iou == found.fill == 1.0
    found = agreement(parts, np.zeros((32, 32), bool), 0)
    assert np.isnan(found[:3]).all() and found.iou == 0.0
    poses = turning.videos["hand_left"].axis_angle.copy()
    poses[:, 20, 2] += 0.3
    off = with_video(turning, "hand_left", axis_angle=poses)
    fine = outline(off, "hand_left", 0)
    monkeypatch.setattr("capture.check.silhouette.ROWS", 32)
    coarse = outline(off, "hand_left", 0)
    assert (fine.step, coarse.step) == (1, 2) and coarse.parts.shape == (32, 32)
    assert coarse.agreement.edge == pytest.approx(fine.agreement.edge, rel=0.3)
    assert coarse.agreement.iou == pytest.approx(fine.agreement.iou, abs=0.1)


@pytest.mark.parametrize("grown", [-4, -1, 2, 5])
def test_a_mask_too_large_or_small_all_round_is_an_offset_and_no_spread(grown):
    parts = np.full((80, 80), -1)
    parts[20:60, 20:60] = 0
    mask = np.zeros((80, 80), bool)
    mask[20 - grown : 60 + grown, 20 - grown : 60 + grown] = True
    found = agreement(parts, mask, 0)
    assert found.offset == -grown and found.spread < 0.1 * abs(grown) and abs(found.edge - abs(grown)) < 0.5
    assert found.fill == pytest.approx((40 + 2 * grown) ** 2 / 40**2)


def seen_from(capture, height):
    """The capture with the body's cameras at a height above the pelvis, hands and head filmed by nobody."""
    video = capture.videos["body"]
    cameras = []
    for turn in 2 * np.pi * np.arange(12) / 12:
        eye = (3 * np.sin(turn), height, 3 * np.cos(turn))
        cameras.append(Camera(video.cameras[0].K, look_at(eye, (0, 0, 0)), video.cameras[0].size))
    whole = np.ones_like(video.masks)
    capture = with_video(capture, "body", cameras=tuple(cameras), masks=whole)
    for part in ("head", "hand_left", "hand_right"):
        capture = with_video(capture, part, masks=np.zeros_like(capture.videos[part].masks))
    return capture


def places(capture):
    subject = capture.subject
    return unseen_places(subject.rest, subject.faces, subject.skin, frames_that_see(capture))


def test_a_low_camera_misses_the_tops_of_the_arms_and_a_high_one_does_not(turning):
    low = {place.what: place for place in places(seen_from(turning, -0.3))}
    assert low["the tops of both forearms were"].advice == "hold the phone higher"
    assert 0.002 < low["the tops of both forearms were"].area < 0.04
    high = [place.what for place in places(seen_from(turning, 1.8))]
    assert not any("tops" in what for what in high)
    assert any("undersides of both upper arms" in what for what in high) and not any(
        "undersides of both feet" in what for what in high
    )


def test_unseen_places_are_named_by_side_and_listed_and_the_capture_stays_usable(turning):
    subject = turning.subject
    frames = np.full(len(subject.rest), 20.0)
    frames[(subject.rest[:, 0] > 0.25) & (subject.skin.joints[:, 0] == 18)] = 0
    found = unseen_places(subject.rest, subject.faces, subject.skin, frames)
    assert found and all("the left forearm was" in place.what for place in found)
    assert list(found) == sorted(found, key=lambda place: -place.area)
    assert unseen_places(subject.rest, subject.faces, subject.skin, np.full(len(subject.rest), 20.0)) == ()
    report = examine(turning)
    found = places(seen_from(turning, -0.3))
    told = replace(report, unseen=found)
    text = "\n".join(lines(told, verdict(told)))
    assert "the tops of both forearms were hardly seen" in text and "hold the phone higher" in text
    assert verdict(told).usable == verdict(report).usable
    assert report_facts(told)["unseen"][0]["area"] == pytest.approx(found[0].area, abs=1e-6)
