"""The painted face: blush, lids, beard or freckles, lips, brows and lashes."""

import numpy as np
from jaxtyping import Float

from experiments.builtin.canvas import Canvas, mixed, spot, srgb
from experiments.builtin.face import LID_X, Face
from experiments.builtin.looks import Looks
from experiments.builtin.noise import noise
from synth.people.mesh import smoothstep

Array = np.ndarray


def head_skin(color: Float[Array, "n 3"], c: Canvas, face: Face, looks: Looks) -> Float[Array, "n 3"]:
    """The face and ears on plain skin, and single hairs beyond the hairline; sRGB, 0 to 1."""
    p, seed = c.p, looks.seed
    male = looks.sex == "male"
    eye = face.eyes.mean(0)
    iod = face.eyes[0, 0] - face.eyes[1, 0]
    x, y = p[:, 0] - eye[0], p[:, 1] - eye[1]
    mirrored = np.stack([np.abs(x), y, p[:, 2]], -1)
    front = smoothstep(face.nose[2] - 0.11, face.nose[2] - 0.05, p[:, 2])
    # blood under the cheeks, the nose and the ears
    blush = 0.85 * spot(mirrored, [0.66 * iod, -0.037, face.mouth[2] - 0.008], [0.019, 0.016, 0.03])
    blush += 0.55 * spot(p, face.nose + [0, -0.004, 0], [0.013, 0.012, 0.02]) + 0.25 * spot(p, face.chin, 0.014)
    for ear in face.ears:
        blush += 0.6 * spot(p, ear, [0.02, 0.034, 0.024])
    blush *= 0.85 + 0.3 * noise(p * 90, seed + 30)
    color = mixed(color, color * ([1.0, 0.80, 0.76] if male else [1.01, 0.78, 0.78]), 0.42 * blush)
    # round the eyes: a little darker and cooler, the inner corner most
    for k, centre in enumerate(face.eyes):
        side = (1, -1)[k]
        around = spot(p, centre + [0, -0.002, 0.012], [0.021, 0.0135, 0.03])
        inner = spot(p, centre + [-side * 0.015, -0.001, 0.012], [0.007, 0.010, 0.02])
        bag = spot(p, centre + [0, -0.0150, 0.012], [0.014, 0.003, 0.03])
        color = mixed(color, color * [0.90, 0.80, 0.80], 0.42 * around + 0.40 * inner + 0.22 * bag)
        lid = spot(p, centre + [side * 0.003, 0.0095, 0.012], [0.015, 0.0045, 0.03])
        shadow = np.array([0.80, 0.70, 0.68] if male else [0.74, 0.60, 0.60], np.float32)
        color = mixed(color, color * shadow, (0.45 if male else 0.6) * lid)
    if male:
        color = stubble(color, c, face, looks)
    else:
        freckle = smoothstep(0.48, 0.75, noise(p * 720, seed + 33)) * front
        freckle = freckle * (spot(mirrored, [0.5 * iod, -0.034, face.mouth[2]], [0.03, 0.018, 0.04]) + 0.1)
        color = mixed(color, color * [0.84, 0.70, 0.60], 0.5 * freckle)
    color = lips(color, c, looks)
    # nostrils
    for v in (0.476, 0.4915):
        hole = np.hypot((c.uv[:, 0] - 0.8775) / 0.0030, (c.uv[:, 1] - (1 - v)) / 0.0036)
        color = mixed(color, np.array([0.20, 0.09, 0.08], np.float32), 0.9 * smoothstep(1.25, 0.45, hole))
    color = brows(color, c, face, looks)
    color = lashes(color, c, face, looks)
    # single hairs beyond the hairline
    strand = noise(np.stack([x * 1300, y * 130, p[:, 2] * 260], -1), seed + 35)
    edge = smoothstep(-0.0060, 0.002, c.hair + 0.0022 * noise(p * 200, seed + 36)) * smoothstep(-0.45, 0.25, strand)
    return mixed(color, srgb(looks.hair) * 0.9, 0.85 * edge * (c.hair > -0.02))


