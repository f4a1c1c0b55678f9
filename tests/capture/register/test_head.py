"""The place of a head by its own video, and its height by outlines: the painted ball of painted_ball.py, moved."""

from dataclasses import replace

import numpy as np
import pytest
from painted_ball import filmed, head
from scipy import ndimage

from avatar.rotation import matrix_from_axis_angle
from capture.folder import CaptureSubject, PartVideo
from capture.register.head_consistency import place_by_consistency
from capture.register.head_height import height_by_outline
from geometry.icp import Anchors

IN_PLACE = np.eye(4)


def lifted(millimetres: float) -> np.ndarray:
    out = np.eye(4)
    out[1, 3] = millimetres / 1000
    return out


def anchors(subject: CaptureSubject, spread: float, start: np.ndarray = IN_PLACE) -> Anchors:
    target = subject.vertices[::1200]
    return Anchors(target @ start[:3, :3].T + start[:3, 3], target, spread)


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
        height_by_outline(covered, video, IN_PLACE, anchors(subject, 0.01))


def test_a_head_a_finger_off_is_not_followed(case):
    subject, video = case
    with pytest.raises(ValueError, match=r"more than 0\.01"):
        height_by_outline(subject, video, lifted(25.0), anchors(subject, 0.1))


@pytest.fixture(scope="module")
def case() -> tuple[CaptureSubject, PartVideo]:
    """A painted ball for a head, and its video."""
    subject = head()
    return subject, filmed(subject)


def off(transform: np.ndarray, points: np.ndarray) -> float:
    """Metres, mean."""
    return float(np.linalg.norm(points @ transform[:3, :3].T + transform[:3, 3] - points, axis=1).mean())


def disturbed(scale: float, degrees: float, shift: float) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = (1 + scale) * matrix_from_axis_angle(np.radians(degrees) * np.array([0.6, 0.8, 0.0]))
    out[:3, 3] = shift * np.array([0.5, -0.5, 0.7])
    return out


def test_a_head_two_degrees_and_two_per_cent_off_comes_back(case):
    subject, video = case
    start = disturbed(0.02, 2.0, 0.002)
    found = place_by_consistency(subject, video, start, anchors(subject, 0.003, start))
    assert off(found.canonical_from_head, subject.vertices) < 0.4 * off(start, subject.vertices)
    assert found.after < found.before


def test_a_head_in_its_place_stays_within_a_per_cent_and_a_half_of_its_size(case):
    subject, video = case
    found = place_by_consistency(subject, video, IN_PLACE, anchors(subject, 0.003))
    assert off(found.canonical_from_head, subject.vertices) < 0.0015


def test_a_head_that_no_frame_shows_is_refused(case):
    subject, video = case
    dark = PartVideo("head", video.images, np.zeros_like(video.masks), video.cameras, None, None, None, None)
    with pytest.raises(ValueError, match="hardly any"):
        place_by_consistency(subject, dark, IN_PLACE, anchors(subject, 0.003))
