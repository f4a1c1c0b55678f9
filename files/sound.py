"""The sound of a WAV file that someone else may have written: whole numbers or floats, its channels mixed.

Python's own reader knows no floats, and extensible headers, under which most programs write 24 bits, from 3.12 on.
"""

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from command.errors import AssetError
from files.input_file import read_bytes, unusable

WHAT = "a sound (.wav, PCM or floats)"
# samples a second
RATES = (8_000, 192_000)
PCM, FLOATS, EXTENSIBLE = 1, 3, 0xFFFE  # tags of formats
# bytes of a sample that each may have
WIDTHS = {PCM: (1, 2, 3, 4), FLOATS: (4, 8)}


class Sound(NamedTuple):
    """One channel of sound, from -1 to 1."""

    samples: Float32[np.ndarray, "samples"]
    rate: int  # samples a second

    @property
    def seconds(self) -> float:
        return len(self.samples) / self.rate


def read_wav(path: Path | str) -> Sound:
    """Read a WAV file; of one that was cut short, what there is.

    Raises:
        AssetError: absent, no WAV, compressed, no sample, one that is not finite, or a rate that is none of a voice.
    """
    data = read_bytes(path, WHAT)
    with unusable(f"{path}: expected {WHAT}, found"):
        form, held = _parts(data)
        tag, channels, rate, _, _, bits = struct.unpack_from("<HHIIHH", form)
        if tag == EXTENSIBLE:
            (tag,) = struct.unpack_from("<H", form, 24)
    width = (bits + 7) // 8
    if not (RATES[0] <= rate <= RATES[1] and width in WIDTHS.get(tag, ()) and channels):
        expected = f"{RATES[0]} to {RATES[1]} samples a second, PCM of 8 to 32 bits or floats"
        raise AssetError(f"{path}: expected {expected}, found {rate} of {bits} bits, format {tag}")
    row = channels * width
    count = len(held) // row
    if not count:
        raise AssetError(f"{path}: expected {WHAT} with samples, found none")
    octets = np.frombuffer(held, np.uint8, count * row).reshape(count, channels, width)
    if tag == FLOATS:
        samples = octets.view(f"<f{width}")[..., 0].mean(1, dtype=np.float64)
        # false for what is not finite; louder by far than any file's unit
        if not (np.abs(samples) < 1e10).all():
            raise AssetError(f"{path}: expected {WHAT}, found samples that are not finite")
        return Sound(samples.astype(np.float32), rate)
    if width == 1:
        return Sound(octets[..., 0].mean(1, dtype=np.float32) / 128 - 1, rate)
    # whole numbers of 4 bytes, their lowest ones 0
    whole = np.zeros((count, channels, 4), np.uint8)
    whole[..., 4 - width :] = octets
    return Sound((whole.view("<i4")[..., 0].mean(1) / 2**31).astype(np.float32), rate)


def _parts(data: bytes) -> tuple[bytes, bytes]:
    """What a WAV file says of its format, and its samples."""
    if data[:4] != b"RIFF" or data[8:12] != b"WAVE":
        raise ValueError("no WAV file")
    at, form = 12, b""
    while at + 8 <= len(data):
        name, size = struct.unpack_from("<4sI", data, at)
        part = data[at + 8 : at + 8 + size]
        if name == b"data" and form:
            return form, part
        form = part if name == b"fmt " else form
        # parts begin at even places
        at += 8 + size + size % 2
    raise ValueError("no samples after their format")
