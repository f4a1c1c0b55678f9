"""The one place that opens pictures: named formats only, and their size known before a pixel is decoded.

Pillow guesses a format from the content and has some forty of them, one of which (EPS) starts another program.
Here a reader says which formats it takes; a picture of more than MAX_PIXELS is refused by its header.
"""

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from avatar.errors import AssetError
from avatar.input_file import one_line, open_input

Array = np.ndarray

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
