"""Painting a dressed body: every texel is coloured by where it lies on the person, not by where it lies in the
picture, so that seams do not show and both sexes share the code.

Texel positions are on the naked body (pose 0, metres) where they are skin or cloth, on the shoe and the hair
where they are those. Colours are sRGB, 0 to 1, with soft sky light and folds painted in.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.ndimage import distance_transform_edt

from bench.synth.dress import (
    BELT,
    EYE,
    HAIR,
    LID_X,
    LINING,
    SHIRT,
    SHOE,
    SKIN,
    SOLE,
    TROUSERS,
    Dressed,
    Face,
    Looks,
    hairline,
    hem_height,
    sleeves,
    smoothstep,
)
from bench.synth.noise import fractal, noise

Array = np.ndarray


@dataclass(frozen=True)
class Texels:
    """The covered texels of one texture and what lies under each."""

    index: Int[Array, " N"]  # row * width + column
    face: Int[Array, " N"]
    barycentric: Float[Array, "N 3"]


def covered_texels(uv: Float[Array, "F 3 2"], size: int, chunk: int = 400_000) -> Texels:
    """Texel centres inside triangles of texture coordinates (v down); the later triangle wins on an edge."""
    pixel = uv * size - 0.5
    low = np.maximum(np.ceil(pixel.min(1) - 1e-9), 0).astype(np.int64)
    high = np.minimum(np.floor(pixel.max(1) + 1e-9), size - 1).astype(np.int64)
    extent = np.maximum(high - low + 1, 0)
    area = extent[:, 0] * extent[:, 1]
    found: list[tuple] = []
    edges = np.searchsorted(np.cumsum(area), np.arange(chunk, area.sum() + chunk, chunk))
    start = 0
    for stop in [*(edges + 1), len(uv)]:
        rows = np.arange(start, min(stop, len(uv)))
        start = max(start, min(stop, len(uv)))
        if not len(rows):
            continue
        face = np.repeat(rows, area[rows])
        step = np.arange(len(face)) - np.repeat(np.cumsum(area[rows]) - area[rows], area[rows])
        x = low[face, 0] + step % np.maximum(extent[face, 0], 1)
        y = low[face, 1] + step // np.maximum(extent[face, 0], 1)
        a, b, c = pixel[face].transpose(1, 0, 2)
        p = np.stack([x, y], -1)

        def cross(u, v):
            return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

        whole = cross(b - a, c - a)
        whole = np.where(np.abs(whole) < 1e-12, np.inf, whole)
        s, t = cross(p - a, c - a) / whole, cross(b - a, p - a) / whole
        inside = (s >= -1e-6) & (t >= -1e-6) & (s + t <= 1 + 1e-6) & np.isfinite(whole)
        s, t = s[inside], t[inside]
        found.append(((y * size + x)[inside], face[inside], np.stack([1 - s - t, s, t], -1)))
    index, face, barycentric = (np.concatenate(parts) for parts in zip(*found))
    owner = np.full(size * size, -1)
    owner[index] = np.arange(len(index))
    kept = owner[owner >= 0]
    return Texels(index[kept], face[kept], barycentric[kept].astype(np.float32))


def spread(image: Float[Array, "H W 3"], covered) -> UInt8[Array, "H W 3"]:
    """Fill what no triangle covers with the nearest colour, so that filtering finds no seam."""
    nearest = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    return np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)[nearest[0], nearest[1]]


@dataclass(frozen=True)
class Canvas:
    """What the painters may ask about the texels they colour."""

    p: Float[Array, "N 3"]  # on the naked body
    q: Float[Array, "N 3"]  # on the dressed person
    n: Float[Array, "N 3"]  # normal of the dressed person
    uv: Float[Array, "N 2"]  # the body's own texture coordinates, v down
    hair: Float[Array, " N"]  # metres inside the hairline
    collar: Float[Array, " N"]  # metres from the collar's edge
    light: Float[Array, " N"]  # 0 to 1
    opened: Float[Array, " N"]  # 0 to 1
    cavity: Float[Array, " N"]  # negative in creases, positive on ridges

    def at(self, rows) -> "Canvas":
        return Canvas(*(value[rows] for value in vars(self).values()))


def _colour(rgb) -> Float[Array, "3"]:
    return np.array(rgb, np.float32) / 255


def _mix(a, b, t):
    t = np.clip(t, 0, 1)[:, None]
    return a * (1 - t) + b * t


def _blob(points, centre, radius):
    """A Gaussian spot of the given radii, metres."""
    return np.exp(-((((points - centre) / radius) ** 2).sum(1)))


def paint(c: Canvas, kind: Int[Array, " N"], dressed: Dressed, joints, looks: Looks) -> Float[Array, "N 3"]:
    """The colour of each texel."""
    out = np.zeros((len(kind), 3), np.float32)
    ground = float(dressed.mesh.vertices[:, 1].min())
    painters = {
        SKIN: lambda x: skin(x, dressed, joints, looks),
        SHIRT: lambda x: shirt(x, joints, looks),
        TROUSERS: lambda x: trousers(x, joints, looks),
        BELT: lambda x: belt(x, joints, looks),
        HAIR: lambda x: hair(x, dressed.face, looks),
        SHOE: lambda x: shoe(x, joints, ground, looks),
        SOLE: lambda x: sole(x, ground, looks),
        LINING: lambda x: lining(x, joints, looks),
    }
    for number, painter in painters.items():
        whole = np.flatnonzero(kind == number)
        for start in range(0, len(whole), 100_000):
            rows = whole[start : start + 100_000]
            some = c.at(rows)
            if number in (SHIRT, TROUSERS, BELT):
                some = replace(some, p=some.q)  # patterns follow the cloth, not the skin below
            out[rows] = painter(some)
    return np.clip(out, 0, 1)


def shaded(colour, c: Canvas, strength: float, tint=(1.0, 1.0, 1.0)):
    """Colour under the baked sky; what is dark takes the tint (light that bled through skin)."""
    dark = np.clip(1 - strength * (1 - c.light / 0.86), 0.12, 1.06)[:, None]
    return colour * dark ** (1 / np.array(tint, np.float32))


# ---- skin ----


def skin(c: Canvas, dressed: Dressed, joints, looks: Looks):
    face, p, seed = dressed.face, c.p, looks.seed
    base = _colour(looks.skin)
    tone = 0.030 * fractal(p * 22, seed + 20, 2) + 0.018 * noise(p * 160, seed + 22) + 0.014 * noise(p * 700, seed + 23)
    colour = base * (1 + tone[:, None] * np.array([0.8, 1.0, 1.1], np.float32))
    red = 0.25 * np.maximum(noise(p * 40, seed + 24), 0)
    colour = _mix(colour, colour * [1.0, 0.86, 0.84], red)
    # elbows, knuckles and finger tips are redder
    for joint in [18, 19]:
        colour = _mix(colour, colour * [0.98, 0.83, 0.80], 0.4 * _blob(p, joints[joint] + [0, 0, -0.03], 0.03))
    colour = hands(colour, c, face, joints, looks)
    head = p[:, 1] > joints[12, 1] - 0.06
    rows = np.flatnonzero(head & (np.abs(p[:, 0] - joints[15, 0]) < 0.15))
    if len(rows):
        colour[rows] = head_skin(colour[rows], c.at(rows), face, looks)
    crease = np.clip(1 + np.clip(c.cavity, -1, 0.2) * 0.11, 0.4, 1.12)[:, None]
    colour = colour * crease ** np.array([0.75, 1.05, 1.1], np.float32)
    return shaded(colour, c, 0.62, (1.35, 0.95, 0.9))


def head_skin(colour, c: Canvas, face: Face, looks: Looks):
    p, seed = c.p, looks.seed
    male = looks.sex == "male"
    eye = face.eyes.mean(0)
    iod = face.eyes[0, 0] - face.eyes[1, 0]
    x, y = p[:, 0] - eye[0], p[:, 1] - eye[1]
    mirrored = np.stack([np.abs(x), y, p[:, 2]], -1)
    front = smoothstep(face.nose[2] - 0.11, face.nose[2] - 0.05, p[:, 2])
    # blood under the cheeks, the nose and the ears
    blush = 0.85 * _blob(mirrored, [0.66 * iod, -0.037, face.mouth[2] - 0.008], [0.019, 0.016, 0.03])
    blush += 0.55 * _blob(p, face.nose + [0, -0.004, 0], [0.013, 0.012, 0.02]) + 0.25 * _blob(p, face.chin, 0.014)
    for ear in face.ears:
        blush += 0.6 * _blob(p, ear, [0.02, 0.034, 0.024])
    blush *= 0.85 + 0.3 * noise(p * 90, seed + 30)
    colour = _mix(colour, colour * ([1.0, 0.80, 0.76] if male else [1.01, 0.78, 0.78]), 0.42 * blush)
    # round the eyes: a little darker and cooler, the inner corner most
    for k, centre in enumerate(face.eyes):
        side = (1, -1)[k]
        around = _blob(p, centre + [0, -0.002, 0.012], [0.021, 0.0135, 0.03])
        inner = _blob(p, centre + [-side * 0.015, -0.001, 0.012], [0.007, 0.010, 0.02])
        bag = _blob(p, centre + [0, -0.0150, 0.012], [0.014, 0.003, 0.03])
        colour = _mix(colour, colour * [0.90, 0.80, 0.80], 0.42 * around + 0.40 * inner + 0.22 * bag)
        lid = _blob(p, centre + [side * 0.003, 0.0095, 0.012], [0.015, 0.0045, 0.03])
        shadow = np.array([0.80, 0.70, 0.68] if male else [0.74, 0.60, 0.60], np.float32)
        colour = _mix(colour, colour * shadow, (0.45 if male else 0.6) * lid)
    if male:
        colour = stubble(colour, c, face, looks)
    else:
        freckle = smoothstep(0.48, 0.75, noise(p * 720, seed + 33)) * front
        freckle = freckle * (_blob(mirrored, [0.5 * iod, -0.034, face.mouth[2]], [0.03, 0.018, 0.04]) + 0.1)
        colour = _mix(colour, colour * [0.84, 0.70, 0.60], 0.5 * freckle)
    colour = lips(colour, c, looks)
    # nostrils
    for v in (0.476, 0.4915):
        hole = np.hypot((c.uv[:, 0] - 0.8775) / 0.0030, (c.uv[:, 1] - (1 - v)) / 0.0036)
        colour = _mix(colour, np.array([0.20, 0.09, 0.08], np.float32), 0.9 * smoothstep(1.25, 0.45, hole))
    colour = brows(colour, c, face, looks)
    colour = lashes(colour, c, face, looks)
    # single hairs beyond the hairline
    strand = noise(np.stack([x * 1300, y * 130, p[:, 2] * 260], -1), seed + 35)
    edge = smoothstep(-0.0060, 0.002, c.hair + 0.0022 * noise(p * 200, seed + 36)) * smoothstep(-0.45, 0.25, strand)
    return _mix(colour, _colour(looks.hair) * 0.9, 0.85 * edge * (c.hair > -0.02))


def stubble(colour, c: Canvas, face: Face, looks: Looks):
    """A shaved beard: bluish, with dots; round the mouth, on the chin and along the jaw to the ears."""
    p = c.p
    eye, ear = face.eyes.mean(0), face.ears.mean(0)
    y = p[:, 1] - face.mouth[1]
    x = np.abs(p[:, 0] - eye[0])
    z = p[:, 2] - ear[2]
    top = np.interp(x, [0, 0.012, 0.024, 0.04, 0.06, 0.075], [0.017, 0.014, -0.004, -0.006, 0.012, 0.045])
    area = smoothstep(0.010, -0.008, y - top) * smoothstep(-0.085, -0.045, y) * smoothstep(0.004, 0.022, z)
    area *= 1 - 0.5 * _blob(np.stack([x, y, z * 0], -1), [0.0, -0.013, 0.0], [0.016, 0.004, 1])
    dots = smoothstep(0.05, 0.6, noise(p * 1700, looks.seed + 50))
    return _mix(colour, colour * [0.74, 0.75, 0.78], area * (0.42 + 0.42 * dots))


def lips(colour, c: Canvas, looks: Looks):
    """The red of the lips, by texture coordinates: a cupid's bow above, a full curve below, dark between."""
    u, across = c.uv[:, 0], np.abs(c.uv[:, 1] - (1 - 0.4838))
    upper = np.interp(across, [0, 0.0035, 0.010, 0.0165, 0.0215], [0.8975, 0.8958, 0.8985, 0.9035, 0.9085])
    lower = np.interp(across, [0, 0.008, 0.014, 0.0185, 0.0215], [0.9225, 0.9212, 0.9178, 0.9130, 0.9090])
    inside = np.minimum(u - upper, lower - u)
    inside = np.where(across > 0.023, -1, inside)
    wrinkle = noise(np.stack([c.uv[:, 1] * 2600, u * 180, u * 0], -1), looks.seed + 60)
    red = _colour(looks.lips) * (1 + 0.07 * wrinkle + 0.05 * noise(c.p * 260, looks.seed + 61))[:, None]
    shine = np.exp(-(((u - 0.9165) / 0.0022) ** 2)) * np.exp(-((across / 0.010) ** 2))
    red = red * (1 + 0.16 * shine)[:, None]
    red = np.where((u < 0.907)[:, None], red * 0.86, red)
    colour = _mix(colour, red, smoothstep(-0.0012, 0.0012, inside) * (0.72 if looks.sex == "male" else 0.92))
    gap = (u > 0.9045) & (u < 0.9118) & (across < 0.021)
    line = np.where(gap, smoothstep(0.0035, 0.0014, np.abs(u - 0.9080)), 0)
    return _mix(colour, np.array([0.30, 0.11, 0.11], np.float32), 0.85 * line)


