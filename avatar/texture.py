"""Textures in NumPy: samples exactly as OpenGL's bilinear filter reads them, mipmaps as the player draws them, and the
sRGB curve: what a byte of a picture means in linear light (IEC 61966-2-1).
"""

import numpy as np
from jaxtyping import Float, Shaped, UInt8
from numpy import ndarray as Array
from PIL import Image

# an image of any size
Texels = UInt8[Array, "_ _ channels"]


def sample_texture(
    image: Shaped[Array, "height width channels"], uv: Float[Array, "n 2"]
) -> Float[Array, "n channels"]:
    """Bilinear samples, edges clamped; uv as in glTF: (0, 0) is the top left corner of the image, v runs down.

    Values keep the image's scale (bytes come back as 0-255 floats); texel centres lie at (i + .5) / size.
    """
    height, width = image.shape[:2]
    x = np.clip(uv[:, 0] * width - 0.5, 0, width - 1)
    y = np.clip(uv[:, 1] * height - 0.5, 0, height - 1)
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    top = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    bottom = image[y1, x0] * (1 - fx) + image[y1, x1] * fx
    return top * (1 - fy) + bottom * fy


def mip_levels(shape: tuple[int, ...]) -> int:
    """Mipmaps worth having, the texture itself included: coarser ones would mix neighbouring charts.

    The bake leaves gutters of a 256th of the atlas (8 texels at 2048), which stay clean for log2(gutter) levels.
    """
    return min(max(2, max(shape[:2]) // 256).bit_length(), max(shape[:2]).bit_length())


def mipmaps(image: Texels, levels: int) -> list[Texels]:
    """The image and `levels` - 1 more, each half as wide and high: the mean of two by two texels, rounded to bytes.

    As in OpenGL a side of one texel stays and an odd one is rounded down: its last row or column is left out.
    """
    if image.shape[2] > 4:
        first, second = (mipmaps(part, levels) for part in (image[..., :4], image[..., 4:]))
        return [np.concatenate(pair, axis=2) for pair in zip(first, second, strict=True)]
    # Pillow would weight RGBA texels by the last channel
    mode = {1: "L", 3: "RGB", 4: "RGBX"}[image.shape[2]]
    out = [image]
    current = Image.frombuffer(mode, image.shape[1::-1], np.ascontiguousarray(image), "raw", mode, 0, 1)
    for _ in range(levels - 1):
        across, down = (2 if side > 1 else 1 for side in current.size)
        whole = (0, 0, current.width // across * across, current.height // down * down)
        current = current.reduce((across, down), whole)
        out.append(np.array(current).reshape(current.height, current.width, image.shape[2]))
    return out


def linear_from_srgb(shown: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Linear light, 0 to 1, of sRGB values 0 to 1; negative values are taken for 0."""
    shown = np.maximum(shown, 0)
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(linear: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """sRGB values of linear light, the inverse of `linear_from_srgb`; what is over 1 stays over 1."""
    linear = np.maximum(linear, 0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def bytes_of(picture: Float[Array, "*shape"]) -> UInt8[Array, "*shape"]:
    """Colors in [0, 1] as 0 to 255, rounded; beyond the ends the end's own."""
    return np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8)