def stubble(color: Float[Array, "n 3"], c: Canvas, face: Face, looks: Looks) -> Float[Array, "n 3"]:
    """A shaved beard: bluish, with dots; round the mouth, on the chin and along the jaw to the ears."""
    p = c.p
    eye, ear = face.eyes.mean(0), face.ears.mean(0)
    y = p[:, 1] - face.mouth[1]
    x = np.abs(p[:, 0] - eye[0])
    z = p[:, 2] - ear[2]
    top = np.interp(x, [0, 0.012, 0.024, 0.04, 0.06, 0.075], [0.017, 0.014, -0.004, -0.006, 0.012, 0.045])
    area = smoothstep(0.010, -0.008, y - top) * smoothstep(-0.085, -0.045, y) * smoothstep(0.004, 0.022, z)
    area *= 1 - 0.5 * spot(np.stack([x, y, z * 0], -1), [0.0, -0.013, 0.0], [0.016, 0.004, 1.0])
    dots = smoothstep(0.05, 0.6, noise(p * 1700, looks.seed + 50))
    return mixed(color, color * [0.74, 0.75, 0.78], area * (0.42 + 0.42 * dots))


def lips(color: Float[Array, "n 3"], c: Canvas, looks: Looks) -> Float[Array, "n 3"]:
    """The red of the lips, by texture coordinates: a cupid's bow above, a full curve below, dark between."""
    u, across = c.uv[:, 0], np.abs(c.uv[:, 1] - (1 - 0.4838))
    upper = np.interp(across, [0, 0.0035, 0.010, 0.0165, 0.0215], [0.8975, 0.8958, 0.8985, 0.9035, 0.9085])
    lower = np.interp(across, [0, 0.008, 0.014, 0.0185, 0.0215], [0.9225, 0.9212, 0.9178, 0.9130, 0.9090])
    inside = np.minimum(u - upper, lower - u)
    inside = np.where(across > 0.023, -1, inside)
    wrinkle = noise(np.stack([c.uv[:, 1] * 2600, u * 180, u * 0], -1), looks.seed + 60)
    red = srgb(looks.lips) * (1 + 0.07 * wrinkle + 0.05 * noise(c.p * 260, looks.seed + 61))[:, None]
    shine = np.exp(-(((u - 0.9165) / 0.0022) ** 2)) * np.exp(-((across / 0.010) ** 2))
    red = red * (1 + 0.16 * shine)[:, None]
    red = np.where((u < 0.907)[:, None], red * 0.86, red)
    color = mixed(color, red, smoothstep(-0.0012, 0.0012, inside) * (0.72 if looks.sex == "male" else 0.92))
    gap = (u > 0.9045) & (u < 0.9118) & (across < 0.021)
    line = np.where(gap, smoothstep(0.0035, 0.0014, np.abs(u - 0.9080)), 0)
    return mixed(color, np.array([0.30, 0.11, 0.11], np.float32), 0.85 * line)


