"""Where a silhouette lies on a mask."""

import numpy as np
import pytest
from scipy import ndimage

from capture.fit import outline
from capture.fit.outline import placement


def silhouette() -> np.ndarray:
    """On a canvas three times 64 x 48: a bar with a foot to one side, so that every turn and shift shows."""
    canvas = np.zeros((192, 144), bool)
    canvas[76:116, 68:76] = True
    canvas[108:116, 68:92] = True
    return canvas


def test_a_silhouette_in_place_stays_and_is_not_resampled(monkeypatch):
    """At 0 degrees the template itself is correlated: resampled it would be the same, at the cost of a turn."""
    turned = []
    affine = ndimage.affine_transform
    monkeypatch.setattr(outline.ndimage, "affine_transform", lambda *a, **k: turned.append(a) or affine(*a, **k))
    template = silhouette()
    turn, shift = placement(template, template[64:128, 48:96], np.array([72.0, 96.0]), 20.0)
    assert turn == 0 and shift.tolist() == [0, 0]
    assert len(turned) == 4


PLACES = [((0, 0), -16.0), *((shift, turn) for turn in (0.0, 8.0) for shift in ((0, 0), (40, -20), (-60, 30)))]


@pytest.mark.parametrize(("shift", "degrees"), PLACES)
def test_a_silhouette_is_placed_where_it_was_taken_from(shift, degrees):
    h = w = 96
    y, x = np.mgrid[: 3 * h, : 3 * w] + 0.5
    limb = lambda x, y: (abs(x - 144) < 8) & (abs(y - 150) < 30) | (abs(x - 155) < 15) & (abs(y - 130) < 6)
    centre = np.array([144.0, 150.0])
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    back_x, back_y = x - centre[0] - shift[0], y - centre[1] - shift[1]
    moved = limb(c * back_x + s * back_y + centre[0], -s * back_x + c * back_y + centre[1])
    turn, found = placement(limb(x, y), moved[h : 2 * h, w : 2 * w], centre, 1000.0)
    assert abs(np.degrees(turn) - degrees) < 1e-9
    np.testing.assert_allclose(found, shift, atol=2 if degrees else 0)
