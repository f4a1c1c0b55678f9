"""Cameras that fit what is to be seen: in front of the avatar, or going round it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, direction, look_at, orbit_camera
from avatar.hull import hull_of, outermost, posed_hull
from avatar.motion.clip import Clip, spread_frames
from avatar.skeleton import joint_transforms
from player.draw.posing import posed_vertices

FOV = np.radians(35.0)  # vertical
# a little from above, as one stands before a person
ELEVATION = np.radians(4.0)
MARGIN = 0.06  # share of the picture's width and height, left free on each side
NEAREST = 0.05  # share of the points' largest extent that the nearest of them keeps before the lens
ALONE = 0.1  # metres, of a single place before the lens
# directions that a camera going round is checked from
SIDES = 48


def pelvis_height(avatar: Avatar) -> float:
    """Height of the pelvis joint above the soles in pose 0, metres."""
    # those of the finest level: every reading has it
    return -float(posed_vertices(avatar, avatar.levels[0], (np.zeros((52, 3)), np.zeros(3)))[:, 1].min())


def facing(axis_angle: Float[Array, "52 3"], joints: Float[Array, "52 3"]) -> float:
    """Azimuth the chest points to, radians: 0 along +z of the world, growing towards +x."""
    forward = joint_transforms(axis_angle, joints)[0, :3, 2]
    # lying: there is no front seen from the ground
    if np.hypot(forward[0], forward[2]) < 1e-6:
        return 0.0
    return float(np.arctan2(forward[0], forward[2]))


def extent(avatar: Avatar, clip: Clip) -> Float[Array, "points 3"]:
    """World points whose view holds the avatar, hair and shoes too, in (about 48) frames of the clip."""
    chosen = spread_frames(len(clip.root), 48)
    points = posed_hull(hull_of(avatar), clip.axis_angle[chosen], clip.root[chosen]).reshape(-1, 3)
    return points[outermost(points)]


class View(NamedTuple):
    """Where a camera looks, and from where."""

    target: Float[Array, "3"]
    distance: float  # metres
    azimuth: float  # radians, 0 along +z of the world, growing towards +x
    elevation: float  # radians


def fitted(
    points: Float[Array, "points 3"], azimuth: float, size: tuple[int, int], *, elevation: float = ELEVATION,
    fov: float = FOV,
) -> View:  # fmt: skip
    """The nearest camera from that side whose picture shows every point inside its margins, in its middle.

    With x, z a point's place to the right of the target and behind it, s the slope of the picture's edge less the
    margin, and c the camera's own shift to the right, |x - c| <= s (d + z) for all points: so d is at least
    (max(x - s z) - min(x + s z)) / 2 s, and c lies where the margins on both sides are equal.
    """
    middle = 0.5 * (points.min(0) + points.max(0))
    R = look_at(middle + direction(azimuth, elevation), middle)[:3, :3]
    x, y, z = ((points - middle) @ R.T).T
    slopes = _slopes(size, fov)
    needed = [((v - s * z).max() - (v + s * z).min()) / (2 * s) for v, s in zip((x, y), slopes, strict=True)]
    distance = max(*needed, _nearest(points) - float(z.min()))
    shift = [_even_margins(v, distance + z) for v in (x, y)]
    return View(middle + shift[0] * R[0] + shift[1] * R[1], float(distance), azimuth, elevation)


def fitted_camera(
    points: Float[Array, "points 3"], azimuth: float, size: tuple[int, int], *, elevation: float = ELEVATION
) -> Camera:
    return orbit_camera(*fitted(points, azimuth, size, elevation=elevation), size, FOV)


def fitted_round(points: Float[Array, "points 3"], azimuth: float, size: tuple[int, int], *, fov: float = FOV) -> View:
    """How a camera that goes round the vertical through the middle of the points begins: it always sees all."""
    middle = 0.5 * (points.min(0) + points.max(0))
    # all that comes before the lens: the points at every turn
    turns = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    cos, sin = np.cos(turns)[:, None], np.sin(turns)[:, None]
    x, height, z = (points - middle).T
    heights = np.broadcast_to(height, (SIDES, len(x)))
    swept = np.stack([cos * x + sin * z, heights, cos * z - sin * x], -1).reshape(-1, 3)
    R = look_at(direction(0.0, ELEVATION), np.zeros(3))[:3, :3]
    slopes = _slopes(size, fov)
    nearest = _nearest(points)
    lift, distance = 0.0, nearest
    # the target stays on the axis, so its height and the distance depend on one another, a little
    for _ in range(4):
        x, y, z = ((swept - [0.0, lift, 0.0]) @ R.T).T
        wide = (np.abs(x) / slopes[0] - z).max()
        high = ((y - slopes[1] * z).max() - (y + slopes[1] * z).min()) / (2 * slopes[1])
        distance = float(max(wide, high, nearest - z.min()))
        lift -= _even_margins(y, distance + z) / np.cos(ELEVATION)
    return View(middle + [0.0, lift, 0.0], distance, azimuth, ELEVATION)


def view_from(eye: Sequence[float], target: Sequence[float]) -> View:
    """The view from a place of another one, which has to be apart from it."""
    x, y, z = (away := np.subtract(eye, target)).tolist()
    distance = float(np.linalg.norm(away))
    return View(np.array(target, np.float64), distance, float(np.arctan2(x, z)), float(np.arcsin(y / distance)))


def _nearest(points: Float[Array, "points 3"]) -> float:
    return NEAREST * float(np.ptp(points, axis=0).max()) or ALONE


def _slopes(size: tuple[int, int], fov: float) -> tuple[float, float]:
    """Of the lines of sight to the margins beside, and above and below."""
    high = (1 - 2 * MARGIN) * float(np.tan(fov / 2))
    return high * size[0] / size[1], high


def _even_margins(across: Float[Array, "points"], depth: Float[Array, "points"]) -> float:
    """The shift of the camera at which the outermost points on both sides are seen equally far out."""
    low, high = float(across.min()), float(across.max())
    for _ in range(50):
        shift = 0.5 * (low + high)
        seen = (across - shift) / depth
        low, high = (shift, high) if seen.max() > -seen.min() else (low, shift)
    return 0.5 * (low + high)
