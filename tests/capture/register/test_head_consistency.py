"""The head's place by its own video: a painted, dented ball filmed from around, its landmarks a few millimetres off."""

import numpy as np
import pytest

from avatar.rotation import matrix_from_axis_angle
from capture.folder import CaptureSubject, PartVideo
from capture.register.head_consistency import place_by_consistency
from geometry.icp import Anchors


def off(transform: np.ndarray, points: np.ndarray) -> float:
    """Metres, mean."""
    return float(np.linalg.norm(points @ transform[:3, :3].T + transform[:3, 3] - points, axis=1).mean())


def disturbed(scale: float, degrees: float, shift: float) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = (1 + scale) * matrix_from_axis_angle(np.radians(degrees) * np.array([0.6, 0.8, 0.0]))
    out[:3, 3] = shift * np.array([0.5, -0.5, 0.7])
    return out


def anchors(subject: CaptureSubject, start: np.ndarray) -> Anchors:
    target = subject.vertices[::1200]
    return Anchors(target @ start[:3, :3].T + start[:3, 3], target, 0.003)


def test_a_head_two_degrees_and_two_per_cent_off_comes_back(case):
    subject, video = case
    start = disturbed(0.02, 2.0, 0.002)
    found = place_by_consistency(subject, video, start, anchors(subject, start))
    assert off(found.canonical_from_head, subject.vertices) < 0.4 * off(start, subject.vertices)
    assert found.after < found.before


def test_a_head_in_its_place_stays_within_a_per_cent_and_a_half_of_its_size(case):
    subject, video = case
    found = place_by_consistency(subject, video, np.eye(4), anchors(subject, np.eye(4)))
    assert off(found.canonical_from_head, subject.vertices) < 0.0015


def test_a_head_that_no_frame_shows_is_refused(case):
    subject, video = case
    dark = PartVideo("head", video.images, np.zeros_like(video.masks), video.cameras, None, None, None, None)
    with pytest.raises(ValueError, match="hardly any"):
        place_by_consistency(subject, dark, np.eye(4), anchors(subject, np.eye(4)))
