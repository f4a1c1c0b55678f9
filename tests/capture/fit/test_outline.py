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


@pytest.mark.parametrize("x, y", [(6, 0), (-4, 8), (0, -10)])
def test_a_shifted_silhouette_is_found(x, y):
    template = silhouette()
    mask = np.roll(template, (y, x), (0, 1))[64:128, 48:96]
    turn, shift = placement(template, mask, np.array([72.0, 96.0]), 20.0)
    assert turn == 0 and shift.tolist() == [x, y]


@pytest.mark.parametrize("degrees", [-16, 8])
def test_a_turned_silhouette_is_found(degrees):
    template, (c, s) = silhouette(), (np.cos(np.radians(degrees)), np.sin(np.radians(degrees)))
    back, middle = np.array([[c, -s], [s, c]]), np.array([96.0, 72.0])
    drawn = ndimage.affine_transform(template.astype(float), back, offset=middle - back @ middle, order=1) > 0.5
    turn, _ = placement(template, drawn[64:128, 48:96], np.array([72.0, 96.0]), 20.0)
    assert turn == pytest.approx(np.radians(degrees))
