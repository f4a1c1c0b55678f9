"""The light of a panorama on a matt surface, as ambient and a few lamps.

    E(n) / pi = 1 / pi  integral over all directions of L(w) max(n . w, 0)

is taken at normals all over the sphere and fitted by S(n) = ambient + sum_k strength_k max(n . l_k, 0) with nothing
negative: lamps are found one after another, each where it leaves the least (matching pursuit). Harmonics of the second
order, the usual way, go negative behind a low sun and have to be windowed; lamps cannot, and they throw shadows.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.light import CaptureLight, lamps_of
from avatar.rotation import fibonacci_sphere

ROWS, NORMALS = 32, 256  # rows of the panorama that are added up, and normals that are asked
# a lamp that leaves more than this share of what was left before is none
WORTH = 0.9
DISPLAY = 2.2
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def irradiance(
    panorama: Float[Array, "height width 3"], turn: float, normals: Float[Array, "n 3"]
) -> Float[Array, "n 3"]:
    """E / pi at world normals; `turn` is that of the background, radians."""
    height, width = panorama.shape[:2]
    step = max(height // ROWS, 1)
    rows, columns = height // step, width // step
    light = panorama[: rows * step, : columns * step].astype(np.float64)
    light = light.reshape(rows, step, columns, step, 3).mean((1, 3))
    up = np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)
    around = 2 * np.pi * ((np.arange(columns) + 0.5) / columns - 0.5)
    # what the background shows in front of a camera that looks along -z; turned as it is (player/effects/panorama.py)
    flat = np.cos(up)[:, None]
    x, z = np.sin(around) * flat, -np.cos(around) * flat
    c, s = np.cos(turn), np.sin(turn)
    towards = np.stack([c * x + s * z, np.broadcast_to(np.sin(up)[:, None], x.shape), c * z - s * x], -1)
    solid = np.cos(up)[:, None] * (np.pi / rows) * (2 * np.pi / columns) * np.ones((1, columns))
    cosines = np.maximum(normals @ towards.reshape(-1, 3).T, 0)
    return cosines @ (light * solid[..., None]).reshape(-1, 3) / np.pi


def fitted_light(panorama: Float[Array, "height width 3"], turn: float, *, gamma: float, most: int) -> CaptureLight:
    """The panorama's light as at most `most` lamps and ambient, in the space of `gamma` (avatar/light.py), of mean 1.

    Raises:
        ValueError: the panorama is black.
    """
    normals = fibonacci_sphere(NORMALS)
    bright = irradiance(panorama, turn, normals) @ LUMINANCE
    if not bright.mean() > 0:
        raise ValueError("the panorama is black: it lights nothing")
    # light multiplies linear values; in display values it is about the root
    wanted = (bright / bright.mean()) ** (gamma / DISPLAY)
    wanted = wanted / wanted.mean()
    cosines = np.maximum(normals @ normals.T, 0)
    chosen: list[int] = []
    strengths, left = np.array([1.0]), float(np.linalg.norm(wanted - 1))
    while len(chosen) < most:
        best = None
        for candidate in range(NORMALS):
            basis = np.concatenate([np.ones((NORMALS, 1)), cosines[:, [*chosen, candidate]]], 1)
            found = np.linalg.lstsq(basis, wanted, rcond=None)[0]
            rest = float(np.linalg.norm(basis @ found - wanted))
            if (found >= 0).all() and (best is None or rest < best[0]):
                best = rest, candidate, found
        if best is None or best[0] > WORTH * left or left < 1e-6:
            break
        left, strengths = best[0], best[2]
        chosen.append(best[1])
    return CaptureLight(float(strengths[0]), lamps_of(normals[chosen], strengths[1:]), gamma=gamma, frame="world")