def brows(colour, c: Canvas, face: Face, looks: Looks):
    """Eyebrows of single hairs along an arch in the front view."""
    male = looks.sex == "male"
    for k, centre in enumerate(face.eyes):
        side = (1, -1)[k]
        x, y = side * (c.p[:, 0] - centre[0]), c.p[:, 1] - centre[1]
        rows = np.flatnonzero((np.abs(x) < 0.04) & (y > 0.005) & (y < 0.045) & (c.p[:, 2] > centre[2] - 0.02))
        if not len(rows):
            continue
        x, y = x[rows], y[rows]
        arch = [(-0.022, 0.0185), (-0.016, 0.0205), (-0.004, 0.0235), (0.008, 0.0262), (0.018, 0.0245), (0.029, 0.0175)]
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
        dark = _colour(looks.hair) * (0.80 if male else 0.72)
        colour[rows] = _mix(colour[rows], dark, cover * (0.92 if male else 0.85))
    return colour


def lashes(colour, c: Canvas, face: Face, looks: Looks):
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
        colour[rows] = _mix(colour[rows], colour[rows] * [0.64, 0.52, 0.48], 0.5 * smoothstep(0.0048, 0.0012, over) * upper * ends)
        liner = smoothstep(wide + 0.0011, wide, over) * upper * ends
        colour[rows] = _mix(colour[rows], dark, liner * (0.86 if male else 0.96))
        lower = ~upper & (under < 0.0012)
        moist = np.array([0.66, 0.40, 0.37], np.float32)
        colour[rows] = _mix(colour[rows], moist, 0.7 * smoothstep(-0.0018, -0.0008, under) * lower * ends)
        strokes = 0.5 + 0.5 * noise(np.stack([x * 1500, y * 120, 0 * x], -1), looks.seed + 75)
        line = smoothstep(-0.0034, -0.0022, under) * smoothstep(-0.0008, -0.0016, under) * lower * ends
        colour[rows] = _mix(colour[rows], dark, line * strokes * (0.30 if male else 0.50))
        # the fold of the upper lid
        fold = np.exp(-(((over - 0.0062 + 12 * (x - 0.003) ** 2) / 0.0007) ** 2)) * smoothstep(-0.012, -0.006, x)
        fold *= smoothstep(0.017, 0.012, x)
        colour[rows] = _mix(colour[rows], colour[rows] * [0.66, 0.52, 0.48], 0.55 * fold)
    return colour


