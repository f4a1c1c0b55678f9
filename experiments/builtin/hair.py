"""Hair: where it grows, how thick it is, and its strands.

Frame: pose 0, pelvis at the origin, metres.
"""

import numpy as np
from jaxtyping import Float

from experiments.builtin.canvas import Canvas, mixed, shaded, srgb
from experiments.builtin.cloth import CLOSEST
from experiments.builtin.face import Face
from experiments.builtin.looks import Looks
from experiments.builtin.noise import noise
from synth.people.mesh import smoothstep

Array = np.ndarray

# in the side view: metres before the ears, metres over the eyes
MALE_HAIRLINE = (
    (-0.12, -0.075), (-0.07, -0.068), (-0.045, -0.055), (-0.022, -0.02), (-0.012, 0.018), (0.006, 0.022),
    (0.012, -0.012), (0.022, -0.016), (0.030, 0.012), (0.036, 0.034), (0.052, 0.050), (0.075, 0.066),
)  # fmt: skip
FEMALE_HAIRLINE = (
    (-0.12, -0.055), (-0.07, -0.05), (-0.045, -0.040), (-0.025, -0.012), (-0.012, 0.012), (0.006, 0.020),
    (0.014, 0.006), (0.022, 0.002), (0.030, 0.022), (0.040, 0.040), (0.058, 0.055), (0.08, 0.070),
)  # fmt: skip


def hairline(points: Float[Array, "n 3"], face: Face, looks: Looks) -> Float[Array, "n"]:
    """Metres inside the hairline, about: a curve in the side view, up the temples, round the ear, to the nape."""
    eye = face.eyes.mean(0)
    ear = face.ears.mean(0)
    y, z = points[:, 1] - eye[1], points[:, 2] - ear[2]
    x = np.abs(points[:, 0] - eye[0])
    front = eye[2] + 0.018 - ear[2]
    table = MALE_HAIRLINE if looks.sex == "male" else FEMALE_HAIRLINE
    top = table[-1][1]
    curve = np.array([*table, (front, top), (front + 0.05, top)])
    height = np.interp(z, curve[:, 0], curve[:, 1])
    slope = np.gradient(curve[:, 1], curve[:, 0])
    inside = (y - height) / np.sqrt(1 + np.interp(z, curve[:, 0], slope) ** 2)
    peak = 0.006 * np.exp(-((x / 0.012) ** 2)) - 0.005 * smoothstep(0.02, 0.045, x) * smoothstep(0.04, 0.06, z)
    inside = inside + (peak if looks.sex == "male" else 0.6 * peak)
    # the ear itself stays bare
    for centre in face.ears:
        d = (points - centre - [0, -0.004, 0.002]) / [0.026, 0.043, 0.024]
        inside = np.minimum(inside, (np.linalg.norm(d, axis=1) - 1) * 0.022 + 0.004)
    return np.where(points[:, 1] > eye[1] - 0.10, inside, -0.1)


def hair_thickness(skin: Float[Array, "n 3"], face: Face, looks: Looks, line: Float[Array, "n"]) -> Float[Array, "n"]:
    """How far hair stands off the skin, metres; `line` is the distance inside the hairline."""
    eye, ear = face.eyes.mean(0), face.ears.mean(0)
    y, z, x = skin[:, 1] - eye[1], skin[:, 2] - ear[2], skin[:, 0] - eye[0]
    top = smoothstep(0.035, 0.095, y)
    thick = looks.hair_side + (looks.hair_top - looks.hair_side) * top
    seed = looks.seed + 40
    if looks.sex == "male":
        thick = thick + 0.009 * top * smoothstep(0.02, 0.08, z)  # lifted over the forehead
        thick = thick * (1 - 0.35 * smoothstep(-0.02, -0.07, y) * smoothstep(0.0, -0.04, z))
        flow = np.stack([x * 60 + z * 25, y * 18, z * 24 - x * 20], -1)
        thick = (
            thick
            + top * (0.0045 * noise(flow, seed) + 0.002 * noise(flow * 2.1, seed + 1))
            + 0.001 * noise(skin * 90, seed + 2)
        )
        edge = 0.012
    else:
        part = np.exp(-(((x - 0.022) / 0.006) ** 2)) * smoothstep(0.03, 0.07, y) * smoothstep(-0.03, 0.02, z)
        flow = np.stack([x * 70, y * 20 + z * 12, z * 10], -1)
        thick = thick - 0.0055 * part + 0.0018 * noise(flow, seed)
        centre = np.array([eye[0], eye[1] + 0.015, ear[2] - 0.098])
        away = np.linalg.norm((skin - centre) / [1.0, 0.95, 1.3], axis=1)
        thick = thick + looks.bun * smoothstep(0.052, 0.022, away)
        edge = 0.014
    return np.maximum(thick, CLOSEST + 0.0006) * smoothstep(-0.001, edge, line) ** 0.7


