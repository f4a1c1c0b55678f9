"""Cameras that fit what is to be seen: in front of the avatar, or going round it."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Int

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, look_at, pinhole
from avatar.motion.clip import Clip
from avatar.skeleton import joint_transforms, skin_transforms
from avatar.skinning import SkinWeights, skin_points

Array = np.ndarray

FOV = np.radians(35.0)  # vertical
# a little from above, as one stands before a person
ELEVATION = np.radians(4.0)
# metres of body and clothes beyond the joints; hair above the head joint needs most
FLESH = 0.14
# of the image that the avatar may fill
MARGIN = 0.94


def pelvis_height(avatar: Avatar) -> float:
    """Height of the pelvis joint above the soles in pose 0, metres."""
    # the finest: every reading has it
    level = avatar.levels[0]
    skin = SkinWeights(level.joints.astype(np.int64), level.weights.astype(np.float32) / np.float32(255))
    joints = avatar.joint_positions.astype(np.float64)
    transforms = skin_transforms(np.zeros((52, 3)), joints, rest=avatar.canonical_pose.astype(np.float64))
    return -float(skin_points(level.positions.astype(np.float64), skin, transforms)[:, 1].min())


def facing(axis_angle: Float[Array, "52 3"], joints: Float[Array, "52 3"]) -> float:
    """Azimuth the chest points to, radians: 0 along +z of the world, growing towards +x."""
    forward = joint_transforms(axis_angle, joints)[0, :3, 2]
    # lying: there is no front seen from the ground
    if np.hypot(forward[0], forward[2]) < 1e-6:
        return 0.0
    return float(np.arctan2(forward[0], forward[2]))


def extent(avatar: Avatar, clip: Clip, *, following: bool = False, samples: int = 48) -> Float[Array, "points 3"]:
    """World points whose view holds the avatar in (about `samples`) frames of the clip.

    following: the points as seen by a camera that goes along with the pelvis, over the ground.
    """
    chosen = evenly(len(clip.root), samples)
    joints = avatar.joint_positions.astype(np.float64)
    root = clip.root[chosen] * ([0.0, 1.0, 0.0] if following else [1.0, 1.0, 1.0])
    world = joint_transforms(clip.axis_angle[chosen], joints, root)[..., :3, 3].reshape(-1, 3)
    # the corner of a box that is farthest along a direction belongs to the joint that is farthest along it
    world = world[outermost(world)]
    box = np.stack(np.meshgrid(*[[-FLESH, FLESH]] * 3), -1).reshape(-1, 3)
    corners = (world[:, None] + box).reshape(-1, 3)
    return corners[outermost(corners)]


def evenly(count: int, samples: int) -> Int[Array, "chosen"]:
    """At most so many of the numbers 0 .. count - 1, spread evenly, first and last among them."""
    return np.linspace(0, count - 1, min(samples, count)).astype(np.int64)


def outermost(points: Float[Array, "points 3"]) -> Int[Array, "outer"]:
    """Indices of the points farthest along each of 512 directions: all that a fitted camera must look at."""
    n = np.arange(512) + 0.5
    height, turn = 1 - 2 * n / 512, np.pi * (1 + 5**0.5) * n
    flat = np.sqrt(1 - height * height)
    directions = np.stack([flat * np.cos(turn), height, flat * np.sin(turn)], 1)
    farthest = np.argmax(points @ directions.T, axis=0)
    return np.flatnonzero(np.bincount(farthest, minlength=len(points)))  # np.unique would load numpy.ma


def fitted_camera(
    points: Float[Array, "points 3"],
    azimuth: float,
    size: tuple[int, int],
    *,
    elevation: float = ELEVATION,
    fov: float = FOV,
) -> Camera:
    """The nearest camera from that side that sees every point, its target the middle of their box."""
    target = 0.5 * (points.min(0) + points.max(0))
    distance = needed_distance(points, target, azimuth, elevation, size, fov)
    return at_distance(target, distance, azimuth, elevation, size, fov)


def orbit(
    points: Float[Array, "points 3"], start: float, size: tuple[int, int], *, fov: float = FOV
) -> Callable[[float, Float[Array, "3"]], Camera]:
    """A camera that goes round once, from azimuth `start`, and along with the avatar.

    A function of the turn in [0, 1) and the pelvis; `points` are extents with `following`.
    """
    target = 0.5 * (points.min(0) + points.max(0))
    sides = start + np.linspace(0, 2 * np.pi, 16, endpoint=False)
    distance = max(needed_distance(points, target, side, ELEVATION, size, fov) for side in sides)

    def camera_at(turn: float, root: Float[Array, "3"]) -> Camera:
        here = target + root * [1.0, 0.0, 1.0]
        return at_distance(here, distance, start + 2 * np.pi * turn, ELEVATION, size, fov)

    return camera_at


def _direction(azimuth: float, elevation: float) -> Float[Array, "3"]:
    flat = np.cos(elevation)
    return np.array([np.sin(azimuth) * flat, np.sin(elevation), np.cos(azimuth) * flat])


def needed_distance(
    points: Float[Array, "points 3"], target: Sequence[float] | Array, azimuth: float, elevation: float,
    size: tuple[int, int], fov: float = FOV,
) -> float:  # fmt: skip
    """How far from the target a camera on that side must be to see every point, metres."""
    camera_from_world = look_at(target + _direction(azimuth, elevation), target)
    local = (points - target) @ camera_from_world[:3, :3].T
    slope_y = MARGIN * np.tan(fov / 2)
    slope_x = slope_y * size[0] / size[1]
    needed = np.maximum(np.abs(local[:, 0]) / slope_x, np.abs(local[:, 1]) / slope_y) - local[:, 2]
    return max(float(needed.max()), 0.1)


def at_distance(
    target, distance: float, azimuth: float, elevation: float, size: tuple[int, int], fov: float = FOV
) -> Camera:
    """The camera on that side of the target that looks at it."""
    eye = target + distance * _direction(azimuth, elevation)
    return Camera(pinhole(size, fov), look_at(eye, target), size)
