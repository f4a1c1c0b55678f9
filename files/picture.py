"""The one place that opens pictures: named formats only, and their size known before a pixel is decoded.

Pillow guesses a format from the content and has some forty of them, one of which (EPS) starts another program.
Here a reader says which formats it takes; a picture of more than MAX_PIXELS is refused by its header. PNG images
that are part of another file: their size before decoding, then the pixels; failures are ValueErrors, to be located.
"""

import io
import struct
import warnings
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array
from PIL import Image, ImageOps

from command.errors import AssetError
from files.input_file import one_line, open_input

# 8192 x 8192: 268 MB as RGBA
MAX_PIXELS = 1 << 26
PHOTOS = ("PNG", "JPEG")
# as glTF and backgrounds may hold
WITH_WEBP = (*PHOTOS, "WEBP")
# Pillow's own limit on pixels is above ours, and only warns
warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)


def read_picture(
    path: Path | str, mode: str | None = "RGB", *, formats: tuple[str, ...] = PHOTOS, upright: bool = False
) -> Array:
    """The pixels of a picture file in a mode of Pillow's ("RGB", "L", "RGBA"; None: as stored), row 0 on top.

    `upright` turns it as its camera was held (EXIF).

    Raises:
        AssetError: absent, no regular file, of another format, larger than MAX_PIXELS, or broken.
    """
    try:
        with open_input(path, f"a picture ({_names(formats)})") as file, opened(file, formats) as image:
            turned = ImageOps.exif_transpose(image) if upright else image
            return np.asarray(turned.convert(mode) if mode else turned)
    except ValueError as error:
        raise AssetError(f"{path}: {error}") from None


def picture_size(path: Path | str, *, formats: tuple[str, ...] = PHOTOS) -> tuple[int, int]:
    """Width and height of a picture file, from its header; AssetError as in `read_picture`."""
    try:
        with open_input(path, f"a picture ({_names(formats)})") as file, opened(file, formats) as image:
            return image.size
    except ValueError as error:
        raise AssetError(f"{path}: {error}") from None


def decode_picture(data: bytes, mode: str | None, *, formats: tuple[str, ...]) -> Array:
    """The pixels of an encoded picture, a part of another file; ValueError as in `opened`."""
    with opened(io.BytesIO(data), formats) as image:
        return np.asarray(image.convert(mode) if mode else image)


@contextmanager
def opened(file: io.BufferedReader | io.BytesIO, formats: tuple[str, ...]) -> Iterator[Image.Image]:
    """A picture with its header read; its pixels are decoded in the block.

    Raises:
        ValueError: of another format, too large, or broken, whatever the decoder raises for it.
    """
    expected = f"expected a picture ({_names(formats)})"
    head = file.read(32)
    file.seek(0)
    _check_size(*_webp_size(head))
    try:
        image = Image.open(file, formats=list(formats))
    except Image.UnidentifiedImageError:
        raise ValueError(f"{expected}, it begins with {head[:12]!r}") from None
    # a decoder of hostile bytes raises what its parts raise: OSError, SyntaxError, struct.error, zlib.error ...
    except Exception as error:
        raise ValueError(f"{expected}, found: {one_line(error)}") from None
    with image:
        _check_size(*image.size)
        try:
            yield image
        except Exception as error:
            raise ValueError(f"{expected}, found: {one_line(error)}") from None


def _check_size(width: int, height: int) -> None:
    if width * height > MAX_PIXELS:
        raise ValueError(f"expected a picture of at most {MAX_PIXELS} pixels, found {width} x {height}")


def _webp_size(head: bytes) -> tuple[int, int]:
    """The size that a WebP file's header claims, 0 for others: its decoder takes memory as soon as it is opened."""
    if head[:4] != b"RIFF" or head[8:12] != b"WEBP":
        return 0, 0
    kind = head[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(head[24:27], "little"), 1 + int.from_bytes(head[27:30], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(head[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    return (int.from_bytes(head[26:28], "little") & 0x3FFF, int.from_bytes(head[28:30], "little") & 0x3FFF)


def _names(formats: tuple[str, ...]) -> str:
    names = ["WebP" if name == "WEBP" else name for name in formats]
    return ", ".join(names[:-1]) + " or " + names[-1] if len(names) > 1 else names[0]


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
