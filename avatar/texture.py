"""Reading a texture in NumPy, exactly as OpenGL's bilinear filter reads it,
and its mipmaps as the player draws them.
"""

import numpy as np
from jaxtyping import Float, Shaped, UInt8
from PIL import Image

Array = np.ndarray
# of a size of its own
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
    # of RGBA Pillow would weight the texels by the last one
    mode = {1: "L", 3: "RGB", 4: "RGBX"}[image.shape[2]]
    out = [image]
    current = Image.frombuffer(mode, image.shape[1::-1], np.ascontiguousarray(image), "raw", mode, 0, 1)
    for _ in range(levels - 1):
        across, down = (2 if side > 1 else 1 for side in current.size)
        whole = (0, 0, current.width // across * across, current.height // down * down)
        current = current.reduce((across, down), whole)
        out.append(np.array(current).reshape(current.height, current.width, image.shape[2]))
    return out
