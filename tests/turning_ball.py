"""Pixels of a ball that turns before a camera in a given light."""

import numpy as np

from avatar.light import CaptureLight
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import PARTS
from capture.light.pixels import LitPixels

TOWARDS_EYE = np.array([0.0, 0.0, -1.0])


def turning_ball(
    lights: CaptureLight | dict[str, CaptureLight],
    *,
    noise: float = 0.005,
    sheen: float = 0.0,
    odd: bool = False,
    triangles: int = 200,
    frames: int = 9,
) -> LitPixels:
    """A ball of as many colours as triangles that every video shows turning about the camera's y, and nodding.

    With `sheen` it shines towards the eye; of `odd` pixels a tenth are of something else.
    """
    lights = lights if isinstance(lights, dict) else dict.fromkeys(PARTS, lights)
    rng = np.random.default_rng(3)
    normals = rng.standard_normal((triangles, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    albedo = rng.uniform(0.2, 0.7, (triangles, 3))
    pieces = []
    for index, part in enumerate(PARTS):
        for frame in range(frames):
            turn = 2 * np.pi * (frame + index / 4) / frames
            R = matrix_from_axis_angle(np.array([0.3 * np.sin(2 * turn), 0, 0]))
            n = normals @ (R @ matrix_from_axis_angle(np.array([0, turn, 0]))).T
            face = np.flatnonzero(n @ TOWARDS_EYE > 0.25)
            n, eye = n[face], np.tile(TOWARDS_EYE, (len(face), 1))
            color = lights[part].shown(albedo[face], lights[part].shading(n), lights[part].highlight(n, eye))
            facing = n @ TOWARDS_EYE
            color += sheen * (0.3 * facing**24 + 0.35 * (1 - facing) ** 3)[:, None]
            color = np.clip(color + noise * rng.standard_normal(color.shape), 0, 1)
            if odd:
                color[::10] = rng.uniform(0, 1, color[::10].shape)
            pieces.append(LitPixels(np.full(len(face), index), face, color, n, eye))
    return LitPixels(*(np.concatenate(values) for values in zip(*pieces, strict=True)))
