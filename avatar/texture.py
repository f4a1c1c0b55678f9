"""Reading a texture in NumPy, exactly as OpenGL's bilinear filter reads it."""

import numpy as np
from jaxtyping import Float, Shaped

Array = np.ndarray


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
