"""The colors of shoes and soles: canvas sneakers with laces, or leather boots."""

import numpy as np
from jaxtyping import Float

from experiments.builtin.canvas import Canvas, mixed, shaded, srgb
from experiments.builtin.looks import Looks
from experiments.builtin.noise import fractal, noise
from synth.people.mesh import smoothstep

Array = np.ndarray


def paint_shoe(c: Canvas, joints: Float[Array, "52 3"], ground: float, looks: Looks) -> Float[Array, "n 3"]:
    """Uppers; sRGB, 0 to 1. `ground` is the y of the soles, metres."""
    q, n, seed = c.q, c.n, looks.seed + 400
    side = np.where(q[:, 0] > joints[0, 0], 0, 1)
    ankle = joints[[7, 8]][side]
    ball = joints[[10, 11]][side]
    x, z = q[:, 0] - ankle[:, 0], q[:, 2] - ankle[:, 2]
    length = ball[:, 2] - ankle[:, 2]
    # 0 at the ankle, 1 at the ball of the foot
    s = z / length
    y = q[:, 1] - ground
    base = srgb(looks.shoes)
    color = base * (1 + 0.05 * fractal(q * 130, seed, 2) + 0.03 * noise(q * 900, seed + 1))[:, None]
    seam = np.zeros(len(q))
    accent = srgb(looks.shirt[1])
    if looks.pattern == "stripes":  # a canvas sneaker
        toe = s - 1.02
        color = mixed(color, base * 1.02, smoothstep(0.0, 0.02, toe))
        seam += np.exp(-((toe / 0.02) ** 2)) + np.exp(-(((toe + 0.05) / 0.012) ** 2)) * 0.6
        heel = smoothstep(-0.28, -0.31, s) * smoothstep(0.10, 0.095, y)
        color = mixed(color, np.broadcast_to(accent, color.shape), heel)
        seam += np.exp(-(((s + 0.27) / 0.012) ** 2))
        swoosh = np.abs((y - 0.052) - 0.10 * (s - 0.25)) - 0.009
        flank = smoothstep(0.45, 0.65, np.abs(n[:, 0])) * smoothstep(-0.2, -0.15, s) * smoothstep(0.85, 0.8, s)
        color = mixed(color, np.broadcast_to(accent, color.shape), smoothstep(0.001, -0.001, swoosh) * flank)
        tongue = (
            smoothstep(0.031, 0.029, np.abs(x))
            * smoothstep(0.25, 0.3, s)
            * smoothstep(0.99, 0.95, s)
            * smoothstep(0.15, 0.4, n[:, 1])
        )
        seam += np.exp(-(((np.abs(x) - 0.029) / 0.0011) ** 2)) * (tongue > 0.02)
        inner = smoothstep(0.016, 0.0145, np.abs(x)) * tongue
        color = mixed(color, base * 0.82, inner)
        row = s / 0.155
        lace = (
            smoothstep(0.34, 0.26, np.abs((row + np.abs(x) * 9) % 1 - 0.5))
            * smoothstep(0.0255, 0.0245, np.abs(x))
            * tongue
        )
        color = mixed(
            color,
            color * 0.35,
            smoothstep(0.50, 0.30, np.abs((row + np.abs(x) * 9) % 1 - 0.5))
            * smoothstep(0.027, 0.0255, np.abs(x))
            * tongue
            * 0.75,
        )
        color = mixed(color, accent * 0.9 + 0.05, lace)
        eyelet = np.hypot((np.abs(x) - 0.0245) / 0.0030, ((row + np.abs(x) * 9) % 1 - 0.5) * 0.155 * length / 0.0030)
        color = mixed(color, np.array([0.22, 0.22, 0.24], np.float32), 0.9 * smoothstep(1.0, 0.7, eyelet) * tongue)
    else:  # a leather ankle boot
        zip_line = np.where((n[:, 0] * np.where(side == 0, -1, 1) > 0.5) & (np.abs(s + 0.02) < 0.04), s + 0.02, 9.0)
        seam += (
            0.9 * np.exp(-((zip_line / 0.018) ** 2))
            + np.exp(-(((s - 0.75) / 0.015) ** 2))
            + np.exp(-(((s + 0.30) / 0.015) ** 2))
        )
        gloss = smoothstep(0.35, 0.95, n[:, 1]) * smoothstep(0.7, 1.2, s)
        color = color * (1 + 0.30 * gloss)[:, None]
    color = mixed(color, color * 0.5, np.clip(seam, 0, 1) * 0.8)
    color = mixed(color, color * 0.55, smoothstep(0.030, 0.022, y) * 0.7)
    return shaded(color, c, 0.8)


def paint_sole(c: Canvas, ground: float, looks: Looks) -> Float[Array, "n 3"]:
    """Rubber with a stripe and a tread; sRGB, 0 to 1. `ground` is the y of the soles, metres."""
    q = c.q
    y = q[:, 1] - ground
    rubber = np.array([0.88, 0.87, 0.84] if looks.pattern == "stripes" else [0.15, 0.12, 0.11], np.float32)
    color = rubber * (1 + 0.05 * noise(q * 300, looks.seed + 410))[:, None]
    stripe = smoothstep(0.0016, 0.0008, np.abs(y - 0.0155))
    color = mixed(color, np.broadcast_to(srgb(looks.shirt[1]), color.shape), stripe * (looks.pattern == "stripes"))
    color = mixed(color, color * 0.45, smoothstep(0.004, 0.0, y))
    tread = smoothstep(-0.8, -0.95, c.n[:, 1]) * smoothstep(-0.2, 0.2, np.sin(q[:, 2] * 500) * np.sin(q[:, 0] * 500))
    return shaded(mixed(color, color * 0.55, tread), c, 0.6)
