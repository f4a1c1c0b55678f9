"""The shirt's cloth: stripes and a badge, or a plaid with buttons; collar, cuffs and seams."""

import numpy as np
from jaxtyping import Float

from experiments.builtin.canvas import Canvas, mixed, shaded, srgb, weave
from experiments.builtin.hems import hem_height, sleeves
from experiments.builtin.looks import Looks
from experiments.builtin.noise import noise
from synth.people.mesh import smoothstep

Array = np.ndarray


def paint_shirt(c: Canvas, joints: Float[Array, "52 3"], looks: Looks) -> Float[Array, "n 3"]:
    """The shirt; sRGB, 0 to 1."""
    p, seed = c.p, looks.seed + 100
    x, y, z = p.T
    middle = joints[0, 0]
    arm = sleeves(p, joints, looks)
    shoulder = abs(joints[16, 0]) - 0.012
    above = np.where(arm < 0.29, 1.0, y - hem_height(joints, looks))
    armhole = np.abs(x - middle) - (shoulder + 0.10 * np.maximum(joints[16, 1] - y, 0))
    on_sleeve = armhole > 0
    light, dark = (srgb(rgb) for rgb in looks.shirt)
    wobble = 0.0012 * noise(p * 30, seed + 3)
    if looks.pattern == "stripes":
        along = np.where(on_sleeve, np.abs(x - middle) - shoulder, y - hem_height(joints, looks)) + wobble
        phase = (along / 0.034 + 0.62) % 1
        band = smoothstep(0.0, 0.03, phase) * smoothstep(0.36, 0.33, phase)
        plain = np.where(on_sleeve, 0.0, smoothstep(0.395, 0.40, y - hem_height(joints, looks)))
        color = mixed(np.broadcast_to(light, p.shape), dark, band * (1 - plain))
    else:
        torso = 0.13 * np.arctan2(x - middle, z - joints[6, 2] + 0.01)
        round_arm = 0.05 * np.arctan2(z - joints[16, 2], y - joints[16, 1])
        s = np.where(on_sleeve, np.abs(x - middle) - shoulder, y) + wobble
        t = np.where(on_sleeve, round_arm, torso) + wobble
        color = np.broadcast_to(light, p.shape).copy()
        for value in (s, t):
            phase = (value / 0.062) % 1
            wide = smoothstep(0.0, 0.015, phase) * smoothstep(0.42, 0.405, phase)
            twill = 0.52 + 0.10 * noise(np.stack([(s + t) * 900, (s - t) * 120, 0 * s], -1), seed + 9)
            color = mixed(color, dark, wide * twill)
        for value in (s, t):
            phase = (value / 0.062) % 1
            thin = smoothstep(0.685, 0.695, phase) * smoothstep(0.735, 0.725, phase)
            color = mixed(color, np.array([0.90, 0.84, 0.70], np.float32), 0.62 * thin)
    color = color * (1 + 0.055 * weave(p, seed))[:, None]
    # collar, cuffs and hem, their stitches, and the armhole's seam
    rib = 1 + 0.10 * np.sin(np.arctan2(x - middle, z) * 160)
    trim = dark if looks.pattern == "stripes" else light * 0.72
    collar = smoothstep(0.0185, 0.0175, c.collar)
    color = mixed(color, trim * rib[:, None], collar)
    cuff = smoothstep(0.0185, 0.0175, arm) if looks.pattern == "stripes" else smoothstep(0.036, 0.035, arm)
    color = mixed(color, trim * (1 + 0.05 * weave(p, seed + 5))[:, None], cuff)
    shade = 0.35 * np.exp(-((armhole / 0.0014) ** 2)) * (arm < 0.29)
    shade = (
        shade
        + 0.45 * np.exp(-(((c.collar - 0.0195) / 0.0012) ** 2))
        + 0.4 * np.exp(-(((arm - cuff_width(looks)) / 0.0012) ** 2))
    )
    shade = shade + 0.25 * np.exp(-(((above - 0.022) / 0.0009) ** 2)) * (above < 0.1)
    color = mixed(color, color * 0.55, shade)
    if looks.pattern == "stripes":
        color = badge(color, p, joints)
    else:
        placket = (z > joints[6, 2]) & (arm > 0.29)
        line = np.exp(-(((np.abs(x - middle) - 0.016) / 0.0009) ** 2)) * placket
        color = mixed(color, color * 0.55, 0.7 * line)
        for k in range(6):
            centre = joints[0, 1] + 0.14 + 0.068 * k
            r = np.hypot(x - middle, y - centre) / 0.0056
            button = smoothstep(1.05, 0.92, r) * placket
            hole = np.zeros(len(p))
            for a, b in ((-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)):
                away = np.hypot((x - middle) / 0.0056 - a, (y - centre) / 0.0056 - b)
                hole = hole + smoothstep(0.2, 0.1, away)
            tone = (
                np.array([0.93, 0.90, 0.84], np.float32) * (1 - 0.25 * smoothstep(0.55, 0.9, r) * (r < 0.95))[:, None]
            )
            color = mixed(color, tone, button)
            color = mixed(color, np.array([0.25, 0.2, 0.18], np.float32), np.clip(hole, 0, 1) * button)
            color = mixed(color, color * 0.5, 0.8 * np.exp(-(((r - 1.15) / 0.14) ** 2)) * placket)
    fold = np.clip(1 + 0.28 * np.clip(c.cavity, -1, 0.5), 0.5, 1.2)[:, None]
    return shaded(color * fold, c, 0.70)


def cuff_width(looks: Looks) -> float:
    """How far from the hem the cuff's stitches run, metres."""
    return 0.0185 if looks.pattern == "stripes" else 0.036


def badge(color: Float[Array, "n 3"], p: Float[Array, "n 3"], joints: Float[Array, "52 3"]) -> Float[Array, "n 3"]:
    """A small emblem on the left chest: a ring, a hill and a sun."""
    centre = np.array([joints[0, 0] + 0.085, joints[9, 1] + 0.035])
    d = (p[:, :2] - centre) / 0.021
    r = np.hypot(*d.T)
    front = p[:, 2] > joints[9, 2] + 0.02
    inside = smoothstep(1.02, 0.97, r) * front
    color = mixed(color, np.array([0.93, 0.91, 0.86], np.float32), inside)
    hill = smoothstep(-0.02, 0.02, 0.35 * np.sin(d[:, 0] * 2.6 + 0.6) - 0.22 - d[:, 1]) * (r < 0.80)
    color = mixed(color, np.array([0.16, 0.45, 0.38], np.float32), hill * inside)
    sun = smoothstep(0.27, 0.23, np.hypot(d[:, 0] - 0.22, d[:, 1] - 0.32)) * (1 - hill)
    color = mixed(color, np.array([0.93, 0.58, 0.16], np.float32), sun * inside)
    ring = smoothstep(0.80, 0.84, r) * inside
    return mixed(color, np.array([0.72, 0.18, 0.16], np.float32), ring)
