"""The assertion that the hard cases share."""

import numpy as np
import pytest


@pytest.mark.parametrize("measured", [np.zeros(0), np.zeros((0, 3)), [], np.nan, [0.0, np.nan], 2.0, -2.0])
def test_nothing_a_nan_and_what_is_too_large_are_within_no_bound(within, measured):
    with pytest.raises(AssertionError, match=r"nothing was measured|exceeds the bound"):
        within(measured, 1.0)


@pytest.mark.parametrize("measured", [0.0, -1.0, [[0.5, -1.0]], 1])
def test_the_largest_absolute_value_is_within_its_bound(within, measured):
    within(measured, 1.0)
