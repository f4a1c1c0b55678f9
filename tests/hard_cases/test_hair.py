"""Long hair carved from masks that are off: how far from hair carved from exact ones, and that from the truth."""

import numpy as np
import pytest
from haired_ball import CELL, block, filmed, grown, standing

from capture.template.hull import MaskView
from geometry.cells import distance_to


def one_shows_nobody(views: list[MaskView]) -> list[MaskView]:
    return [view._replace(beside=view.beside | (i == 4)) for i, view in enumerate(views)]


def one_shows_only_person(views: list[MaskView]) -> list[MaskView]:
    return [view._replace(beside=view.beside & (i != 4)) for i, view in enumerate(views)]


def cut_off(views: list[MaskView]) -> list[MaskView]:
    """The lower third of every third picture proves no air."""
    upper = (np.arange(160) < 107)[:, None]
    return [view._replace(beside=view.beside & (upper | (i % 3 > 0))) for i, view in enumerate(views)]


# bounds in metres; a pixel is 3.75 mm at the head, a cell 6
FAULTS = {
    "none, and the truth": (lambda views: views, 0.012),
    "a mask that shows nobody": (one_shows_nobody, 0.0075),
    "a mask full of person": (one_shows_only_person, 0.0075),
    "pictures cut off below": (cut_off, 0.0075),
    "masks two pixels too small": (lambda views: [grown(view, -2) for view in views], 0.0125),
    "masks two pixels too large": (lambda views: [grown(view, 2) for view in views], 0.0125),
    "masks two pixels off either way": (lambda views: [grown(v, 4 * (i % 2) - 2) for i, v in enumerate(views)], 0.0125),
}


def apart(found: np.ndarray | None, true: np.ndarray) -> float:
    """Within what distance 98 % of either's cells have the other, metres."""
    assert found is not None and found.any()
    return CELL * max(np.quantile(distance_to(a)[b], 0.98) for a, b in ((found, true), (true, found)))


@pytest.mark.parametrize("fault", FAULTS)
def test_long_hair_is_carved_from(within, fault):
    spoiled, bound = FAULTS[fault]
    views = filmed(hair=True)
    beside = block() if fault == "none, and the truth" else standing(views)
    assert beside is not None
    within(apart(standing(spoiled(views)), beside), bound, f"m, {fault}")
