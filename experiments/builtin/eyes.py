"""Eyes: two balls in the sockets, and the one picture that both wear.

Frame: pose 0, pelvis at the origin, metres.
"""

import numpy as np
from jaxtyping import Float, UInt8

from experiments.builtin.canvas import mixed, srgb
from experiments.builtin.dressed import EYE, Dressed, joined
from experiments.builtin.looks import Looks
from experiments.builtin.noise import noise
from synth.people.mesh import smoothstep

Array = np.ndarray


def with_eye(dressed: Dressed, centre: Float[Array, "3"], radius: float) -> Dressed:
    """An eyeball: a closed sphere with the pole in front, texture by angle from the pole (its own picture)."""
    stacks, slices = 22, 32
    theta = np.pi * (np.arange(1, stacks) / stacks) ** 1.6  # finer in front
    phi = 2 * np.pi * np.arange(slices) / slices
    t, p = np.meshgrid(theta, phi, indexing="ij")
    direction = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    direction = np.concatenate([direction, [[0, 0, 1], [0, 0, -1]]])
    k, i = np.meshgrid(np.arange(stacks - 2), np.arange(slices), indexing="ij")
    j = (i + 1) % slices
    a, b, c, d = k * slices + i, (k + 1) * slices + i, (k + 1) * slices + j, k * slices + j
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    ring, last, n = np.arange(slices), (stacks - 2) * slices, len(direction)
    turn = (ring + 1) % slices
    faces = np.concatenate(
        [
            faces,
            np.stack([0 * ring + n - 2, ring, turn], -1),
            np.stack([0 * ring + n - 1, last + turn, last + ring], -1),
        ]
    )
    weights = np.zeros((n, 52))
    weights[:, 15] = 1
    angle = np.arccos(np.clip(direction[:, 2], -1, 1))
    across = np.hypot(direction[:, 0], direction[:, 1])
    flat = direction[:, :2] / np.maximum(across, 1e-9)[:, None] * (0.49 * np.sqrt(angle / np.pi))[:, None]
    uv = 0.5 + flat * [1, -1]
    points = centre + radius * direction
    return joined(dressed, points, faces, uv, faces, weights, np.full(len(faces), EYE), points)


def eye_picture(looks: Looks, radius: float, size: int = 512) -> UInt8[Array, "size size 3"]:
    """One eye, for both eyeballs: distance from the middle is 0.49 sqrt(angle / pi), up is up; sRGB.

    `radius` of the eyeball in metres.
    """
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
    white = mixed(
        white,
        np.array([0.78, 0.50, 0.47], np.float32),
        np.clip(vein, 0, 1) * 0.35 * smoothstep(7.5, 11.0, flat),
    )
    iris = srgb(looks.iris)
    fibre = 0.6 * noise(ring * 26 + flat[:, None] * [0.0, 0.0, 0.35], seed + 1) + 0.5 * noise(
        ring * 60 + flat[:, None] * [0, 0, 0.5], seed + 2
    )
    inner = smoothstep(4.6, 2.7, flat)
    color = iris * (0.92 + 0.38 * fibre)[:, None]
    color = mixed(color, np.array([0.52, 0.36, 0.18], np.float32) * (1 + 0.3 * fibre)[:, None], 0.6 * inner)
    color = mixed(color, color * 0.25, smoothstep(5.2, 6.5, flat))
    color = mixed(color, np.array([0.025, 0.02, 0.02], np.float32), smoothstep(2.65, 2.35, flat))
    color = mixed(color, white, smoothstep(6.3, 6.95, flat))
    up = (np.sin(turn) * mm).ravel()
    shadow = smoothstep(0.6, 4.6, up)  # of the upper lid
    color = color * (1 - 0.52 * shadow)[:, None]
    color = color * (1 - 0.16 * smoothstep(-1.8, -4.4, up))[:, None]
    dx, dy = (np.cos(turn) * mm).ravel() - 1.35, up - 1.35
    glint = smoothstep(1.0, 0.72, np.hypot(dx / 0.95, dy / 0.85)) + 0.35 * smoothstep(
        1.0, 0.5, np.hypot((dx + 3.2) / 0.6, (dy + 3.1) / 0.6)
    )
    color = mixed(color, np.array([0.97, 0.98, 1.0], np.float32), glint)
    return np.round(255 * np.clip(color, 0, 1)).astype(np.uint8).reshape(size, size, 3)
