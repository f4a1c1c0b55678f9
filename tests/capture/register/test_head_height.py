"""The head's height by outlines: the painted ball of painted_ball.py, lifted under its own video."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from capture.folder import CaptureSubject
from capture.register.head_height import height_by_outline
from geometry.icp import Anchors


def lifted(millimetres: float) -> np.ndarray:
    out = np.eye(4)
    out[1, 3] = millimetres / 1000
    return out


def anchors(subject: CaptureSubject, spread: float) -> Anchors:
    return Anchors(subject.vertices[::1200], subject.vertices[::1200], spread)


@pytest.mark.parametrize("millimetres", [-3.0, 2.0])
@pytest.mark.parametrize("thinner", [0, 1])
def test_a_head_too_high_or_low_comes_back_also_when_its_masks_are_too_narrow(case, millimetres, thinner):
    subject, video = case
    if thinner:
        video = replace(video, masks=np.stack([ndimage.binary_erosion(m, iterations=thinner) for m in video.masks]))
    found = height_by_outline(subject, video, lifted(millimetres), anchors(subject, 0.01))
    # a pixel is 3.3 mm
    assert found.canonical_from_head[1, 3] == pytest.approx(0, abs=3e-4)
    assert found.shift == pytest.approx(millimetres / 1000, abs=3e-4)
    assert found.thickness == pytest.approx(-thinner, abs=0.5)
    np.testing.assert_array_equal(np.delete(found.canonical_from_head.ravel(), 7), np.delete(np.eye(4).ravel(), 7))


def test_landmarks_that_are_exact_keep_their_height_where_the_template_is_not_the_person(case):
    subject, video = case
    bumps = 1 + 0.04 * np.sin(300 * subject.vertices[:, :1])
    other = replace(subject, vertices=subject.vertices * bumps)
    trusting, doubting = (
        height_by_outline(other, video, lifted(2.0), anchors(subject, spread)).shift for spread in (1e-5, 1e-2)
    )
    assert abs(trusting) < 5e-5 < 1e-3 < doubting


def test_hair_says_nothing_and_too_little_skin_is_refused(case):
    subject, video = case
    covered = replace(subject, hair=subject.vertices[:, 1] > -0.105)
    with pytest.raises(ValueError, match=r"only \d+ places of bare skin"):
        height_by_outline(covered, video, np.eye(4), anchors(subject, 0.01))


def test_a_head_a_finger_off_is_not_followed(case):
    subject, video = case
    with pytest.raises(ValueError, match=r"more than 0\.01"):
        height_by_outline(subject, video, lifted(25.0), anchors(subject, 0.1))
