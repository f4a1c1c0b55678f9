"""PNG images as bytes: the size before decoding, then the pixels. Failures are ValueErrors, to be located."""

import io
import struct

import numpy as np
from jaxtyping import UInt8
from PIL import Image

MAX_SIDE = 1 << 15


def encode_png(image: UInt8[np.ndarray, "..."]) -> bytes:
    """An (H, W) grey or (H, W, 3) RGB image, losslessly, without a colour profile."""
    out = io.BytesIO()
    Image.fromarray(image).save(out, format="PNG", compress_level=7)
    return out.getvalue()


def png_pixels(data: bytes) -> int:
    """Width times height from the header: what decoding would cost, known before it is paid."""
    if data[:8] != b"\x89PNG\r\n\x1a\n" or len(data) < 33 or data[12:16] != b"IHDR":
        raise ValueError(f"should be a PNG, begins with {data[:16]!r}")
    width, height = struct.unpack_from(">II", data, 16)
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE):
        raise ValueError(f"should be 1 to {MAX_SIDE} pixels a side, is {width} x {height}")
    return width * height


def decode_png(data: bytes, mode: str) -> UInt8[np.ndarray, "..."]:
    """The pixels of an 8-bit PNG of this mode: "L" (grey) or "RGB"."""
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            found, pixels = image.mode, np.array(image)
    except (
        Exception
    ) as error:  # a decoder of hostile bytes raises what its parts raise: OSError, SyntaxError, zlib
        raise ValueError(f"should be a whole PNG: {error}") from None
    if found != mode or pixels.dtype != np.uint8:
        raise ValueError(f"should be an 8-bit {mode} PNG, is {found}")
    return pixels
