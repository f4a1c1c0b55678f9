"""PNG images as bytes: the size before decoding, then the pixels. Failures are ValueErrors, to be located."""

import io
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from avatar.picture import decode_picture

MAX_SIDE = 1 << 15


def encode_png(image: UInt8[np.ndarray, "..."]) -> bytes:
    """An (H, W) grey or (H, W, 3) RGB image, losslessly, without a colour profile."""
    out = io.BytesIO()
    Image.fromarray(image).save(out, format="PNG", compress_level=6)
    return out.getvalue()


def png_pixels(data: bytes) -> int:
    """Width times height from the header: what decoding would cost, known before it is paid."""
    width, height, *_ = _header(data)
    return width * height


def decode_png(data: bytes, mode: str) -> UInt8[np.ndarray, "..."]:
    """The pixels of an 8-bit PNG without interlacing, of this mode: "L" (grey) or "RGB"."""
    width, height, depth, color, interlace = _header(data)
    found = {0: "L", 2: "RGB", 3: "palette", 4: "LA", 6: "RGBA"}.get(color, f"colour type {color}")
    if (found, depth, interlace) != (mode, 8, 0):
        kind = f"{depth}-bit {found}{' interlaced' if interlace else ''}"
        raise ValueError(f"should be an 8-bit {mode} PNG, is {kind}")
    size = (1 + width * len(mode)) * height  # each row begins with its filter
    with ThreadPoolExecutor(1) as beside:
        # a third of the time that decoding takes
        found_size = beside.submit(_inflated_size, data, size)
        try:
            pixels = decode_picture(data, None, formats=("PNG",))
        except ValueError as error:
            raise ValueError(f"should be a whole PNG: {error}") from None
        # Pillow fills what is missing with black
        if found_size.result() != size:
            raise ValueError(f"should be a whole PNG of {width} x {height} pixels, has other data")
    return pixels


def _header(data: bytes) -> tuple[int, int, int, int, int]:
    """Width, height, bit depth, colour type and interlacing."""
    if data[:8] != b"\x89PNG\r\n\x1a\n" or len(data) < 33 or data[12:16] != b"IHDR":
        raise ValueError(f"should be a PNG, begins with {data[:16]!r}")
    width, height, depth, color, _, _, interlace = struct.unpack_from(">IIBBBBB", data, 16)
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE):
        raise ValueError(f"should be 1 to {MAX_SIDE} pixels a side, is {width} x {height}")
    return width, height, depth, color, interlace


def _inflated_size(data: bytes, enough: int) -> int:
    """How many bytes the image data decompresses to, counted no further than one beyond `enough`."""
    inflate, size, at = zlib.decompressobj(), 0, 8
    try:
        while at + 12 <= len(data) and size <= enough and not inflate.eof:
            length, kind = struct.unpack_from(">I4s", data, at)
            if kind == b"IDAT":
                size += len(inflate.decompress(data[at + 8 : at + 8 + length], enough + 1 - size))
            at += 12 + length
    except zlib.error as error:
        raise ValueError(f"should be a whole PNG: {error}") from None
    return size
