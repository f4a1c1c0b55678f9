"""Places that no video shows are named, with what to film."""

from dataclasses import replace

import numpy as np
import pytest
from turning_capture import with_video

from avatar.camera import Camera, look_at
from capture.check.command import lines
from capture.check.report import examine, report_facts
from capture.check.unseen import frames_that_see, unseen_places
from capture.check.verdict import verdict


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


def test_one_arm_alone_is_named_by_its_side(turning):
    subject = turning.subject
    frames = np.full(len(subject.rest), 20.0)
    frames[(subject.rest[:, 0] > 0.25) & (subject.skin.joints[:, 0] == 18)] = 0
    found = unseen_places(subject.rest, subject.faces, subject.skin, frames)
    assert found and all("the left forearm was" in place.what for place in found)
    assert list(found) == sorted(found, key=lambda place: -place.area)
    assert unseen_places(subject.rest, subject.faces, subject.skin, np.full(len(subject.rest), 20.0)) == ()


def test_the_check_lists_them_and_stays_usable(turning):
    report = examine(turning)
    found = places(seen_from(turning, -0.3))
    told = replace(report, unseen=found)
    text = "\n".join(lines(told, verdict(told)))
    assert "the tops of both forearms were hardly seen" in text and "hold the phone higher" in text
    assert verdict(told).usable == verdict(report).usable
    assert report_facts(told)["unseen"][0]["area"] == pytest.approx(found[0].area, abs=1e-6)