def hands(colour, c: Canvas, face: Face, joints, looks: Looks):
    """Nails, redder finger tips and knuckles, creases at the joints."""
    p, seed = c.p, looks.seed
    near = np.abs(p[:, 0]) > abs(joints[20, 0]) - 0.03
    rows = np.flatnonzero(near)
    if not len(rows):
        return colour
    for first in (22, 37):
        for finger in range(5):
            chain = joints[first + 3 * finger : first + 3 * finger + 3]
            axis = (chain[2] - chain[1]) / np.linalg.norm(chain[2] - chain[1])
            nail = face.nails[np.argmin(np.linalg.norm(face.nails - chain[2], axis=1))]
            near = rows[np.linalg.norm(p[rows] - chain[1], axis=1) < np.linalg.norm(nail - chain[1]) + 0.03]
            q, n, some = p[near], c.n[near], colour[near]
            some = _mix(some, some * [1.02, 0.82, 0.80], 0.5 * _blob(q, nail - 0.003 * axis, 0.011))
            up = np.array([0.0, 1.0, 0.0]) - axis[1] * axis
            up /= np.linalg.norm(up)
            back = smoothstep(0.1, 0.5, n @ up)
            for number, joint in enumerate(chain):
                if finger == 4 and number == 0:
                    continue
                reach = smoothstep(0.016, 0.012, np.linalg.norm(q - joint, axis=1))
                some = _mix(some, some * [0.98, 0.80, 0.77], 0.5 * _blob(q, joint + 0.007 * up, 0.010) * back)
                if number == 0:
                    continue
                wave = (q - joint) @ axis + 0.0006 * noise(q * 400, seed + 80)
                lines = sum(np.exp(-(((wave - o) / 0.0006) ** 2)) for o in (-0.0030, -0.0004, 0.0024))
                some = _mix(some, some * [0.82, 0.68, 0.64], 0.30 * lines * back * reach)
                palm = np.exp(-(((wave - 0.001) / 0.0009) ** 2)) * (1 - back) * reach
                some = _mix(some, some * [0.80, 0.64, 0.60], 0.55 * palm)
            colour[near] = some
    q, n, some = p[rows], c.n[rows], colour[rows]
    for middle in face.nails:
        left = 22 if middle[0] > 0 else 37
        bones = joints[[left + 2, left + 5, left + 8, left + 11, left + 14]]
        finger = int(np.argmin(np.linalg.norm(bones - middle, axis=1)))
        chain = joints[left + 3 * finger : left + 3 * finger + 3]
        axis = (chain[2] - chain[1]) / np.linalg.norm(chain[2] - chain[1])
        up = middle - chain[2] - ((middle - chain[2]) @ axis) * axis
        up /= np.linalg.norm(up)
        side = np.cross(axis, up)
        size = (1.18 if finger == 4 else 0.82 if finger == 2 else 1.0) * (1.0 if looks.sex == "male" else 0.88)
        d = q - middle
        a, b, h = d @ axis / (0.0058 * size), d @ side / (0.0044 * size), d @ up
        shape = (np.abs(a) ** 2.6 + np.abs(b) ** 2.6) ** (1 / 2.6)
        shape = np.where((h < -0.005) | (n @ up < 0.1), 9, shape)
        nail = smoothstep(1.06, 0.95, shape)
        pink = np.array([0.90, 0.68, 0.63], np.float32) if looks.sex == "male" else np.array([0.80, 0.36, 0.40], np.float32)
        gloss = 1 + 0.10 * np.exp(-((b / 0.35) ** 2))
        nail_colour = pink * gloss[:, None]
        if looks.sex == "male":
            nail_colour = _mix(nail_colour, np.array([0.95, 0.88, 0.83], np.float32), smoothstep(0.66, 0.80, a))
            nail_colour = _mix(nail_colour, np.array([0.94, 0.80, 0.77], np.float32), 0.7 * smoothstep(-0.60, -0.78, a + 0.25 * b * b))
        some = _mix(some, nail_colour, nail)
        fold = np.exp(-(((shape - 1.12) / 0.10) ** 2))
        some = _mix(some, some * [0.74, 0.58, 0.54], 0.75 * fold)
    colour[rows] = some
    return colour


