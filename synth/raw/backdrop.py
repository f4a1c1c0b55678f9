"""The room behind the person: a box with papered walls, pictures, a shelf and a wooden floor, seen by a camera that
stands still. One picture of it, and where each pixel of the floor is, for the person's shadow.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy import ndimage

from avatar.camera import Camera, pixel_rays
from avatar.texture import sample_texture

# metres from the origin: the wall behind, the walls beside, the wall behind the camera, and the height
BACK, SIDE, FRONT, HEIGHT = 1.6, 2.4, 4.5, 2.6
# the person's shadow on the floor: how dark, and metres to where it is half that
SHADOW, SHADOW_REACH = 0.35, 0.35


@dataclass(frozen=True)
class Backdrop:
    """An empty room as one camera sees it."""

    picture: Float[Array, "height width 3"]  # sRGB, 0 to 255
    # where the pixels show the floor: x and z, metres; elsewhere far away
    floor: Float[Array, "height width 2"]

    def with_shadow(self, x: float, z: float) -> Float[Array, "height width 3"]:
        """The room with a person standing at a place of it."""
        away = ((self.floor - np.array([x, z], np.float32)) ** 2).sum(-1)
        shade = 1 - SHADOW * np.exp2(-away / SHADOW_REACH**2)
        return self.picture * shade[..., None]


def backdrop(camera: Camera, floor: float, near: bool, seed: int) -> Backdrop:
    """The room as `camera` sees it; what a close-up has behind is a little out of focus (`near`)."""
    width, height = camera.size
    fine = camera.resized((2 * width, 2 * height))
    picture = np.zeros((height, width, 3), np.float32)
    ground = np.full((height, width, 2), 99, np.float32)
    paint = _Paint(seed)
    # some rows at a time: 1080p has 8 million rays
    for first in range(0, height, 64):
        rows = np.arange(2 * first, 2 * min(first + 64, height))
        x, y = np.meshgrid(np.arange(2 * width) + 0.5, rows + 0.5)
        origin, ray = pixel_rays(fine, np.stack([x, y], -1).reshape(-1, 2))
        color, on_floor, at = _hit(origin[0], ray, floor, paint)
        shape = (len(rows) // 2, 2, width, 2)
        picture[first : first + 64] = color.reshape(*shape, 3).mean((1, 3))
        places = np.where(on_floor[:, None], at[:, [0, 2]], 99).reshape(*shape, 2)
        ground[first : first + 64] = places[:, 0, :, 0]
    if near:
        picture = ndimage.gaussian_filter(picture, (min(width, height) / 250,) * 2 + (0,))
    return Backdrop(picture, ground)


def _hit(eye: Array, ray: Float[Array, "n 3"], floor: float, paint: "_Paint"):
    """Colour where rays meet the box, whether that is the floor, and the place."""
    low, high = np.array([-SIDE, floor, -BACK]), np.array([SIDE, floor + HEIGHT, FRONT])
    with np.errstate(divide="ignore"):
        along = np.where(ray > 0, (high - eye) / ray, (low - eye) / ray)
    wall = along.argmin(1)
    at = eye + along.min(1)[:, None] * ray
    color = np.empty((len(ray), 3))
    on_floor = (wall == 1) & (ray[:, 1] < 0)
    for kind, rows, u, v in (
        ("floor", on_floor, 0, 2),
        ("ceiling", (wall == 1) & ~on_floor, 0, 2),
        ("back", (wall == 2), 0, 1),
        ("side", (wall == 0), 2, 1),
    ):
        if rows.any():
            color[rows] = paint.on(kind, at[rows, u], at[rows, v] - (floor if v == 1 else 0))
    return color, on_floor, at


class _Paint:
    """Seeded colours of walls and floor at metres along them."""

    def __init__(self, seed: int):
        rng = np.random.default_rng([seed, 41])
        self.grain = rng.uniform(0, 255, (128, 128, 1)).astype(np.uint8)
        self.wall = np.array([188, 184, 172]) + rng.uniform(-25, 20) + rng.uniform(-8, 8, 3)
        self.boards = np.array([142, 108, 76]) + rng.uniform(-15, 15, 3)
        # left, bottom, width, height in metres, and a colour: pictures, a shelf with books, a radiator
        self.things: list[tuple[float, float, float, float, Array]] = [
            (-2.0, 0.1, 1.1, 0.6, np.array([215.0, 213.0, 205.0])),
            (0.85, 0.95, 1.2, 0.05, np.array([90.0, 66.0, 48.0])),
        ]
        for _ in range(5):
            left, bottom, width, height = rng.uniform((-2.2, 1.2, 0.2, 0.2), (1.9, 1.9, 0.5, 0.5))
            self.things.append((left, bottom, width, height, rng.uniform(30, 220, 3)))
        for book in range(18):
            self.things.append((0.9 + 0.06 * book, 1.0, 0.05, rng.uniform(0.18, 0.3), rng.uniform(20, 230, 3)))

    def noise(self, u: Array, v: Array, period: float) -> Float[Array, "n 1"]:
        """Smooth noise of mean 0, -1 to 1, over a lattice of `period` metres."""
        uv = np.stack([u, v], 1) / (128 * period)
        return sample_texture(self.grain, uv - np.floor(uv)) / 127.5 - 1

    def on(self, kind: str, u: Array, v: Array) -> Float[Array, "n 3"]:
        """Linear color of a floor, wall or ceiling at places on it, metres."""
        fine, coarse = self.noise(u, v, 0.006), self.noise(u, v, 0.15)
        if kind == "floor":
            board = np.floor(u / 0.14)
            tone = 0.12 * np.sin(board * 12.9898)[:, None]
            seam = (np.abs(u / 0.14 - board - 0.5) > 0.48)[:, None]
            grain = self.noise(u * 6, v, 0.03)
            return self.boards * (1 + tone + 0.1 * grain + 0.05 * fine) * np.where(seam, 0.6, 1)
        color = self.wall * (1 + 0.05 * coarse + 0.03 * fine)
        if kind == "ceiling":
            return np.minimum(1.15 * color, 245)
        # striped paper, brighter towards the window
        stripe = 0.03 * np.sign(np.sin(2 * np.pi * u / 0.12))[:, None]
        color = color * (1 + stripe - 0.06 * np.tanh(u)[:, None])
        skirting = (v < 0.09)[:, None]
        color = np.where(skirting, 225 + 6 * coarse, color)
        if kind == "back":
            for left, bottom, width, height, shade in self.things:
                inside = (u > left) & (u < left + width) & (v > bottom) & (v < bottom + height)
                rim = inside & ((u < left + 0.02) | (u > left + width - 0.02)) & (width > 0.15)
                color = np.where(inside[:, None], shade * (1 + 0.25 * coarse), color)
                color = np.where(rim[:, None], 0.5 * shade, color)
        return color