def brows(color: Float[Array, "n 3"], c: Canvas, face: Face, looks: Looks) -> Float[Array, "n 3"]:
    """Eyebrows of single hairs along an arch in the front view."""
    male = looks.sex == "male"
    for k, centre in enumerate(face.eyes):
        side = (1, -1)[k]
        x, y = side * (c.p[:, 0] - centre[0]), c.p[:, 1] - centre[1]
        rows = np.flatnonzero((np.abs(x) < 0.04) & (y > 0.005) & (y < 0.045) & (c.p[:, 2] > centre[2] - 0.02))
        if not len(rows):
            continue
        x, y = x[rows], y[rows]
        arch = [
            (-0.022, 0.0185),
            (-0.016, 0.0205),
            (-0.004, 0.0235),
            (0.008, 0.0262),
            (0.018, 0.0245),
            (0.029, 0.0175),
        ]
        if male:
            arch = [(a, b - 0.0030 - 0.0012 * (0 < a < 0.02)) for a, b in arch]
        arch = np.array(arch)
        middle = np.interp(x, arch[:, 0], arch[:, 1])
        half = np.interp(x, [-0.020, -0.015, 0.0, 0.012, 0.030], [0.0020, 0.0040, 0.0040, 0.0031, 0.0006])
        half = half * (1.22 if male else 0.84)
        s = (y - middle) / np.maximum(half, 1e-5)
        ends = smoothstep(-0.0205, -0.0150, x) * smoothstep(0.0305, 0.026, x)
        lean = np.interp(x, [-0.02, -0.005, 0.03], [1.1, 0.45, 0.12])  # hairs rise at the nose, lie down outside
        across = (y - middle) - lean * (x + 0.02)
        hairs = noise(np.stack([across * 1500, (x + lean * y) * 150, x * 0], -1), looks.seed + 70 + k)
        density = smoothstep(1.25, 0.30, np.abs(s) + 0.10 * noise(np.stack([x, y, 0 * x], -1) * 300, looks.seed + 72))
        cover = np.clip(density * ends * (0.82 + 0.45 * hairs), 0, 1)
        dark = srgb(looks.hair) * (0.80 if male else 0.72)
        color[rows] = mixed(color[rows], dark, cover * (0.92 if male else 0.85))
    return color


def lashes(color: Float[Array, "n 3"], c: Canvas, face: Face, looks: Looks) -> Float[Array, "n 3"]:
    """The lids' edges in the front view: a dark line of lashes above, a moist rim and sparse lashes below."""
    male = looks.sex == "male"
    for k, centre in enumerate(face.eyes):
        d = (c.p - centre) * [(1, -1)[k], 1, 1]
        rows = np.flatnonzero((np.abs(d[:, 0]) < 0.018) & (np.abs(d[:, 1]) < 0.016) & (d[:, 2] > 0))
        if not len(rows):
            continue
        x, y = d[rows, 0], d[rows, 1]
        over, under = y - np.interp(x, LID_X, face.lids[k, 0]), y - np.interp(x, LID_X, face.lids[k, 1])
        ends = smoothstep(-0.0135, -0.0105, x) * smoothstep(0.0165, 0.0135, x)
        dark = np.array([0.10, 0.065, 0.055], np.float32)
        wide = (0.0011 if male else 0.0017) * np.interp(x, [-0.012, -0.004, 0.006, 0.0135], [0.55, 0.9, 1.1, 1.35])
        upper = over > -0.0012
        color[rows] = mixed(
            color[rows],
            color[rows] * [0.64, 0.52, 0.48],
            0.5 * smoothstep(0.0048, 0.0012, over) * upper * ends,
        )
        liner = smoothstep(wide + 0.0011, wide, over) * upper * ends
        color[rows] = mixed(color[rows], dark, liner * (0.86 if male else 0.96))
        lower = ~upper & (under < 0.0012)
        moist = np.array([0.66, 0.40, 0.37], np.float32)
        color[rows] = mixed(color[rows], moist, 0.7 * smoothstep(-0.0018, -0.0008, under) * lower * ends)
        strokes = 0.5 + 0.5 * noise(np.stack([x * 1500, y * 120, 0 * x], -1), looks.seed + 75)
        line = smoothstep(-0.0034, -0.0022, under) * smoothstep(-0.0008, -0.0016, under) * lower * ends
        color[rows] = mixed(color[rows], dark, line * strokes * (0.30 if male else 0.50))
        # the fold of the upper lid
        fold = np.exp(-(((over - 0.0062 + 12 * (x - 0.003) ** 2) / 0.0007) ** 2)) * smoothstep(-0.012, -0.006, x)
        fold *= smoothstep(0.017, 0.012, x)
        color[rows] = mixed(color[rows], color[rows] * [0.66, 0.52, 0.48], 0.55 * fold)
    return color