# ---- hair ----


def hair(c: Canvas, face: Face, looks: Looks):
    p, q, n, seed = c.p, c.q, c.n, looks.seed + 90
    eye, ear = face.eyes.mean(0), face.ears.mean(0)
    x, y, z = (q - [eye[0], eye[1], ear[2]]).T
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
        parting = np.exp(-(((x - 0.022 + 0.002 * noise(q * 120, seed + 8)) / 0.0016) ** 2))
        parting *= smoothstep(0.055, 0.075, y) * smoothstep(-0.03, 0.0, z)
    base = _colour(looks.hair)
    tone = 1 + 0.26 * strands + 0.16 * clumps
    shine = np.exp(-(((n[:, 1] - 0.62 + 0.10 * strands) / 0.16) ** 2)) * (0.55 + 0.45 * strands)
    colour = base * np.clip(tone, 0.35, 1.7)[:, None] + shine[:, None] * np.array([0.13, 0.105, 0.08], np.float32)
    if looks.sex != "male":
        colour = _mix(colour, _colour(looks.skin) * 0.74, 0.55 * parting)
    # at the hairline skin shows between the roots
    ragged = c.hair + 0.0028 * noise(p * 300, seed + 9) + 0.0016 * strands
    see = smoothstep(0.0034, -0.0005, ragged) * (0.85 - 0.5 * smoothstep(-0.3, 0.4, strands))
    colour = _mix(colour, _colour(looks.skin) * np.array([0.80, 0.72, 0.68], np.float32), see)
    return shaded(colour, c, 0.75)


