"""Pictures of cloth and hair that repeat without a seam: woven grain under stripes, checks, dots, flowers, leaves.

Every picture is one tile of TILE metres.
"""

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import gaussian_filter

from synth.people.looks import Cloth, Color, rgb

Picture = UInt8[np.ndarray, "height width 3"]
Mask = Float[np.ndarray, "size size"]

SIZE = 512
TILE = 0.24


def cloth_picture(cloth: Cloth, seed: int) -> Picture:
    """One tile of a cloth."""
    rng = np.random.default_rng([seed, 77])
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE
    ground, first, second = (rgb(color) for color in cloth.colors)
    color = np.broadcast_to(ground, (SIZE, SIZE, 3))
    if cloth.pattern == "stripes":
        color = _over(color, first, _band(y * 6, 0.42))
        color = _over(color, second, _band(y * 6 + 0.42, 0.06))
    elif cloth.pattern == "check":
        color = _over(color, first, 0.5 * _band(x * 3, 0.45))
        color = _over(color, first, 0.5 * _band(y * 3, 0.45))
        color = _over(color, second, 0.8 * np.maximum(_band(x * 3 + 0.5, 0.05), _band(y * 3 + 0.5, 0.05)))
    elif cloth.pattern == "zigzag":
        color = _over(color, first, _band(y * 5 + np.abs((x * 5) % 1 - 0.5), 0.4))
        color = _over(color, second, _band(y * 5 + 0.5 + np.abs((x * 5) % 1 - 0.5), 0.1))
    elif cloth.pattern in ("dots", "flowers", "leaves"):
        count, radius = {"dots": (26, 0.045), "flowers": (13, 0.085), "leaves": (20, 0.07)}[cloth.pattern]
        for k, (cx, cy) in enumerate(_spread(count, rng)):
            dx, dy = (x - cx + 0.5) % 1 - 0.5, (y - cy + 0.5) % 1 - 0.5
            r, turn = np.hypot(dx, dy) / (radius * rng.uniform(0.75, 1.2)), np.arctan2(dy, dx) + rng.uniform(0, 6.28)
            tint = first if k % 3 else second
            if cloth.pattern == "dots":
                color = _over(color, tint, _edge(1 - r))
            elif cloth.pattern == "flowers":
                color = _over(color, 0.45 * second + 20, _edge(1.25 * np.abs(np.cos(turn)) ** 6 - r))
                petals = 0.62 + 0.38 * np.abs(np.cos(2.5 * turn))
                color = _over(color, tint * (0.8 + 0.25 * np.clip(r, 0, 1))[..., None], _edge(petals - r))
                color = _over(color, np.array([236, 196, 84.0]), _edge(0.24 - r))
            else:
                u, v = r * np.cos(turn), r * np.sin(turn)
                color = _over(color, tint, _edge(0.42 * (1 - u * u) - np.abs(v)))
                color = _over(color, ground, 0.7 * _edge(0.035 - np.abs(v)) * _edge(1 - np.abs(u)))
    grain = rng.standard_normal((SIZE, SIZE))
    if cloth.pattern == "denim":
        color = np.broadcast_to(np.array([58.0, 78.0, 116.0]), color.shape)
        twill = 0.05 * np.cos(2 * np.pi * 128 * (x + y))
        fade = 0.12 * _tone(rng, 60)
    else:
        twill, fade = 0.03 * np.cos(2 * np.pi * 128 * x) * np.cos(2 * np.pi * 128 * y), 0.05 * _tone(rng, 30)
    tone = 1 + 0.05 * gaussian_filter(grain, 0.8, mode="wrap") + twill + 0.4 * fade
    return np.clip(np.round(color * tone[..., None]), 0, 255).astype(np.uint8)


def strands(color: Color, seed: int, curl: bool = False) -> Picture:
    """One tile of hair: strands that run down, in locks; or curls."""
    rng = np.random.default_rng([seed, 78])
    if curl:
        tone = 0.9 * _tone(rng, 3) + 0.5 * _tone(rng, 1.2)
    else:
        tone = 0.0
        for across, strength in ((0.7, 0.45), (2.0, 0.45), (9.0, 0.4)):
            tone = tone + strength * _tone(rng, (90, across))
    shade = np.clip(0.86 + 0.32 * np.asarray(tone), 0.3, 1.7)[..., None]
    return np.clip(np.round(rgb(color) * shade + 14 * np.maximum(shade - 1.1, 0)), 0, 255).astype(np.uint8)


def _tone(rng: np.random.Generator, width: float | tuple[float, float]) -> Mask:
    """Smooth noise of deviation 1 that repeats; its width in pixels, down and across."""
    values = gaussian_filter(rng.standard_normal((SIZE, SIZE)), width, mode="wrap")
    return (values - values.mean()) / values.std()


def _spread(count: int, rng: np.random.Generator) -> Float[np.ndarray, "count 2"]:
    """Places on the tile that keep apart: each the farthest of forty from those before."""
    places = rng.random((1, 2))
    for _ in range(count - 1):
        tried = rng.random((40, 2))
        apart = np.abs((tried[:, None] - places + 0.5) % 1 - 0.5)
        places = np.r_[places, tried[np.hypot(*apart.T).min(0).argmax()][None]]
    return places


def _over(color: Float[np.ndarray, "size size 3"], ink, share: Mask) -> Float[np.ndarray, "size size 3"]:
    return color + np.clip(share, 0, 1)[..., None] * (ink - color)


def _edge(inside: Mask) -> Mask:
    """1 where positive, 0 where negative, with a soft edge."""
    return np.clip(0.5 + 12 * inside, 0, 1)


def _band(phase: Mask, width: float) -> Mask:
    """1 in the first `width` of every period."""
    at = phase % 1
    return np.clip(30 * np.minimum(at, width - at), 0, 1)
