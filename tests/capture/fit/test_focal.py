"""The focal length that nobody tells: weighed over videos, and found from all four."""

from dataclasses import replace

import numpy as np
import pytest

from capture.fit.body import fit_keypoints
from capture.fit.focal import marginal, weighed
from capture.fit.priors import standing
from tests.turning_twin import turning_twin


def seen_by(truth: float, own: float, doubt: float) -> tuple[float, float]:
    """What a video finds that alone says `truth` with deviation `own`, and that holds the guess 0."""
    precision = 1 / own**2 + 1 / doubt**2
    return truth / own**2 / precision, precision**-0.5


def test_the_guess_counts_once_however_many_videos_hold_it():
    doubt = 0.05
    found = np.array([seen_by(0.04, 0.05, doubt)] * 4)
    mean, sigma = weighed(found, doubt)
    precision = 4 / 0.05**2 + 1 / doubt**2
    assert mean == pytest.approx(0.04 * 4 / 0.05**2 / precision)
    assert sigma == pytest.approx(precision**-0.5)


def test_a_sure_video_counts_more_and_one_that_says_nothing_not_at_all():
    sure, vague, blind = seen_by(0.02, 0.01, 0.1), seen_by(-0.06, 0.04, 0.1), (0.0, 0.1)
    mean, sigma = weighed(np.array([sure, vague, blind]), 0.1)
    assert mean == pytest.approx((0.02 / 0.01**2 - 0.06 / 0.04**2) / (1 / 0.01**2 + 1 / 0.04**2 + 1 / 0.1**2))
    assert sigma >= (1 / 0.01**2 + 1 / 0.04**2 + 1 / 0.1**2) ** -0.5


def test_videos_that_contradict_each_other_are_believed_less():
    agreeing = np.array([seen_by(0.01, 0.01, 0.1)] * 3)
    apart = np.array([seen_by(value, 0.01, 0.1) for value in (-0.05, 0.01, 0.07)])
    assert weighed(apart, 0.1)[1] > 3 * weighed(agreeing, 0.1)[1]


@pytest.mark.slow
def test_doubt_is_what_other_noise_would_change():
    """The marginal's deviation beside the spread over draws of the noise."""
    truth, footage = turning_twin(8, 256, focal_error=0.05)
    found, doubts = [], []
    for seed in range(4):
        noise = 0.5 * np.random.default_rng(seed).standard_normal(footage.pixels.shape)
        estimate, seen = fit_keypoints(truth.person, replace(footage, pixels=footage.pixels + noise), lambda note: None)
        found.append(estimate.log_focal)
        doubts.append(marginal(estimate, seen, standing(estimate, seen)))
    assert 0.2 < np.std(found, ddof=1) / np.mean(doubts) < 2