def paint_hair(c: Canvas, face: Face, looks: Looks) -> Float[Array, "n 3"]:
    """Strands combed over, or drawn back into a bun; sRGB, 0 to 1."""
    p, q, n, seed = c.p, c.q, c.n, looks.seed + 90
    eye, ear = face.eyes.mean(0), face.ears.mean(0)
    x, y, z = (q - [eye[0], eye[1], ear[2]]).T
    parting = None
    if looks.sex == "male":
        warp = 0.004 * noise(q * 60, seed + 5)
        over = noise(np.stack([(x + warp) * 620 + z * 130, y * 45, z * 45], -1), seed)
        over += 0.7 * noise(np.stack([(x + warp) * 1500 + z * 300, y * 90, z * 90], -1), seed + 1)
        beside = noise(np.stack([x * 60, y * 70, (z + warp + 0.35 * y) * 700], -1), seed + 2)
        beside += 0.7 * noise(np.stack([x * 60, y * 160, (z + warp + 0.35 * y) * 1600], -1), seed + 3)
        behind = noise(np.stack([(x + warp) * 700, y * 60, z * 60], -1), seed + 4)
        behind += 0.7 * noise(np.stack([(x + warp) * 1600, y * 140, z * 60], -1), seed + 6)
        flank, rear = smoothstep(0.45, 0.8, np.abs(n[:, 0])), smoothstep(-0.3, -0.7, n[:, 2])
        strands = (1 - flank) * ((1 - rear) * over + rear * behind) + flank * beside
        clumps = noise(np.stack([(x + warp) * 150 + z * 40, y * 30, z * 24], -1), seed + 7)
    else:
        bun = np.array([0.0, 0.015, -0.112])
        dx, dy, dz = x - bun[0], y - bun[1], z - bun[2]
        turn = np.arctan2(dx, dy)
        reach = np.sqrt(dx * dx + dy * dy + dz * dz)
        warp = 0.05 * noise(q * 40, seed + 5)
        strands = noise(np.stack([(turn + warp) * 60, reach * 30, 0 * turn], -1), seed)
        strands += 0.7 * noise(np.stack([(turn + warp) * 140, reach * 60, 0 * turn + 3], -1), seed + 1)
        coil = np.hypot(dx, dy)
        twist = noise(np.stack([coil * 900 + turn * 1.6 + 30 * warp, turn * 2.0, 0 * turn + 9], -1), seed + 2)
        twist += 0.6 * noise(np.stack([coil * 2000 + turn * 3, turn * 4, 0 * turn + 5], -1), seed + 3)
        inside = smoothstep(0.045, 0.037, coil) * smoothstep(0.02, -0.02, dz - 0.02) * (z < -0.05)
        strands = (1 - inside) * strands + inside * twist
        clumps = noise(np.stack([(turn + warp) * 18, reach * 12, 0 * turn + 7], -1), seed + 7)
        rim = np.exp(-(((coil - 0.041) / 0.004) ** 2)) * (z < -0.05)
        strands = strands - 1.1 * rim
        middle = x - 0.022 + 0.002 * noise(q * 120, seed + 8)
        parting = np.exp(-((middle / 0.0016) ** 2))
        parting *= smoothstep(0.055, 0.075, y) * smoothstep(-0.03, 0.0, z)
    base = srgb(looks.hair)
    tone = 1 + 0.26 * strands + 0.16 * clumps
    shine = np.exp(-(((n[:, 1] - 0.62 + 0.10 * strands) / 0.16) ** 2)) * (0.55 + 0.45 * strands)
    color = base * np.clip(tone, 0.35, 1.7)[:, None] + shine[:, None] * np.array([0.13, 0.105, 0.08], np.float32)
    if parting is not None:
        color = mixed(color, srgb(looks.skin) * 0.74, 0.55 * parting)
    # at the hairline skin shows between the roots
    ragged = c.hair + 0.0028 * noise(p * 300, seed + 9) + 0.0016 * strands
    see = smoothstep(0.0034, -0.0005, ragged) * (0.85 - 0.5 * smoothstep(-0.3, 0.4, strands))
    color = mixed(color, srgb(looks.skin) * np.array([0.80, 0.72, 0.68], np.float32), see)
    return shaded(color, c, 0.75)