# ---- cloth ----


def _weave(points, seed, fine=900):
    return 0.5 * noise(points * fine, seed) + 0.5 * noise(points * (0.31 * fine), seed + 1)


def _thread(distance, along, width=0.0010, stitch=0.0042):
    """A stitched line: dashes of thread along a seam."""
    return np.exp(-((distance / width) ** 2)) * smoothstep(0.22, 0.34, np.abs((along / stitch) % 1 - 0.5) * -1 + 0.62)


def shirt(c: Canvas, joints, looks: Looks):
    p, seed = c.p, looks.seed + 100
    x, y, z = p.T
    middle = joints[0, 0]
    arm = sleeves(p, joints, looks)
    shoulder = abs(joints[16, 0]) - 0.012
    above = np.where(arm < 0.29, 1.0, y - hem_height(joints, looks))
    armhole = np.abs(x - middle) - (shoulder + 0.10 * np.maximum(joints[16, 1] - y, 0))
    on_sleeve = armhole > 0
    light, dark = (_colour(rgb) for rgb in looks.shirt)
    wobble = 0.0012 * noise(p * 30, seed + 3)
    if looks.pattern == "stripes":
        along = np.where(on_sleeve, np.abs(x - middle) - shoulder, y - hem_height(joints, looks)) + wobble
        phase = (along / 0.034 + 0.62) % 1
        band = smoothstep(0.0, 0.03, phase) * smoothstep(0.36, 0.33, phase)
        plain = np.where(on_sleeve, 0.0, smoothstep(0.395, 0.40, y - hem_height(joints, looks)))
        colour = _mix(np.broadcast_to(light, p.shape), dark, band * (1 - plain))
    else:
        torso = 0.13 * np.arctan2(x - middle, z - joints[6, 2] + 0.01)
        round_arm = 0.05 * np.arctan2(z - joints[16, 2], y - joints[16, 1])
        s = np.where(on_sleeve, np.abs(x - middle) - shoulder, y) + wobble
        t = np.where(on_sleeve, round_arm, torso) + wobble
        colour = np.broadcast_to(light, p.shape).copy()
        for value in (s, t):
            phase = (value / 0.062) % 1
            wide = smoothstep(0.0, 0.015, phase) * smoothstep(0.42, 0.405, phase)
            twill = 0.52 + 0.10 * noise(np.stack([(s + t) * 900, (s - t) * 120, 0 * s], -1), seed + 9)
            colour = _mix(colour, dark, wide * twill)
        for value in (s, t):
            phase = (value / 0.062) % 1
            thin = smoothstep(0.685, 0.695, phase) * smoothstep(0.735, 0.725, phase)
            colour = _mix(colour, np.array([0.90, 0.84, 0.70], np.float32), 0.62 * thin)
    colour = colour * (1 + 0.055 * _weave(p, seed))[:, None]
    # collar, cuffs and hem, their stitches, and the armhole's seam
    rib = 1 + 0.10 * np.sin(np.arctan2(x - middle, z) * 160)
    trim = dark if looks.pattern == "stripes" else light * 0.72
    collar = smoothstep(0.0185, 0.0175, c.collar)
    colour = _mix(colour, trim * rib[:, None], collar)
    cuff = smoothstep(0.0185, 0.0175, arm) if looks.pattern == "stripes" else smoothstep(0.036, 0.035, arm)
    colour = _mix(colour, trim * (1 + 0.05 * _weave(p, seed + 5))[:, None], cuff)
    shade = 0.35 * np.exp(-((armhole / 0.0014) ** 2)) * (arm < 0.29)
    shade = shade + 0.45 * np.exp(-(((c.collar - 0.0195) / 0.0012) ** 2)) + 0.4 * np.exp(-(((arm - cuff_width(looks)) / 0.0012) ** 2))
    shade = shade + 0.25 * np.exp(-(((above - 0.022) / 0.0009) ** 2)) * (above < 0.1)
    colour = _mix(colour, colour * 0.55, shade)
    if looks.pattern == "stripes":
        colour = badge(colour, p, joints, looks)
    else:
        placket = (z > joints[6, 2]) & (arm > 0.29)
        line = np.exp(-(((np.abs(x - middle) - 0.016) / 0.0009) ** 2)) * placket
        colour = _mix(colour, colour * 0.55, 0.7 * line)
        for k in range(6):
            centre = joints[0, 1] + 0.14 + 0.068 * k
            r = np.hypot(x - middle, y - centre) / 0.0056
            button = smoothstep(1.05, 0.92, r) * placket
            hole = sum(smoothstep(0.2, 0.1, np.hypot(r * 0 + (x - middle) / 0.0056 - a, (y - centre) / 0.0056 - b)) for a in (-0.25, 0.25) for b in (-0.25, 0.25))
            tone = np.array([0.93, 0.90, 0.84], np.float32) * (1 - 0.25 * smoothstep(0.55, 0.9, r) * (r < 0.95))[:, None]
            colour = _mix(colour, tone, button)
            colour = _mix(colour, np.array([0.25, 0.2, 0.18], np.float32), np.clip(hole, 0, 1) * button)
            colour = _mix(colour, colour * 0.5, 0.8 * np.exp(-(((r - 1.15) / 0.14) ** 2)) * placket)
    fold = np.clip(1 + 0.28 * np.clip(c.cavity, -1, 0.5), 0.5, 1.2)[:, None]
    return shaded(colour * fold, c, 0.70)


