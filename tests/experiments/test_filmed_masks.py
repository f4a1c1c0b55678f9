"""Masks that the fit is tried with: moved outlines, and those made of a film."""

import numpy as np
import pytest

from experiments.fitting import NAMED, Filming


@pytest.fixture(scope="module")
def masks(rasteriser):
    """Of five frames, by what they are made with; shares of the person."""
    filming = Filming("builtin", rasteriser)
    names = ("exact", "wide_masks", "narrow_masks", "own_masks", "sent_on")
    found = {name: filming.seen(NAMED[name], 0, 5, 270, outlines=True).footage.masks for name in names}
    return {name: np.asarray(one, float) / np.max(one) for name, one in found.items()}


def overlap(a, b):
    return np.minimum(a, b).sum() / np.maximum(a, b).sum()


def test_outlines_are_moved_by_as_much_as_is_said(masks):
    exact = masks["exact"]
    rim = (np.abs(np.diff(exact, axis=2)).sum() + np.abs(np.diff(exact, axis=1)).sum()) * np.pi / 4
    # 2 px of 1080 are half a pixel of 270
    for name, sign in (("wide_masks", 1), ("narrow_masks", -1)):
        assert sign * (masks[name] - exact).sum() == pytest.approx(0.5 * rim, rel=0.35)


def test_masks_of_a_film_are_nearly_those_of_the_person_and_worse_when_it_was_sent_on(masks):
    own, sent = (overlap(masks[name], masks["exact"]) for name in ("own_masks", "sent_on"))
    assert own > 0.92 and 0.6 < sent < own
