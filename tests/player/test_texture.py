"""Images as textures: every mipmap that is drawn, on the device, against means over blocks of the image."""

from ctypes import c_int, c_uint, c_void_p

import moderngl
import numpy as np
import pytest

from avatar.texture import mip_levels
from player.gl.texture import image_texture


def block_means(image, level):
    size = 1 << level
    height, width, channels = image.shape
    return image.reshape(height // size, size, width // size, size, channels).mean((1, 3), dtype=np.float64)


def held_level(context, texture, level, height, width):
    """What the device holds, as RGBA: moderngl reads no levels but those it made."""
    out = np.zeros((height, width, 4), np.uint8)
    read = context.function("glGetTexImage", c_uint, c_int, c_uint, c_uint, c_void_p)
    texture.use()
    read(0x0DE1, level, 0x1908, 0x1401, out.ctypes.data)  # of a 2D texture, RGBA, unsigned bytes
    return out


@pytest.mark.parametrize("shape", [(1024, 1024, 3), (1024, 512, 4), (8, 2, 3), (512, 12, 4)])
def test_mipmaps_on_the_device_are_the_means_of_blocks(context, shape):
    image = np.random.default_rng(3).integers(0, 256, shape, dtype=np.uint8)
    texture = image_texture(context, image)
    assert texture.components == shape[2]
    for level in range(mip_levels(shape)):
        height, width = (max(side >> level, 1) for side in shape[:2])
        held = held_level(context, texture, level, height, width)
        # each halving rounds by at most half, and passes on the error of the one before
        assert np.abs(held[..., : shape[2]] - block_means(image, level)).max() <= 0.5 * level + 1e-9
        assert shape[2] == 4 or (held[..., 3] == 255).all()
    texture.release()


def test_mipmaps_of_an_odd_size_have_the_sizes_that_opengl_asks_for(context):
    image = np.full((515, 301, 3), (10, 200, 90), np.uint8)
    texture = image_texture(context, image)
    held = held_level(context, texture, 1, 257, 150)
    assert (held == (10, 200, 90, 255)).all()
    texture.release()


def test_a_texture_and_its_mipmaps_are_counted(context):
    before = context.counts.live_bytes
    texture = image_texture(context, np.zeros((1024, 1024, 3), np.uint8))
    assert context.counts.live_bytes - before == sum(4 * (1024 >> i) ** 2 for i in range(mip_levels((1024, 1024))))
    texture.release()
    assert context.counts.live_bytes == before


def test_one_texel_will_do_only_where_asked_and_on_a_software_rasteriser(context):
    image = np.zeros((4, 4, 4), np.uint8)
    fine, coarse = (image_texture(context, image, coarse=coarse) for coarse in (False, True))
    assert (fine.filter != coarse.filter) == context.software
    assert fine.filter[1] == coarse.filter[1] == moderngl.LINEAR  # enlarged, all four
    fine.release()
    coarse.release()
