"""How far masks are off, counted where softness explains nothing."""

import numpy as np
import pytest

from experiments.own_masks import compared


def test_pixels_beside_the_edge_are_told_from_those_far_away():
    true = np.zeros((2, 40, 40), bool)
    true[:, 10:30, 10:30] = True
    found = true.copy()
    found[0, 10:30, 30] = True  # one pixel wider
    found[1, 2:5, 2:5] = True  # a speck of the room
    found[1, 18:22, 18:22] = False  # a hole
    off = compared(found, true)
    assert off == pytest.approx((784 / 829, 100 * 29 / 800, 2.0, 100 * 9 / 800, 2.0))
