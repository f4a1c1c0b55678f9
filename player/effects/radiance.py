"""Radiance pictures (.hdr, .pic): linear light of any brightness, three bytes and a shared exponent a pixel.

Format: G. Ward, "Real Pixels", Graphics Gems II, 1991; the run-length code is that of Radiance's color.c.
"""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8

from command.errors import AssetError
from files.input_file import read_bytes

MAGIC = (b"#?RADIANCE", b"#?RGBE")
RESOLUTION = re.compile(rb"-Y (\d{1,6}) \+X (\d{1,6})\Z")
HEADER_LIMIT = 64 * 1024  # bytes; a header is a few lines
PIXEL_LIMIT = 8192 * 4096  # 400 MB as floats


def read_radiance(path: Path | str) -> Float32[np.ndarray, "height width 3"]:
    """Linear RGB, row 0 on top.

    Raises:
        AssetError: not such a file, cut short, or rows in another order than top to bottom, left to right.
    """
    path = Path(path)
    data = read_bytes(path, "a Radiance picture")
    if not data.startswith(MAGIC):
        raise AssetError(f"{path}: should begin with #?RADIANCE or #?RGBE, begins with {data[:10]!r}")
    end = data.find(b"\n\n", 0, HEADER_LIMIT)
    last = data.find(b"\n", end + 2, end + 2 + 200) if end >= 0 else -1
    if last < 0:
        raise AssetError(f"{path}: expected a header that ends with an empty line and a line of the size")
    form = re.search(rb"^FORMAT=(.*)$", data[:end], re.MULTILINE)
    if form is not None and form[1].strip() != b"32-bit_rle_rgbe":
        raise AssetError(f"{path}: FORMAT should be 32-bit_rle_rgbe, is {form[1].strip()[:40]!r}")
    size = RESOLUTION.match(data[end + 2 : last].strip())
    if size is None:
        raise AssetError(f"{path}: size should read -Y HEIGHT +X WIDTH, reads {data[end + 2 : last][:60]!r}")
    height, width = int(size[1]), int(size[2])
    if not (0 < height * width <= PIXEL_LIMIT):
        raise AssetError(f"{path}: {width}x{height} pixels; expected 1 to {PIXEL_LIMIT}")
    return _linear(_scanlines(data, last + 1, height, width, path))


def _linear(rgbe: UInt8[np.ndarray, "height width 4"]) -> Float32[np.ndarray, "height width 3"]:
    """(mantissa + 1/2) 2^(exponent - 136); exponent 0 is black."""
    exponent = np.arange(256)
    scale = np.where(exponent > 0, np.ldexp(1.0, exponent - 136), 0.0).astype(np.float32)
    out = rgbe[..., :3].astype(np.float32)
    out += np.float32(0.5)
    out *= scale[rgbe[..., 3:]]
    return out


def _scanlines(data: bytes, at: int, height: int, width: int, path: Path) -> UInt8[np.ndarray, "height width 4"]:
    """Pixels of all rows; each is coded in runs per channel, or else flat."""
    short = AssetError(f"{path}: the file ends before its {width}x{height} pixels")
    if not (8 <= width < 32768 and data[at : at + 2] == b"\2\2"):
        flat = np.frombuffer(data, np.uint8, offset=at)
        if len(flat) < 4 * width * height:
            raise short
        return flat[: 4 * width * height].reshape(height, width, 4)
    out = np.empty((height, 4, width), np.uint8)
    for y in range(height):
        if len(data) < at + 4:
            raise short
        if data[at : at + 4] != bytes((2, 2, width >> 8, width & 255)):
            raise AssetError(f"{path}: row {y} should begin with 2, 2 and its width, begins with {data[at : at + 4]!r}")
        at += 4
        for channel in range(4):
            row, x = out[y, channel], 0
            while x < width:
                count = data[at] if at < len(data) else 0
                # a run of one value
                if count > 128:
                    count, used = count - 128, 1
                else:
                    used = count
                if count == 0 or x + count > width or at + 1 + used > len(data):
                    raise short if at + 1 + used > len(data) else AssetError(f"{path}: row {y}: a broken run")
                row[x : x + count] = np.frombuffer(data, np.uint8, used, at + 1)
                x, at = x + count, at + 1 + used
    return out.transpose(0, 2, 1)
