"""Mipmaps of bytes, against means in double precision."""

import numpy as np
import pytest

from avatar.texture import mipmaps


@pytest.mark.parametrize("channels", [1, 3, 4, 8])
def test_a_mipmap_is_the_rounded_mean_of_blocks_of_the_one_before(channels):
    image = np.random.default_rng(channels).integers(0, 256, (16, 8, channels), dtype=np.uint8)
    chain = mipmaps(image, 4)
    assert [mip.shape for mip in chain] == [(16 >> k, 8 >> k, channels) for k in range(4)]
    assert chain[0] is image or np.array_equal(chain[0], image)
    for fine, coarse in zip(chain, chain[1:], strict=False):
        height, width = coarse.shape[:2]
        mean = fine.reshape(height, 2, width, 2, channels).mean((1, 3), dtype=np.float64)
        np.testing.assert_array_equal(coarse, np.floor(mean + 0.5))  # halves go up


def test_an_odd_size_loses_its_last_row_and_one_texel_stays():
    image = np.random.default_rng(1).integers(0, 256, (7, 3, 3), dtype=np.uint8)
    chain = mipmaps(image, 5)
    assert [mip.shape[:2] for mip in chain] == [(7, 3), (3, 1), (1, 1), (1, 1), (1, 1)]
    np.testing.assert_array_equal(chain[1], mipmaps(image[:6, :2], 2)[1])
    mean = chain[1][:2].mean((0, 1), dtype=np.float64)
    np.testing.assert_array_equal(chain[2][0, 0], np.floor(mean + 0.5))
