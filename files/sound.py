"""The sound of a WAV file that someone else may have written: PCM of 8 to 32 bits, its channels mixed."""

import io
import wave
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from command.errors import AssetError
from files.input_file import read_bytes, unusable

WHAT = "a sound (.wav, PCM)"
# samples a second
RATES = (8_000, 192_000)


class Sound(NamedTuple):
    """One channel of sound, from -1 to 1."""

    samples: Float32[np.ndarray, "samples"]
    rate: int  # samples a second

    @property
    def seconds(self) -> float:
        return len(self.samples) / self.rate


def read_wav(path: Path | str) -> Sound:
    """Read a WAV file.

    Raises:
        AssetError: absent, no WAV, another encoding than PCM, no sample, or a rate that is none of a voice.
    """
    data = read_bytes(path, WHAT)
    with unusable(f"{path}: expected {WHAT}, found"), wave.open(io.BytesIO(data)) as file:
        channels, width, rate = file.getnchannels(), file.getsampwidth(), file.getframerate()
        held = file.readframes(file.getnframes())
    if not (RATES[0] <= rate <= RATES[1] and width in (1, 2, 3, 4)):
        expected = f"{RATES[0]} to {RATES[1]} samples a second of 8 to 32 bits"
        raise AssetError(f"{path}: expected {expected}, found {rate} of {8 * width}")
    row = channels * width
    count = len(held) // row
    if not count:
        raise AssetError(f"{path}: expected {WHAT} with samples, found none")
    octets = np.frombuffer(held, np.uint8, count * row).reshape(count, channels, width)
    if width == 1:
        return Sound(octets[..., 0].mean(1, dtype=np.float32) / 128 - 1, rate)
    # whole numbers of 4 bytes, their lowest ones 0
    whole = np.zeros((count, channels, 4), np.uint8)
    whole[..., 4 - width :] = octets
    return Sound((whole.view("<i4")[..., 0].mean(1) / 2**31).astype(np.float32), rate)