def cuff_width(looks: Looks) -> float:
    return 0.0185 if looks.pattern == "stripes" else 0.036


def badge(colour, p, joints, looks: Looks):
    """A small emblem on the left chest: a ring, a hill and a sun."""
    centre = np.array([joints[0, 0] + 0.085, joints[9, 1] + 0.035])
    d = (p[:, :2] - centre) / 0.021
    r = np.hypot(*d.T)
    front = p[:, 2] > joints[9, 2] + 0.02
    inside = smoothstep(1.02, 0.97, r) * front
    colour = _mix(colour, np.array([0.93, 0.91, 0.86], np.float32), inside)
    hill = smoothstep(-0.02, 0.02, 0.35 * np.sin(d[:, 0] * 2.6 + 0.6) - 0.22 - d[:, 1]) * (r < 0.80)
    colour = _mix(colour, np.array([0.16, 0.45, 0.38], np.float32), hill * inside)
    sun = smoothstep(0.27, 0.23, np.hypot(d[:, 0] - 0.22, d[:, 1] - 0.32)) * (1 - hill)
    colour = _mix(colour, np.array([0.93, 0.58, 0.16], np.float32), sun * inside)
    ring = smoothstep(0.80, 0.84, r) * inside
    return _mix(colour, np.array([0.72, 0.18, 0.16], np.float32), ring)


def trousers(c: Canvas, joints, looks: Looks):
    p, seed = c.p, looks.seed + 200
    x, y, z = p.T
    middle = joints[0, 0]
    side = np.where(x > middle, 1.0, -1.0)
    hip = np.where(side > 0, joints[1, 0], joints[2, 0])
    knee = np.where(side > 0, joints[4, 0], joints[5, 0])
    t = np.clip((joints[1, 1] - y) / (joints[1, 1] - joints[4, 1]), 0, 1.6)
    axis_x = hip + (knee - hip) * np.minimum(t, 1.0)
    axis_z = joints[1, 2] - 0.012 * smoothstep(0.6, 1.4, t)
    around = np.arctan2((x - axis_x) * side, z - axis_z)  # 0 in front, pi/2 outside
    base = _colour(looks.trousers)
    if looks.pattern == "stripes":  # denim
        twill = noise(np.stack([(y + x + z) * 420, (y - x) * 90, z * 420], -1), seed + 7)
        slub = noise(np.stack([x * 900, y * 60, z * 900], -1), seed)
        tone = 1 + 0.06 * twill + 0.09 * slub + 0.05 * noise(p * 18, seed + 1)
        worn = 0.55 * np.exp(-(((t - 0.55) / 0.34) ** 2)) * smoothstep(0.25, 0.95, np.cos(around))
        worn += 0.35 * np.exp(-(((t - 1.0) / 0.12) ** 2)) * smoothstep(0.2, 0.9, np.cos(around))
        worn += 0.25 * smoothstep(-0.6, -1.0, np.cos(around)) * np.exp(-(((t - 0.1) / 0.2) ** 2))
        worn *= 0.8 + 0.4 * noise(p * 45, seed + 2)
        colour = _mix(base * tone[:, None], np.array([0.50, 0.58, 0.70], np.float32) * tone[:, None], 0.75 * worn)
        thread = np.array([0.74, 0.52, 0.26], np.float32)
    else:
        tone = 1 + 0.05 * _weave(p, seed, 1100) + 0.03 * noise(p * 14, seed + 1)
        colour = base * tone[:, None]
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
    shield = np.maximum(bx + 0.10 * np.maximum(-by, 0), np.maximum(by - 0.055, -by - 0.075 + 0.35 * np.maximum(bx + 0.058, 0)))
    shield = np.where(z < joints[1, 2] - 0.03, shield, 9.0)
    shade = shade + 0.65 * np.exp(-((shield / 0.0014) ** 2))
    if looks.pattern == "stripes":
        lines += [(shield + 0.0045, x + y, 0.9)]
        hem = y - (min(joints[7, 1], joints[8, 1]) + 0.004)
        lines += [(np.where(hem < 0.05, hem - 0.020, 9.0), around * 0.07, 0.9)]
    else:
        crease = np.where((t > 0.15) & (np.abs(around) < 0.5), around * 0.07, 9.0)
        colour = _mix(colour, colour * 1.35, 0.5 * np.exp(-(((crease - 0.001) / 0.0016) ** 2)))
        colour = _mix(colour, colour * 0.6, 0.5 * np.exp(-(((crease + 0.002) / 0.0018) ** 2)))
    colour = _mix(colour, colour * 0.5, shade)
    for distance, along, strength in lines:
        colour = _mix(colour, np.broadcast_to(thread, colour.shape), strength * _thread(distance, along))
    fold = np.clip(1 + 0.65 * np.clip(c.cavity, -1, 0.5), 0.4, 1.3)[:, None]
    return shaded(colour * fold, c, 0.80)


