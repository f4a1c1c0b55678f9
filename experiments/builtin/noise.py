"""Seeded noise that surfaces and painters are drawn with, the same on every machine."""

import numpy as np
from jaxtyping import Float, UInt32

Array = np.ndarray


def _mixed(h: UInt32[Array, "*n"]) -> Float[Array, "*n"]:
    """Integer mixing (Wang 2007) of unsigned 32-bit numbers, to [-1, 1]: no generator state."""
    h = (h ^ np.uint32(61)) ^ (h >> np.uint32(16))
    h = h * np.uint32(9)
    h = h ^ (h >> np.uint32(4))
    h = h * np.uint32(0x27D4EB2D)
    h = h ^ (h >> np.uint32(15))
    return h.astype(np.float32) * np.float32(1 / 2147483648.0) - np.float32(1.0)


def noise(points: Float[Array, "n 3"], seed: int) -> Float[Array, "n"]:
    """Value noise in [-1, 1], one lattice cell per unit, quintic between lattice points."""
    out = np.empty(len(points), np.float32)
    # a block fits the cache
    for start in range(0, len(points), 32768):
        block = points[start : start + 32768]
        cell = np.floor(block)
        t = (block - cell).astype(np.float32).T
        t = t * t * t * (t * (t * 6 - 15) + 10)
        i, j, k = (cell.T.astype(np.int64) & 0xFFFFFFFF).astype(np.uint32)
        primes = [np.uint32(73856093), np.uint32(19349663), np.uint32(83492791)]
        salt = np.uint32(seed * 2654435761 & 0xFFFFFFFF)
        ends = [(n * prime, (n + np.uint32(1)) * prime) for n, prime in zip((i, j, k), primes)]
        value = np.zeros(len(block), np.float32)
        for a in range(2):
            for b in range(2):
                weight = (t[0] if a else 1 - t[0]) * (t[1] if b else 1 - t[1])
                row = ends[0][a] ^ ends[1][b] ^ salt
                low, high = _mixed(row ^ ends[2][0]), _mixed(row ^ ends[2][1])
                value += weight * (low + t[2] * (high - low))
        out[start : start + 32768] = value
    return out


def fractal(points: Float[Array, "n 3"], seed: int, octaves: int) -> Float[Array, "n"]:
    """Octaves of noise, each twice as fine and half as strong as the one before."""
    total = np.zeros(len(points), np.float32)
    for n in range(octaves):
        total += noise(points * 2**n + 17.3 * n, seed + n) * 0.5**n
    return total / (2 - 0.5 ** (octaves - 1))
