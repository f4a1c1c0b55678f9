"""The rotate gizmo: three rings about a joint and one that faces the eye; picked and dragged with the pointer.

All of it is geometry of a camera (avatar/camera.py) and pixels; who draws the rings asks `ring_points`. A ring seen
from its side is dragged by angle: the ray through the pointer meets the ring's plane, and the angle about the
axis is measured there. Nearly edge-on that plane runs away from the ray, so the pointer's way along the ring's
tangent at the place where it was seized counts instead, as if a wheel were rolled. Which of the two it is, is
settled when the ring is seized, so that an angle never jumps during a drag.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from avatar.camera import Camera, pixel_rays, project
from avatar.limits import joint_angles, limits
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import PARENTS, joint_transforms

Array = np.ndarray

PIXELS = 80.0  # radius on the screen
NEAR_ENOUGH = 9.0  # pixels from a ring that still seize it
SEGMENTS = 96
# sine of the angle between ray and ring's plane below which the wheel is rolled
EDGE_ON = 0.25
VIEW_RING = 3
Frame = Literal["world", "local"]


class Gizmo(NamedTuple):
    """Rings about a point: axes 0 to 2 are the frame's, ring 3 faces the eye and is a little larger."""

    center: Float[Array, "3"]  # world, metres
    axes: Float[Array, "4 3"]  # unit, world
    radii: Float[Array, "4"]  # metres


@dataclass(frozen=True)
class Grab:
    """A ring held by the pointer."""

    gizmo: Gizmo
    ring: int
    pixel: Float[Array, "2"]  # where it was seized
    # unit, from the centre to the point seized, across the axis
    start: Float[Array, "3"]
    rolled: Float[Array, "2"] | None  # pixels along the tangent per radian; None: measured in the ring's plane


def gizmo_at(
    axis_angle: Float[Array, "52 3"],
    root: Float[Array, "3"],
    joints: Float[Array, "52 3"],
    joint: int,
    camera: Camera,
    *,
    frame: Frame = "local",
    pixels: float | int = PIXELS,
) -> Gizmo | None:
    """The gizmo on a joint, `pixels` large on the screen; None where the joint is behind the camera.

    frame: "world" x, y and z; "local" the joint's flexion, abduction and twist axes, carried along by its swing and
    not by its twist, so that a hinge's first ring changes its flexion alone, and every third ring the twist alone.
    """
    world = joint_transforms(axis_angle, joints, root)[joint]
    center = world[:3, 3]
    _, depth = project(camera, center[None])
    if depth[0] < 1e-3:
        return None
    axes = np.eye(3)
    if frame == "local":
        axes = limits().axes[joint]
        twist = joint_angles(axis_angle)[joint, 2]
        swung = world[:3, :3] @ matrix_from_axis_angle(-twist * axes[2])
        axes = axes @ swung.T
    eye = center - camera.eye
    distance = float(np.linalg.norm(eye))
    radius = pixels * float(depth[0]) / float(camera.K[1, 1])
    return Gizmo(
        center,
        np.concatenate([axes, eye[None] / distance]),
        radius * np.array([1.0, 1.0, 1.0, 1.2]),
    )


def ring_points(gizmo: Gizmo, ring: int, segments: int = SEGMENTS) -> Float[Array, "points 3"]:
    """Points of a ring in the world, closed: the last is the first."""
    across, up = _across(gizmo.axes[ring])
    turn = np.linspace(0, 2 * np.pi, segments + 1)[:, None]
    return gizmo.center + gizmo.radii[ring] * (np.cos(turn) * across + np.sin(turn) * up)


def ring_front(gizmo: Gizmo, points: Float[Array, "points 3"], camera: Camera) -> Bool[Array, "points"]:
    """Which points are on the half towards the eye; the other half is drawn fainter and not seized."""
    towards = camera.eye - gizmo.center
    return (points - gizmo.center) @ towards >= -1e-6 * np.linalg.norm(towards) * gizmo.radii.max()


def picked_ring(gizmo: Gizmo, camera: Camera, pixel: Float[Array, "2"]) -> int | None:
    """The ring under the pointer: the nearest on the screen, at most NEAR_ENOUGH pixels away.

    Only the near half of a ring counts; the ring that faces the eye gives way to the others.
    """
    best: tuple[float, int] | None = None
    for ring in range(4):
        found = _nearest_on_ring(gizmo, ring, camera, pixel)
        if found is None:
            continue
        distance = found[0] + (2.0 if ring == VIEW_RING else 0.0)
        if found[0] <= NEAR_ENOUGH and (best is None or distance < best[0]):
            best = (distance, ring)
    return None if best is None else best[1]


