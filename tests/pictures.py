"""Pictures that were written, read again."""

import struct
import zlib
from pathlib import Path

import numpy as np
from PIL import Image


def pixels(path: Path) -> np.ndarray:
    """A picture's values as they are stored, int."""
    with Image.open(path) as image:
        return np.asarray(image).astype(int)


def pictures_in(folder: Path) -> list[np.ndarray]:
    """The pictures of a folder, in order."""
    return [pixels(file) for file in sorted(folder.glob("*.png"))]


def png(width: int, height: int, rows: bytes = b"", color: int = 0) -> bytes:
    """A PNG of a color type of its format (0 is grey) that claims a size, whatever its rows hold."""
    parts = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, color, 0, 0, 0)), (b"IDAT", zlib.compress(rows))]
    chunks = [
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in [*parts, (b"IEND", b"")]
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)
