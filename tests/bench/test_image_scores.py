"""Image scores against their definitions."""

import numpy as np
import pytest

from avatar.psnr import error_between
from bench.score.metrics import flip, rectangle, ssim

RNG = np.random.default_rng(7)


def noisy(image, sigma, seed=0):
    return np.clip(image + np.random.default_rng(seed).normal(0, sigma, image.shape), 0, 1)


def test_scores_order_images_by_their_noise():
    image = RNG.random((64, 64, 3))
    levels = [noisy(image, sigma) for sigma in (0.02, 0.08, 0.25)]
    assert np.all(np.diff([error_between(image, x).psnr() for x in levels]) < 0)
    assert np.all(np.diff([ssim(image, x).value for x in levels]) < 0)
    assert np.all(np.diff([flip(image, x).value for x in levels]) > 0)


def test_flip_is_zero_for_equal_images_and_large_for_black_against_white():
    image = RNG.random((40, 30, 3))
    assert flip(image, image).value == pytest.approx(0, abs=1e-6)
    assert flip(np.zeros((40, 30, 3)), np.ones((40, 30, 3))).value > 0.9


def test_rectangle_is_the_tight_box_of_a_mask():
    mask = np.zeros((20, 30), bool)
    mask[3, 7] = mask[11, 25] = True
    assert rectangle(mask) == (slice(3, 12), slice(7, 26))


def test_flip_leaves_shared_black_ground_out_of_the_work_but_not_of_the_mean():
    small = np.zeros((2, 90, 90, 3), np.float32)
    small[:, 30:60, 30:60] = RNG.random((2, 30, 30, 3))
    wide = np.pad(small, ((0, 0), (100, 100), (100, 100), (0, 0)))
    ink = wide.copy()
    ink[:, 0, 0] = ink[:, -1, -1] = 1e-6  # nothing to see, yet nothing can be left out
    assert flip(*wide).value == pytest.approx(flip(*ink).value, rel=1e-4)
    assert flip(*wide).value == pytest.approx(flip(*small).value * 90**2 / 290**2, rel=1e-4)
