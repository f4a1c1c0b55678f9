"""Trousers, belt and the inside of hems: denim or plain cloth, pockets, seams and their stitches."""

import numpy as np
from jaxtyping import Float

from experiments.builtin.canvas import Canvas, mixed, shaded, srgb, stitches, weave
from experiments.builtin.hems import hem_height
from experiments.builtin.looks import Looks
from experiments.builtin.noise import fractal, noise
from synth.people.mesh import smoothstep

Array = np.ndarray


def paint_trousers(c: Canvas, joints: Float[Array, "52 3"], looks: Looks) -> Float[Array, "n 3"]:
    """Trousers, or tights where a skirt hangs over them; sRGB, 0 to 1."""
    if looks.skirt is not None:
        rib = np.round(2 * weave(c.p, looks.seed + 200, 500)) * 0.02
        return shaded(srgb(looks.trousers) * (1 + rib)[:, None], c, 0.80)
    p, seed = c.p, looks.seed + 200
    x, y, z = p.T
    middle = joints[0, 0]
    side = np.where(x > middle, 1.0, -1.0)
    hip = np.where(side > 0, joints[1, 0], joints[2, 0])
    knee = np.where(side > 0, joints[4, 0], joints[5, 0])
    t = np.clip((joints[1, 1] - y) / (joints[1, 1] - joints[4, 1]), 0, 1.6)
    axis_x = hip + (knee - hip) * np.minimum(t, 1.0)
    axis_z = joints[1, 2] - 0.012 * smoothstep(0.6, 1.4, t)
    # 0 in front, pi/2 outside
    around = np.arctan2((x - axis_x) * side, z - axis_z)
    base = srgb(looks.trousers)
    if looks.pattern == "stripes":  # denim
        twill = noise(np.stack([(y + x + z) * 420, (y - x) * 90, z * 420], -1), seed + 7)
        slub = noise(np.stack([x * 900, y * 60, z * 900], -1), seed)
        tone = 1 + 0.06 * twill + 0.09 * slub + 0.05 * noise(p * 18, seed + 1)
        worn = 0.55 * np.exp(-(((t - 0.55) / 0.34) ** 2)) * smoothstep(0.25, 0.95, np.cos(around))
        worn += 0.35 * np.exp(-(((t - 1.0) / 0.12) ** 2)) * smoothstep(0.2, 0.9, np.cos(around))
        worn += 0.25 * smoothstep(-0.6, -1.0, np.cos(around)) * np.exp(-(((t - 0.1) / 0.2) ** 2))
        worn *= 0.8 + 0.4 * noise(p * 45, seed + 2)
        color = mixed(base * tone[:, None], np.array([0.50, 0.58, 0.70], np.float32) * tone[:, None], 0.75 * worn)
        thread = np.array([0.74, 0.52, 0.26], np.float32)
    else:
        tone = 1 + 0.05 * weave(p, seed, 1100) + 0.03 * noise(p * 14, seed + 1)
        color = base * tone[:, None]
        thread = base * 0.6
    outside = (np.abs(around) - np.pi / 2) * 0.075 * np.sign(around + 1e-9)
    outer = np.where(around > 0, outside, 9.0)
    inner = np.where((around < 0) & (t > 0.05), np.abs(around) - np.pi / 2, 9.0) * 0.07
    shade = 0.5 * np.exp(-((outer / 0.0016) ** 2)) + 0.5 * np.exp(-((inner / 0.0016) ** 2))
    lines = [(outer - 0.005, y, 0.9), (outer - 0.010, y, 0.7)]
    rise = (np.abs(x - middle) < 0.01) & (y < joints[0, 1] + 0.1) & (y > joints[1, 1] - 0.14)
    fly = np.where(rise & (z > 0), x - middle - 0.002, 9.0)
    seat = np.where(rise & (z < 0), x - middle, 9.0)
    shade = shade + 0.6 * np.exp(-((fly / 0.0015) ** 2)) + 0.6 * np.exp(-((seat / 0.0015) ** 2))
    stitch_y = np.where((z > 0) & (y > joints[1, 1] - 0.07) & (x > middle), x - middle - 0.030, 9.0)
    lines += [(stitch_y, y, 0.9), (fly - 0.004, y, 0.8), (seat - 0.004, y, 0.8)]
    top = joints[0, 1] + (0.085 if looks.tucked else 0.05)
    # front pockets: an arc from the waist to the side seam; back pockets: a shield
    arc = np.hypot(np.abs(x - middle) - 0.175, y - top + 0.01) - 0.085
    pocket = np.where((z > joints[1, 2] + 0.005) & (y > joints[1, 1] - 0.08), arc, 9.0)
    shade = shade + 0.7 * np.exp(-((pocket / 0.0016) ** 2))
    lines += [(pocket + 0.004, x, 0.9), (pocket + 0.010, x, 0.7)]
    bx, by = np.abs(np.abs(x - middle) - 0.080) - 0.058, y - (joints[1, 1] - 0.005)
    shield = np.maximum(
        bx + 0.10 * np.maximum(-by, 0), np.maximum(by - 0.055, -by - 0.075 + 0.35 * np.maximum(bx + 0.058, 0))
    )
    shield = np.where(z < joints[1, 2] - 0.03, shield, 9.0)
    shade = shade + 0.65 * np.exp(-((shield / 0.0014) ** 2))
    if looks.pattern == "stripes":
        lines += [(shield + 0.0045, x + y, 0.9)]
        hem = y - (min(joints[7, 1], joints[8, 1]) + 0.004)
        lines += [(np.where(hem < 0.05, hem - 0.020, 9.0), around * 0.07, 0.9)]
    else:
        crease = np.where((t > 0.15) & (np.abs(around) < 0.5), around * 0.07, 9.0)
        color = mixed(color, color * 1.35, 0.5 * np.exp(-(((crease - 0.001) / 0.0016) ** 2)))
        color = mixed(color, color * 0.6, 0.5 * np.exp(-(((crease + 0.002) / 0.0018) ** 2)))
    color = mixed(color, color * 0.5, shade)
    for distance, along, strength in lines:
        color = mixed(color, np.broadcast_to(thread, color.shape), strength * stitches(distance, along))
    fold = np.clip(1 + 0.65 * np.clip(c.cavity, -1, 0.5), 0.4, 1.3)[:, None]
    return shaded(color * fold, c, 0.80)


