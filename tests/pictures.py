"""Pictures that were written, read again, and writers of PNG, Radiance and small films."""

import struct
import zlib
from collections.abc import Mapping, Sequence
from fractions import Fraction
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


def greys(levels=range(0, 250, 50)) -> list[np.ndarray]:
    return [np.full((48, 64, 3), level, np.uint8) for level in levels]


def film(
    path: Path,
    pictures: Sequence[np.ndarray] = greys(),
    metadata: Mapping[str, str] = {},
    aspect: Fraction = Fraction(1),
) -> None:
    """Pictures of one size at 25 a second, what a phone writes beside them, and a pixel's width over its height."""
    import av

    kind, settings = ("mpeg4", {}) if path.suffix == ".avi" else ("libx264", {"crf": "4", "bf": "2"})
    with av.open(str(path), "w", options={"movflags": "use_metadata_tags"} if metadata else {}) as container:
        container.metadata.update(metadata)
        stream = container.add_stream(kind, rate=25, options=settings)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.codec_context.sample_aspect_ratio = "yuv420p", aspect
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, "rgb24")))
        container.mux(stream.encode(None))


def rgbe(light):
    """(H, W, 3) linear light as mantissas and a shared exponent."""
    largest = light.max(-1)
    exponent = np.where(largest > 1e-30, np.frexp(np.maximum(largest, 1e-30))[1], -128)
    scale = np.ldexp(256.0, -exponent)
    mantissa = np.floor(np.minimum(light * scale[..., None], 255.0))
    return np.dstack([mantissa, np.maximum(exponent + 128, 0)]).astype(np.uint8)


def runs(row):
    """One channel of a row in Radiance's run-length code."""
    out, at = bytearray(), 0
    while at < len(row):
        same = at + 1
        while same < len(row) and row[same] == row[at] and same - at < 127:
            same += 1
        if same - at > 2:
            out += bytes([128 + same - at, row[at]])
            at = same
            continue
        end = at + 1
        while (
            end < len(row) and end - at < 128 and not (end + 2 < len(row) and row[end] == row[end + 1] == row[end + 2])
        ):
            end += 1
        out += bytes([end - at]) + bytes(row[at:end])
        at = end
    return bytes(out)


def radiance_bytes(light, *, flat=False, magic=b"#?RADIANCE"):
    """The file: run-length coded, or flat."""
    height, width = light.shape[:2]
    head = magic + b"\nFORMAT=32-bit_rle_rgbe\n\n" + f"-Y {height} +X {width}\n".encode()
    pixels = rgbe(light)
    if flat:
        return head + pixels.tobytes()
    rows = b""
    for row in pixels:
        rows += bytes([2, 2, width >> 8, width & 255]) + b"".join(runs(row[:, c].tolist()) for c in range(4))
    return head + rows


def sky(width=256):
    """A clear evening over grey ground, its sun to the left of what the front camera sees, (width / 2, width, 3)."""
    height = width // 2
    v, u = np.mgrid[:height, :width]
    up = np.sin(np.pi * (0.5 - (v + 0.5) / height))
    around = 2 * np.pi * ((u + 0.5) / width - 0.5)
    flat = np.sqrt(1 - up * up)
    direction = np.dstack([np.sin(around) * flat, up, -np.cos(around) * flat])
    sun = np.array([-0.5, 0.25, -1.0])
    toward = np.clip(direction @ (sun / np.linalg.norm(sun)), 0, 1)[..., None]
    height_share = np.clip(up, 0, 1)[..., None]
    air = (1 - height_share) ** 3 * np.array([0.9, 0.62, 0.42]) + (1 - (1 - height_share) ** 3) * np.array(
        [0.12, 0.25, 0.6]
    )
    air = air + toward**16 * np.array([0.8, 0.5, 0.25]) + toward**2000 * np.array([60.0, 45.0, 30.0])
    ground = np.array([0.16, 0.15, 0.14]) * (1 + np.clip(up, -1, 0)[..., None] * 0.6)
    return np.where(up[..., None] >= 0, air, ground)
