"""Pictures of cloth and hair that repeat without a seam: woven grain under stripes, checks, dots, flowers, leaves."""

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from scipy.ndimage import gaussian_filter

from synth.people.looks import Color, Fabric

Picture = UInt8[Array, "_ _ 3"]
Mask = Float[Array, "size size"]

SIZE = 512  # pixels of a picture
TILE = 0.24  # metres that it covers
# so many motifs of this radius, as a share of the picture
MOTIFS = {"dots": (26, 0.045), "flowers": (13, 0.085), "leaves": (20, 0.07)}


def cloth_picture(cloth: Fabric, seed: int) -> Picture:
    """A cloth."""
    rng = np.random.default_rng([seed, 77])
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE
    ground, first, second = np.array(cloth.colors, float)
    color = np.broadcast_to((58.0, 78, 116) if cloth.pattern == "denim" else ground, (SIZE, SIZE, 3))
    if cloth.pattern == "stripes":
        color = _over(_over(color, first, _band(y * 6, 0.42)), second, _band(y * 6 + 0.42, 0.06))
    elif cloth.pattern == "check":
        for along in (3 * x, 3 * y):
            color = _over(color, first, 0.5 * _band(along, 0.45))
        color = _over(color, second, 0.8 * np.maximum(_band(x * 3 + 0.5, 0.05), _band(y * 3 + 0.5, 0.05)))
    elif cloth.pattern in MOTIFS:
        count, radius = MOTIFS[cloth.pattern]
        for k, (cx, cy) in enumerate(_spread(count, rng)):
            dx, dy = (x - cx + 0.5) % 1 - 0.5, (y - cy + 0.5) % 1 - 0.5
            r, turn = np.hypot(dx, dy) / (radius * rng.uniform(0.75, 1.2)), np.arctan2(dy, dx) + rng.uniform(0, 6.28)
            color = _motif(color, cloth.pattern, r, turn, np.array([first if k % 3 else second, second, ground]))
    twill = 0.05 * np.cos(2 * np.pi * 128 * (x + y)) if cloth.pattern == "denim" else 0
    tone = 1 + 0.02 * _noise(rng, 0.8) + twill + 0.025 * _noise(rng, 45.0)
    return np.clip(np.round(color * tone[..., None]), 0, 255).astype(np.uint8)


def _motif(color: Float[Array, "size size 3"], pattern: str, r: Mask, turn: Mask, inks: Array) -> Array:
    """One flower, leaf or dot; `r` is 1 at its edge; `inks`: its own, another, the ground."""
    tint, other, ground = inks
    if pattern == "dots":
        return _over(color, tint, _edge(1 - r))
    if pattern == "leaves":
        u, v = r * np.cos(turn), r * np.sin(turn)
        color = _over(color, tint, _edge(0.42 * (1 - u * u) - np.abs(v)))
        return _over(color, ground, 0.7 * _edge(0.035 - np.abs(v)) * _edge(1 - np.abs(u)))
    color = _over(color, 0.45 * other + 20, _edge(1.25 * np.abs(np.cos(turn)) ** 6 - r))  # two leaves behind
    shaded = tint * (0.8 + 0.25 * np.clip(r, 0, 1))[..., None]
    color = _over(color, shaded, _edge(0.62 + 0.38 * np.abs(np.cos(2.5 * turn)) - r))
    return _over(color, np.array([236, 196, 84.0]), _edge(0.24 - r))


def strands(color: Color, seed: int, curl: bool) -> Picture:
    """Hair: strands that run down, in locks; or curls."""
    rng = np.random.default_rng([seed, 78])
    kinds = ((3.0, 0.9), (1.2, 0.5)) if curl else (((90.0, 0.7), 0.45), ((90.0, 2.0), 0.45), ((90.0, 9.0), 0.4))
    tone = np.sum([strength * _noise(rng, width) for width, strength in kinds], 0)
    shade = np.clip(0.86 + 0.32 * tone, 0.3, 1.7)[..., None]
    return np.clip(np.round(np.array(color) * shade + 14 * np.maximum(shade - 1.1, 0)), 0, 255).astype(np.uint8)


def _noise(rng: np.random.Generator, width: float | tuple[float, float]) -> Mask:
    """Smooth noise of deviation 1 that repeats; its width in pixels, or those down and across."""
    values = gaussian_filter(rng.standard_normal((SIZE, SIZE)), width, mode="wrap")
    return (values - values.mean()) / values.std()


def _spread(count: int, rng: np.random.Generator) -> Float[Array, "count 2"]:
    """Places on the picture that keep apart: each the farthest of forty from those before."""
    places = rng.random((1, 2))
    while len(places) < count:
        tried = rng.random((40, 2))
        apart = np.abs((tried[:, None] - places + 0.5) % 1 - 0.5)
        places = np.r_[places, tried[np.hypot(*apart.T).min(0).argmax()][None]]
    return places


def _over(color: Float[Array, "size size 3"], ink: Array, share: Mask) -> Float[Array, "size size 3"]:
    return color + share[..., None] * (ink - color)


def _edge(inside: Mask) -> Mask:
    """1 where positive, 0 where negative, with a soft edge."""
    return np.clip(0.5 + 12 * inside, 0, 1)


def _band(phase: Mask, width: float) -> Mask:
    """1 in the first `width` of every period."""
    return np.clip(30 * np.minimum(phase % 1, width - phase % 1), 0, 1)