def grabbed(gizmo: Gizmo, ring: int, camera: Camera, pixel: Float[Array, "2"]) -> Grab:
    """The ring seized with the pointer at `pixel`, which may be anywhere."""
    axis = gizmo.axes[ring]
    origin, direction = _ray(camera, pixel)
    met = _direction_to_hit(gizmo.center, axis, origin, direction)
    if abs(float(direction @ axis)) >= EDGE_ON and met is not None:
        return Grab(gizmo, ring, np.array(pixel, np.float64), met, None)
    found = _nearest_on_ring(gizmo, ring, camera, pixel)
    place = found[1] if found is not None else gizmo.center + gizmo.radii[ring] * _across(axis)[0]
    start = (place - gizmo.center) / np.linalg.norm(place - gizmo.center)
    tangent = gizmo.radii[ring] * np.cross(axis, start)
    small = 1e-4
    ends, depth = project(camera, np.stack([place - small * tangent, place + small * tangent]))
    rolled = (ends[1] - ends[0]) / (2 * small)
    # the tangent points at the eye
    if depth.min() <= 0 or np.linalg.norm(rolled) < 1.0:
        rolled = np.array([float(np.linalg.norm(gizmo.radii[ring] * camera.K[1, 1] / max(depth.max(), 1e-3))), 0.0])
    return Grab(gizmo, ring, np.array(pixel, np.float64), start, rolled)


def drag_angle(grab: Grab, camera: Camera, pixel: Float[Array, "2"], last: float | int = 0.0) -> float:
    """How far the ring is turned with the pointer now at `pixel`, radians; whole turns follow from `last`.

    `last` is the previous answer of the same drag. Where the ray misses the plane, `last` stays.
    """
    if grab.rolled is not None:
        way = np.asarray(pixel, np.float64) - grab.pixel
        return float(way @ grab.rolled / (grab.rolled @ grab.rolled))
    axis = grab.gizmo.axes[grab.ring]
    met = _direction_to_hit(grab.gizmo.center, axis, *_ray(camera, pixel))
    if met is None:
        return last
    angle = float(np.arctan2(np.cross(grab.start, met) @ axis, grab.start @ met))
    return angle + 2 * np.pi * round((last - angle) / (2 * np.pi))


def turned(
    axis_angle: Float[Array, "52 3"],
    root: Float[Array, "3"],
    joints: Float[Array, "52 3"],
    joint: int,
    axis: Float[Array, "3"],
    angle: float | int,
) -> Float[Array, "52 3"]:
    """The pose with one joint turned about a world axis through it; all below follows, the root stays."""
    world = joint_transforms(axis_angle, joints, root)[:, :3, :3]
    parent = np.eye(3) if joint == 0 else world[PARENTS[joint]]
    out = np.array(axis_angle, np.float64)
    if angle != 0:
        turn = matrix_from_axis_angle(np.asarray(axis) * angle)
        out[joint] = axis_angle_from_matrix(parent.T @ turn @ world[joint])
    return out


def picked_joint(
    places: Float[Array, "joints 3"],
    camera: Camera,
    pixel: Float[Array, "2"],
    near_enough: float | int = 14.0,
) -> int | None:
    """The joint under the pointer: of those within `near_enough` pixels the nearest on the screen, then to the eye."""
    pixels, depth = project(camera, places)
    distance = np.where(depth > 1e-3, np.linalg.norm(pixels - pixel, axis=1), np.inf)
    if not distance.min() <= near_enough:
        return None
    return int(np.lexsort((depth, np.round(distance)))[0])


def on_plane_through(camera: Camera, point: Float[Array, "3"], pixel: Float[Array, "2"]) -> Float[Array, "3"]:
    """The world point under the pointer at the same depth as `point`: where a handle is dragged to."""
    origin, direction = _ray(camera, pixel)
    forward = camera.camera_from_world[2, :3]
    return origin + direction * float((point - origin) @ forward) / float(direction @ forward)


def _ray(camera: Camera, pixel: Float[Array, "2"]) -> tuple[Array, Array]:
    origin, direction = pixel_rays(camera, np.asarray(pixel, np.float64)[None])
    return origin[0], direction[0]


def _direction_to_hit(center: Array, axis: Array, origin: Array, direction: Array) -> Float[Array, "3"] | None:
    """Unit vector from the centre to where the ray meets the plane; None: behind the eye, along it, or the centre."""
    slope = float(direction @ axis)
    if abs(slope) < 1e-3:
        return None
    way = float((center - origin) @ axis) / slope
    if way <= 0:
        return None
    out = origin + way * direction - center
    out = out - axis * (out @ axis)
    length = float(np.linalg.norm(out))
    return out / length if length > 1e-9 else None


def _nearest_on_ring(gizmo: Gizmo, ring: int, camera: Camera, pixel: Float[Array, "2"]) -> tuple[float, Array] | None:
    """Distance in pixels to the ring's near half, and the world point there."""
    points = ring_points(gizmo, ring)
    shown, depth = project(camera, points)
    usable = (depth > 1e-3) & (ring_front(gizmo, points, camera) | (ring == VIEW_RING))
    usable = usable[:-1] & usable[1:]
    if not usable.any():
        return None
    a, b = shown[:-1], shown[1:]
    along = b - a
    share = np.sum((pixel - a) * along, 1) / np.maximum(np.sum(along * along, 1), 1e-12)
    share = np.clip(share, 0, 1)
    distance = np.linalg.norm(a + share[:, None] * along - pixel, axis=1)
    k = int(np.argmin(np.where(usable, distance, np.inf)))
    return float(distance[k]), points[k] + share[k] * (points[k + 1] - points[k])


def _across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors that make a right-handed frame with the axis."""
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across = across / np.linalg.norm(across)
    return across, np.cross(axis, across)
