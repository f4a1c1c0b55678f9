"""Pictures of painted eyeballs with flat irises, traced without any of the code under test."""

from collections.abc import Sequence

import numpy as np

from avatar.camera import Camera, look_at, pixel_rays

FORWARD = np.array([0.0, 0.0, 1.0])


def paint(points: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """A dark iris with spokes and a white round it, by place on the eye."""
    x, y = (points[..., :2] - centre[:2]).T / radius
    iris = np.hypot(x, y) < np.sin(np.radians(25))
    spokes = 0.35 + 0.3 * np.sin(5 * np.arctan2(y, x))
    white = 0.85 + 0.1 * np.sin(25 * x)
    return np.where(iris, spokes, white).T[..., None] * np.array([1.0, 0.8, 0.9])


def traced(camera: Camera, centre: np.ndarray, radius: float, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Of each pixel the way to an eye that is cut at `angle` (0: a ball), infinite beside it, and its color there."""
    origins, directions = pixel_rays(camera)
    away = origins - centre
    b = (away * directions).sum(1)
    root = b**2 - (away**2).sum(1) + radius**2
    ball = -b - np.sqrt(np.maximum(root, 0))
    plane = (radius * np.cos(angle) - away @ FORWARD) / (directions @ FORWARD)
    # the cut ball is where both are: a ray enters it where it has entered both
    enters = np.maximum(ball, plane) if angle else ball
    return np.where(root > 0, enters, np.inf), paint(origins + enters[:, None] * directions, centre, radius)


def filmed(
    centres: Sequence[np.ndarray], radii: Sequence[float], angle: float, *, size: int = 96, focal: float = 8.0
) -> list[tuple[Camera, np.ndarray]]:
    """Eyes cut at `angle` on a black ground, from eleven sides; `focal` in widths of a picture."""
    K = np.array([[focal * size, 0, size / 2], [0, focal * size, size / 2], [0, 0, 1]])
    middle, views = np.mean(centres, axis=0), []
    for side in np.radians(np.linspace(-50, 50, 11)):
        eye = middle + 0.25 * np.array([np.sin(side), 0.1, np.cos(side)])
        camera = Camera(K, look_at(eye, middle), (size, size))
        color, nearest = np.zeros((size * size, 3)), np.full(size * size, np.inf)
        for centre, radius in zip(centres, radii, strict=True):
            length, own = traced(camera, centre, radius, angle)
            color = np.where((length < nearest)[:, None], own, color)
            nearest = np.minimum(nearest, length)
        views.append((camera, np.round(255 * color.reshape(size, size, 3)).astype(np.uint8)))
    return views
