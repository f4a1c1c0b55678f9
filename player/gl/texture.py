"""Images as textures, their mipmaps made by avatar/texture.py: the same on every driver.

The bake closes chart edges in just these mips. Mesa's software rasteriser would draw each one, with a
shader that it first has to compile: a tenth of a second of the first frame, against a fiftieth.
"""

from ctypes import c_float, c_int, c_uint, c_void_p

import moderngl
import numpy as np
from jaxtyping import UInt8

from avatar.texture import mip_levels, mipmaps
from player.gl.context import Context

# the base color's bias on a software rasteriser. One mip, no anisotropy there: sized for the longest side of the
# pixel, and rounded, it blurs by 3 dB. As a state of the texture it costs a tenth of a frame, in the shader a fifth.
MIP_BIAS = -1.0
TEXTURE_2D, LOD_BIAS, MAX_LEVEL = 0x0DE1, 0x8501, 0x813D
FORMATS, RGBA8, UNSIGNED_BYTE = {3: 0x1907, 4: 0x1908}, 0x8058, 0x1401

Texels = UInt8[np.ndarray, "height width channels"]


def image_texture(context: Context, image: Texels, *, coarse: bool = False) -> moderngl.Texture:
    """A texture of three or four channels, with the mipmaps of `mip_levels`, that repeats and is filtered.

    coarse: where it is made smaller, one texel of the mip will do on a software rasteriser. Of a network's features
    that is 55 dB from the mean of four, and a sixteenth of the frame.
    """
    height, width, channels = image.shape
    # three bytes a texel are slow to fetch everywhere: the driver keeps four
    texels = np.ascontiguousarray(image)
    texture = context.gl.texture((width, height), channels, texels, alignment=1, internal_format=RGBA8)
    chain = mipmaps(image, mip_levels(image.shape))
    texture.use()
    context.function("glTexParameteri", c_uint, c_uint, c_int)(TEXTURE_2D, MAX_LEVEL, len(chain) - 1)
    upload = context.function("glTexImage2D", c_uint, *(c_int,) * 5, c_uint, c_uint, c_void_p)
    for level, mip in enumerate(chain[1:], 1):
        upload(TEXTURE_2D, level, RGBA8, mip.shape[1], mip.shape[0], 0, FORMATS[channels], UNSIGNED_BYTE,
               mip.ctypes.data)  # fmt: skip
    # nearest mip on software: trilinear fetches cost 1.3-2.5 times as much there (notes: 9-27 against 7-11 ns)
    minify = moderngl.LINEAR_MIPMAP_LINEAR
    if context.software:
        minify = moderngl.NEAREST_MIPMAP_NEAREST if coarse else moderngl.LINEAR_MIPMAP_NEAREST
    texture.filter = (minify, moderngl.LINEAR)
    if not context.software:
        texture.anisotropy = 8.0
    return texture


def mipmapped_bytes(shape: tuple[int, ...]) -> int:
    """Bytes of an `image_texture`, four a texel."""
    height, width = shape[:2]
    return sum(4 * max(height >> i, 1) * max(width >> i, 1) for i in range(mip_levels(shape)))


def read_finer_mip(context: Context, texture: moderngl.Texture) -> None:
    """Set MIP_BIAS on a software rasteriser, as a state of the texture; moderngl has no word for it."""
    if not context.software:
        return
    texture.use()
    context.function("glTexParameterf", c_uint, c_uint, c_float)(TEXTURE_2D, LOD_BIAS, MIP_BIAS)
