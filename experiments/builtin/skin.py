"""Skin of arms and hands, and the ground on which the face is painted."""

import numpy as np
from jaxtyping import Float

from experiments.builtin.canvas import Canvas, mixed, shaded, spot, srgb
from experiments.builtin.face import Face
from experiments.builtin.features import head_skin
from experiments.builtin.looks import Looks
from experiments.builtin.noise import fractal, noise
from synth.people.mesh import smoothstep

Array = np.ndarray


def paint_skin(c: Canvas, face: Face, joints: Float[Array, "52 3"], looks: Looks) -> Float[Array, "n 3"]:
    """Bare skin, the face with its features; sRGB, 0 to 1."""
    p, seed = c.p, looks.seed
    base = srgb(looks.skin)
    tone = 0.030 * fractal(p * 22, seed + 20, 2) + 0.018 * noise(p * 160, seed + 22) + 0.014 * noise(p * 700, seed + 23)
    color = base * (1 + tone[:, None] * np.array([0.8, 1.0, 1.1], np.float32))
    red = 0.25 * np.maximum(noise(p * 40, seed + 24), 0)
    color = mixed(color, color * [1.0, 0.86, 0.84], red)
    # elbows, knuckles and finger tips are redder
    for joint in [18, 19]:
        color = mixed(color, color * [0.98, 0.83, 0.80], 0.4 * spot(p, joints[joint] + [0, 0, -0.03], 0.03))
    color = hands(color, c, face, joints, looks)
    head = p[:, 1] > joints[12, 1] - 0.06
    rows = np.flatnonzero(head & (np.abs(p[:, 0] - joints[15, 0]) < 0.15))
    if len(rows):
        color[rows] = head_skin(color[rows], c.at(rows), face, looks)
    crease = np.clip(1 + np.clip(c.cavity, -1, 0.2) * 0.11, 0.4, 1.12)[:, None]
    color = color * crease ** np.array([0.75, 1.05, 1.1], np.float32)
    return shaded(color, c, 0.62, (1.35, 0.95, 0.9))


def hands(
    color: Float[Array, "n 3"], c: Canvas, face: Face, joints: Float[Array, "52 3"], looks: Looks
) -> Float[Array, "n 3"]:
    """Nails, redder finger tips and knuckles, creases at the joints."""
    p, seed = c.p, looks.seed
    near = np.abs(p[:, 0]) > abs(joints[20, 0]) - 0.03
    rows = np.flatnonzero(near)
    if not len(rows):
        return color
    for first in (22, 37):
        for finger in range(5):
            chain = joints[first + 3 * finger : first + 3 * finger + 3]
            axis = (chain[2] - chain[1]) / np.linalg.norm(chain[2] - chain[1])
            nail = face.nails[np.argmin(np.linalg.norm(face.nails - chain[2], axis=1))]
            near = rows[np.linalg.norm(p[rows] - chain[1], axis=1) < np.linalg.norm(nail - chain[1]) + 0.03]
            q, n, some = p[near], c.n[near], color[near]
            some = mixed(some, some * [1.02, 0.82, 0.80], 0.5 * spot(q, nail - 0.003 * axis, 0.011))
            up = np.array([0.0, 1.0, 0.0]) - axis[1] * axis
            up /= np.linalg.norm(up)
            back = smoothstep(0.1, 0.5, n @ up)
            for number, joint in enumerate(chain):
                if finger == 4 and number == 0:
                    continue
                reach = smoothstep(0.016, 0.012, np.linalg.norm(q - joint, axis=1))
                some = mixed(some, some * [0.98, 0.80, 0.77], 0.5 * spot(q, joint + 0.007 * up, 0.010) * back)
                if number == 0:
                    continue
                wave = (q - joint) @ axis + 0.0006 * noise(q * 400, seed + 80)
                lines = np.zeros(len(q))
                for at in (-0.0030, -0.0004, 0.0024):
                    lines = lines + np.exp(-(((wave - at) / 0.0006) ** 2))
                some = mixed(some, some * [0.82, 0.68, 0.64], 0.30 * lines * back * reach)
                palm = np.exp(-(((wave - 0.001) / 0.0009) ** 2)) * (1 - back) * reach
                some = mixed(some, some * [0.80, 0.64, 0.60], 0.55 * palm)
            color[near] = some
    q, n, some = p[rows], c.n[rows], color[rows]
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
        pink = (
            np.array([0.90, 0.68, 0.63], np.float32)
            if looks.sex == "male"
            else np.array([0.80, 0.36, 0.40], np.float32)
        )
        gloss = 1 + 0.10 * np.exp(-((b / 0.35) ** 2))
        nail_color = pink * gloss[:, None]
        if looks.sex == "male":
            nail_color = mixed(nail_color, np.array([0.95, 0.88, 0.83], np.float32), smoothstep(0.66, 0.80, a))
            nail_color = mixed(
                nail_color,
                np.array([0.94, 0.80, 0.77], np.float32),
                0.7 * smoothstep(-0.60, -0.78, a + 0.25 * b * b),
            )
        some = mixed(some, nail_color, nail)
        fold = np.exp(-(((shape - 1.12) / 0.10) ** 2))
        some = mixed(some, some * [0.74, 0.58, 0.54], 0.75 * fold)
    color[rows] = some
    return color
