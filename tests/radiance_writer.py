"""Writes Radiance pictures: what tests of the reader read, and docs/scenes/sky.hdr."""

import numpy as np


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