def belt(c: Canvas, joints, looks: Looks):
    p = c.p
    middle = joints[0, 0]
    y = p[:, 1] - hem_height(joints, looks)
    leather = np.array([0.36, 0.22, 0.13], np.float32) * (1 + 0.10 * fractal(p * 200, looks.seed + 300, 3))[:, None]
    edge = np.minimum(y - 0.001, 0.037 - y)
    leather = _mix(leather, leather * 0.55, smoothstep(0.004, 0.001, edge))
    leather = _mix(leather, np.array([0.62, 0.48, 0.32], np.float32), 0.7 * _thread(edge - 0.0055, 0.13 * np.arctan2(p[:, 0], p[:, 2])))
    front = p[:, 2] > 0
    bx, by = np.abs(p[:, 0] - middle) / 0.024, np.abs(y - 0.019) / 0.018
    outer, inner = np.maximum(bx, by), np.maximum(bx / 0.70, by / 0.62)
    buckle = smoothstep(1.0, 0.94, outer) * smoothstep(0.97, 1.03, inner) * front
    pin = ((np.abs(y - 0.019) < 0.0018) & (p[:, 0] - middle < 0.018) & (p[:, 0] - middle > -0.022) & front).astype(float)
    metal = np.array([0.80, 0.74, 0.58], np.float32) * (0.75 + 0.35 * smoothstep(-1, 1, (y - 0.019) / 0.018))[:, None]
    colour = _mix(leather, metal, np.maximum(buckle, pin))
    return shaded(colour, c, 0.8)


def lining(c: Canvas, joints, looks: Looks):
    """The inside of a hem: the garment's colour in its own shadow."""
    near_shirt = c.p[:, 1] > hem_height(joints, looks) - 0.02
    colour = np.where(near_shirt[:, None], _colour(looks.shirt[looks.pattern == "stripes"]) * 0.5, _colour(looks.trousers) * 0.45)
    return shaded(colour, c, 0.5)


# ---- shoes and eyes ----


def shoe(c: Canvas, joints, ground: float, looks: Looks):
    q, n, seed = c.q, c.n, looks.seed + 400
    side = np.where(q[:, 0] > joints[0, 0], 0, 1)
    ankle = joints[[7, 8]][side]
    ball = joints[[10, 11]][side]
    x, z = q[:, 0] - ankle[:, 0], q[:, 2] - ankle[:, 2]
    length = ball[:, 2] - ankle[:, 2]
    s = z / length  # 0 at the ankle, 1 at the ball of the foot
    y = q[:, 1] - ground
    base = _colour(looks.shoes)
    colour = base * (1 + 0.05 * fractal(q * 130, seed, 2) + 0.03 * noise(q * 900, seed + 1))[:, None]
    seam = np.zeros(len(q))
    accent = _colour(looks.shirt[1])
    if looks.pattern == "stripes":  # a canvas sneaker
        toe = s - 1.02 - 1.2 * np.maximum(0, 0.0)
        colour = _mix(colour, base * 1.02, smoothstep(0, 0.02, toe))
        seam += np.exp(-((toe / 0.02) ** 2)) + np.exp(-(((toe + 0.05) / 0.012) ** 2)) * 0.6
        heel = smoothstep(-0.28, -0.31, s) * smoothstep(0.10, 0.095, y)
        colour = _mix(colour, np.broadcast_to(accent, colour.shape), heel)
        seam += np.exp(-(((s + 0.27) / 0.012) ** 2))
        swoosh = np.abs((y - 0.052) - 0.10 * (s - 0.25)) - 0.009
        flank = smoothstep(0.45, 0.65, np.abs(n[:, 0])) * smoothstep(-0.2, -0.15, s) * smoothstep(0.85, 0.8, s)
        colour = _mix(colour, np.broadcast_to(accent, colour.shape), smoothstep(0.001, -0.001, swoosh) * flank)
        tongue = smoothstep(0.031, 0.029, np.abs(x - 0.01 * 0)) * smoothstep(0.25, 0.3, s) * smoothstep(0.99, 0.95, s) * smoothstep(0.15, 0.4, n[:, 1])
        seam += np.exp(-(((np.abs(x) - 0.029) / 0.0011) ** 2)) * (tongue > 0.02)
        inner = smoothstep(0.016, 0.0145, np.abs(x)) * tongue
        colour = _mix(colour, base * 0.82, inner)
        row = s / 0.155
        lace = smoothstep(0.34, 0.26, np.abs((row + np.abs(x) * 9) % 1 - 0.5)) * smoothstep(0.0255, 0.0245, np.abs(x)) * tongue
        colour = _mix(colour, colour * 0.35, smoothstep(0.50, 0.30, np.abs((row + np.abs(x) * 9) % 1 - 0.5)) * smoothstep(0.027, 0.0255, np.abs(x)) * tongue * 0.75)
        colour = _mix(colour, accent * 0.9 + 0.05, lace)
        eyelet = np.hypot((np.abs(x) - 0.0245) / 0.0030, ((row + np.abs(x) * 9) % 1 - 0.5) * 0.155 * length / 0.0030)
        colour = _mix(colour, np.array([0.22, 0.22, 0.24], np.float32), 0.9 * smoothstep(1.0, 0.7, eyelet) * tongue)
    else:  # a leather ankle boot
        zip_line = np.where((n[:, 0] * np.where(side == 0, -1, 1) > 0.5) & (np.abs(s + 0.02) < 0.04), s + 0.02, 9.0)
        seam += 0.9 * np.exp(-((zip_line / 0.018) ** 2)) + np.exp(-(((s - 0.75) / 0.015) ** 2)) + np.exp(-(((s + 0.30) / 0.015) ** 2))
        gloss = smoothstep(0.35, 0.95, n[:, 1]) * smoothstep(0.7, 1.2, s)
        colour = colour * (1 + 0.30 * gloss)[:, None]
    colour = _mix(colour, colour * 0.5, np.clip(seam, 0, 1) * 0.8)
    colour = _mix(colour, colour * 0.55, smoothstep(0.030, 0.022, y) * 0.7)
    return shaded(colour, c, 0.8)