def paint_belt(c: Canvas, joints: Float[Array, "52 3"], looks: Looks) -> Float[Array, "n 3"]:
    """A leather belt with a buckle; sRGB, 0 to 1."""
    p = c.p
    middle = joints[0, 0]
    y = p[:, 1] - hem_height(joints, looks)
    leather = np.array([0.36, 0.22, 0.13], np.float32) * (1 + 0.10 * fractal(p * 200, looks.seed + 300, 3))[:, None]
    edge = np.minimum(y - 0.001, 0.037 - y)
    leather = mixed(leather, leather * 0.55, smoothstep(0.004, 0.001, edge))
    leather = mixed(
        leather,
        np.array([0.62, 0.48, 0.32], np.float32),
        0.7 * stitches(edge - 0.0055, 0.13 * np.arctan2(p[:, 0], p[:, 2])),
    )
    front = p[:, 2] > 0
    bx, by = np.abs(p[:, 0] - middle) / 0.024, np.abs(y - 0.019) / 0.018
    outer, inner = np.maximum(bx, by), np.maximum(bx / 0.70, by / 0.62)
    buckle = smoothstep(1.0, 0.94, outer) * smoothstep(0.97, 1.03, inner) * front
    pin = ((np.abs(y - 0.019) < 0.0018) & (p[:, 0] - middle < 0.018) & (p[:, 0] - middle > -0.022) & front).astype(
        float
    )
    metal = (
        np.array([0.80, 0.74, 0.58], np.float32) * (0.75 + 0.35 * smoothstep(-1.0, 1.0, (y - 0.019) / 0.018))[:, None]
    )
    color = mixed(leather, metal, np.maximum(buckle, pin))
    return shaded(color, c, 0.8)


def paint_lining(c: Canvas, joints: Float[Array, "52 3"], looks: Looks) -> Float[Array, "n 3"]:
    """The inside of a hem: the garment's color in its own shadow."""
    near_shirt = c.p[:, 1] > hem_height(joints, looks) - 0.02
    color = np.where(
        near_shirt[:, None], srgb(looks.shirt[looks.pattern == "stripes"]) * 0.5, srgb(looks.trousers) * 0.45
    )
    return shaded(color, c, 0.5)
