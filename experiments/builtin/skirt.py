"""A skirt: a closed shell of cloth that hangs from the belt, off the legs, and what is painted on it.

Rings go down from under the belt to the knees. A ring is the outline of what it hangs over, never narrower than the
rings above it, and flares into an ellipse with folds. The cloth moves as the nearest bones do, smoothed over a hand's
breadth: in the middle half with each leg. Frame: pose 0, pelvis at the origin, metres.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, KDTree

from experiments.builtin.canvas import Canvas, mixed, shaded, srgb, weave
from experiments.builtin.dressed import SKIRT, Dressed, joined
from experiments.builtin.hems import hem_height
from experiments.builtin.looks import Looks
from experiments.builtin.noise import noise
from geometry.mesh import vertex_normals
from synth.people.mesh import smoothstep

Array = np.ndarray

RINGS, AROUND = 34, 108
# of the cloth, and how far it clears what it hangs over
THICK, EASE = 0.003, 0.009
# half widths at the hem, across and to front and back
HEM = (0.315, 0.235)
FOLDS, FOLD_DEPTH = 13, 0.009
# smoothing steps of the skin weights; a step is half of the way to the mean of the neighbours
BLENDED = 150
# share of the texture's height for the outside, the inside lies below
OUTSIDE = 0.74


def with_skirt(dressed: Dressed, joints: Float[Array, "52 3"], looks: Looks) -> Dressed:
    """The dressed person and a skirt, closed: outside, inside, and a rim at waist and hem."""
    outer = _rings(dressed, joints, looks)
    k, i = np.meshgrid(np.arange(RINGS - 1), np.arange(AROUND), indexing="ij")
    j = (i + 1) % AROUND
    a, b, c, d = k * AROUND + i, k * AROUND + j, (k + 1) * AROUND + j, (k + 1) * AROUND + i
    sheet = np.concatenate([np.stack([a, d, c], -1).reshape(-1, 3), np.stack([a, c, b], -1).reshape(-1, 3)])
    inner = outer.reshape(-1, 3) - THICK * vertex_normals(outer.reshape(-1, 3), sheet)
    n, ring = RINGS * AROUND, np.arange(AROUND)
    turn, last = (ring + 1) % AROUND, (RINGS - 1) * AROUND
    rims = [
        np.stack([ring, turn, n + turn], -1),
        np.stack([ring, n + turn, n + ring], -1),
        np.stack([last + turn, last + ring, n + last + ring], -1),
        np.stack([last + turn, n + last + ring, n + last + turn], -1),
    ]
    faces = np.concatenate([sheet, n + sheet[:, ::-1], *rims])

    # the picture: unrolled, one column more than there are vertices; the rims take a line of the inside
    w = AROUND + 1
    u = 0.004 + 0.992 * np.arange(w) / AROUND
    v = np.concatenate([np.linspace(0.004, OUTSIDE, RINGS), np.linspace(OUTSIDE + 0.02, 0.994, RINGS)])
    uv = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
    m = RINGS * w
    uv_faces = np.empty_like(faces)
    for row, face in enumerate(faces):
        column = face % AROUND
        column = np.where((column == 0) & (column.max() == AROUND - 1), AROUND, column)
        # corners of a rim all take the inside's row
        level = face % n // AROUND
        side = np.full(3, 1) if len({int(x) for x in face // n}) == 2 else face // n
        uv_faces[row] = side * m + level * w + column
    rim = uv_faces[2 * len(sheet) :]
    # a rim is a sliver of the inside's edge: its two rows lie half a row apart
    shifted = uv[rim].copy()
    outside = faces[2 * len(sheet) :] < n
    shifted[..., 1] += np.where(outside, np.where(rim % m // w == 0, -0.006, 0.005), 0.0)
    uv_faces[2 * len(sheet) :] = len(uv) + np.arange(rim.size).reshape(-1, 3)
    uv = np.concatenate([uv, shifted.reshape(-1, 2)])

    weights = _weights(outer, dressed)
    points = np.concatenate([outer.reshape(-1, 3), inner])
    kind = np.full(len(faces), SKIRT)
    return joined(dressed, points, faces, uv, uv_faces, np.tile(weights, (2, 1)), kind, points)


def _rings(dressed: Dressed, joints: Float[Array, "52 3"], looks: Looks) -> Float[Array, "rings around 3"]:
    """Rings of the outside, the first under the belt."""
    top, bottom = hem_height(joints, looks) + 0.002, joints[4:6, 1].mean() - 0.02
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    towards = np.stack([np.sin(angle), np.cos(angle)], -1)
    body = dressed.mesh.vertices
    middle = np.array([joints[0, 0], joints[1:3, 2].mean()])
    least = np.zeros(AROUND)
    rings = []
    share = np.linspace(0, 1, RINGS)
    flared = smoothstep(0.0, 1.0, share) * 0.35 + 0.65 * share
    folded = FOLD_DEPTH * smoothstep(0.15, 1.0, share)
    for s, flare, fold in zip(share, flared, folded):
        y = top + s * (bottom - top)
        level = body[np.abs(body[:, 1] - y) < 0.012][:, [0, 2]] - middle
        level = level[np.abs(level[:, 0]) < 0.3]
        outline = level[ConvexHull(level).vertices]
        # how far the outline reaches in a direction, which is no less than where a ray leaves it
        least = np.maximum(least, _radius(outline, towards) + EASE)
        ellipse = 1 / np.sqrt((towards[:, 0] / HEM[0]) ** 2 + (towards[:, 1] / HEM[1]) ** 2)
        radius = np.maximum(least, least + flare * (ellipse - least))
        wave = np.cos(FOLDS * angle + 1.3 * np.sin(2 * angle) + 0.5 * s)
        radius = radius + fold * (wave + 0.4)
        rings.append(
            np.stack([middle[0] + towards[:, 0] * radius, np.full(AROUND, y), middle[1] + towards[:, 1] * radius], -1)
        )
    out = np.array(rings)
    for _ in range(4):
        out[:, :, [0, 2]] = 0.5 * out[:, :, [0, 2]] + 0.25 * (np.roll(out, 1, 1) + np.roll(out, -1, 1))[:, :, [0, 2]]
        out[1:-1, :, [0, 2]] = 0.5 * out[1:-1, :, [0, 2]] + 0.25 * (out[:-2] + out[2:])[:, :, [0, 2]]
    return out


def _radius(outline: Float[Array, "n 2"], towards: Float[Array, "around 2"]) -> Float[Array, "around"]:
    """Where rays from the origin leave a convex outline round it."""
    radius = np.full(len(towards), np.inf)
    for p, q in zip(outline, np.roll(outline, -1, axis=0)):
        edge = q - p
        normal = np.array([edge[1], -edge[0]])
        normal = normal if normal @ p > 0 else -normal
        facing = towards @ normal
        radius = np.where(facing > 1e-12, np.minimum(radius, (normal @ p) / np.maximum(facing, 1e-12)), radius)
    return radius


def _weights(outer: Float[Array, "rings around 3"], dressed: Dressed) -> Float[Array, "points 52"]:
    """Those of the nearest place of the person, smoothed over the cloth; the waist stays on the belt."""
    weights = dressed.mesh.weights[KDTree(dressed.mesh.vertices).query(outer.reshape(-1, 3))[1]]
    grid = weights.reshape(*outer.shape[:2], -1).copy()
    for _ in range(BLENDED):
        along = np.concatenate([grid[1:], grid[-1:]])
        beside = np.roll(grid, 1, axis=1) + np.roll(grid, -1, axis=1)
        grid[1:] = 0.5 * grid[1:] + 0.125 * (beside + along + np.concatenate([grid[:1], grid[:-1]]))[1:]
    # bones that a step has left little of
    grid = np.where(grid > 0.01, grid, 0)
    return (grid / grid.sum(-1, keepdims=True)).reshape(-1, grid.shape[-1])


def paint_skirt(c: Canvas, looks: Looks) -> Float[Array, "n 3"]:
    """Woollen cloth with two stripes over the hem and a row of diamonds; the inside plain; sRGB, 0 to 1."""
    assert looks.skirt is not None
    u, v = c.uv.T
    inside = v > OUTSIDE + 0.005
    s = np.clip(v / OUTSIDE, 0, 1)
    base = srgb(looks.skirt)
    # steps of two in a byte: what no eye sees takes no room in the file
    color = base * (1 + np.round(2 * weave(c.q, looks.seed + 500, 420))[:, None] * 0.02)
    light = np.array([0.90, 0.86, 0.76], np.float32)
    for at, half in ((0.845, 0.010), (0.975, 0.010)):
        color = mixed(color, light, smoothstep(half, half - 0.002, np.abs(s - at)))
    column = np.abs((u * 60) % 1 - 0.5) * 2
    diamond = column + np.abs(s - 0.910) / 0.034
    color = mixed(color, light, smoothstep(0.95, 0.80, diamond))
    color = mixed(color, np.array([0.62, 0.20, 0.18], np.float32), smoothstep(0.48, 0.36, diamond))
    dots = np.hypot(((u * 30 + 0.5 * (np.floor(s * 12) % 2)) % 1 - 0.5) / 0.11, ((s * 12) % 1 - 0.5) / 0.16)
    color = mixed(color, light, smoothstep(1.0, 0.8, dots) * (s < 0.80) * (s > 0.06))
    crease = 0.04 * noise(np.stack([u * 40, s * 3, 0 * s], -1), looks.seed + 501)
    color = color * (1 + crease)[:, None]
    color = np.where(inside[:, None], base * 0.62, color)
    return shaded(color, c, 0.75)