def sole(c: Canvas, ground: float, looks: Looks):
    q = c.q
    y = q[:, 1] - ground
    rubber = np.array([0.88, 0.87, 0.84] if looks.pattern == "stripes" else [0.15, 0.12, 0.11], np.float32)
    colour = rubber * (1 + 0.05 * noise(q * 300, looks.seed + 410))[:, None]
    stripe = smoothstep(0.0016, 0.0008, np.abs(y - 0.0155))
    colour = _mix(colour, np.broadcast_to(_colour(looks.shirt[1]), colour.shape), stripe * (looks.pattern == "stripes"))
    colour = _mix(colour, colour * 0.45, smoothstep(0.004, 0.0, y))
    tread = smoothstep(-0.8, -0.95, c.n[:, 1]) * smoothstep(-0.2, 0.2, np.sin(q[:, 2] * 500) * np.sin(q[:, 0] * 500))
    return shaded(_mix(colour, colour * 0.55, tread), c, 0.6)


def eye_picture(looks: Looks, radius: float, size: int = 512) -> UInt8[Array, "size size 3"]:
    """One eye, for both eyeballs: distance from the middle is 0.49 sqrt(angle / pi), up is up."""
    row, column = np.mgrid[0:size, 0:size]
    x, y = (column + 0.5) / size - 0.5, 0.5 - (row + 0.5) / size
    reach = np.minimum(np.hypot(x, y) / 0.49, 1)
    angle = np.pi * reach**2
    turn = np.arctan2(y, x)
    mm = angle * radius * 1000  # from the pupil's middle, along the ball
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1).reshape(-1, 3)
    flat = mm.ravel()
    seed = looks.seed + 500
    white = np.array([0.850, 0.815, 0.790], np.float32) * (1 - 0.34 * smoothstep(7.5, 12.5, flat))[:, None]
    vein = 1 - np.abs(noise(ring * 9 + flat[:, None] * [0.25, 0.31, 0.2], seed)) * 5
    white = _mix(white, np.array([0.78, 0.50, 0.47], np.float32), np.clip(vein, 0, 1) * 0.35 * smoothstep(7.5, 11.0, flat))
    iris = _colour(looks.iris)
    fibre = 0.6 * noise(ring * 26 + flat[:, None] * [0.0, 0.0, 0.35], seed + 1) + 0.5 * noise(ring * 60 + flat[:, None] * [0, 0, 0.5], seed + 2)
    inner = smoothstep(4.6, 2.7, flat)
    colour = iris * (0.92 + 0.38 * fibre)[:, None]
    colour = _mix(colour, np.array([0.52, 0.36, 0.18], np.float32) * (1 + 0.3 * fibre)[:, None], 0.6 * inner)
    colour = _mix(colour, colour * 0.25, smoothstep(5.2, 6.5, flat))
    colour = _mix(colour, np.array([0.025, 0.02, 0.02], np.float32), smoothstep(2.65, 2.35, flat))
    colour = _mix(colour, white, smoothstep(6.3, 6.95, flat))
    up = (np.sin(turn) * mm).ravel()
    shadow = smoothstep(0.6, 4.6, up)  # of the upper lid
    colour = colour * (1 - 0.52 * shadow)[:, None]
    colour = colour * (1 - 0.16 * smoothstep(-1.8, -4.4, up))[:, None]
    dx, dy = (np.cos(turn) * mm).ravel() - 1.35, up - 1.35
    glint = smoothstep(1.0, 0.72, np.hypot(dx / 0.95, dy / 0.85)) + 0.35 * smoothstep(1.0, 0.5, np.hypot((dx + 3.2) / 0.6, (dy + 3.1) / 0.6))
    colour = _mix(colour, np.array([0.97, 0.98, 1.0], np.float32), glint)
    return np.round(255 * np.clip(colour, 0, 1)).astype(np.uint8).reshape(size, size, 3)


__all__ = ["EYE", "Canvas", "Texels", "covered_texels", "eye_picture", "hairline", "paint", "spread"]
