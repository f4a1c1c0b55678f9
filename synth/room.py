"""Light as rooms have it: a window, a lamp, ceiling and floor; shadows on the person's own body; a camera's curve.

    linear = exposure (base (E_ambient + sum_s E_s) + sum_s H_s)        shown = sRGB(min(linear, 1))

base is the decoded base colour, E the irradiance of an open white surface = 1, H a highlight. The room stands still in
the world and its lights are far off, so that only directions count; so all videos of a capture are in the same room,
its floor about a metre under the origin: a standing person's pelvis, a sitting person's head, a raised hand.

Shadows are depth images taken from the directions that a light is cut into (Williams 1978; many of them make soft ones:
Heckbert and Herf 1997). Light and shadow are found at the vertices and interpolated: a shadow is as sharp as the mesh.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.camera import Camera, look_at, project
from avatar.rotation import fibonacci_sphere, nearest_rotation
from avatar.texture import linear_from_srgb, srgb_from_linear
from geometry.mesh import neighbour_matrix, vertex_normals
from player.draw.raster import Rasteriser

# pixels of a depth image, and how far off it is taken: rays over a person differ by 2 degrees
SHADOW_SIZE = 512
SHADOW_DISTANCE = 60.0
# directions from which ceiling, walls and floor are seen or not, and pixels of those depth images
OPEN_DIRECTIONS = 24
OPEN_SIZE = 192
# pixels of a depth image by which a point is lifted off its surface, so that it does not shade itself
LIFT = 1.5
# metres: poses that differ by less are the same body, turned
SAME_BODY = 2e-5
# reflectance of an ordinary surface seen straight on (Schlick 1994)
REFLECTANCE = 0.04


@dataclass(frozen=True)
class LightSource:
    """A light far off that covers an ellipse of the sky, brightness the same all over it."""

    direction: tuple[float, float, float]  # world, towards its middle; of any length
    width: float  # degrees, level
    height: float  # degrees
    # irradiance of a surface that faces a point source as strong; 1 shows the base colour at exposure 1
    irradiance: float
    # directions that it is cut into, each with a shadow of its own
    samples: int
    gloss: float  # exponent of its highlight (Blinn 1977): the wider a light, the lower

    def directions(self) -> Float[Array, "samples 3"]:
        """Unit directions spread evenly over the source, in a spiral, so that no two shadows' edges lie in line."""
        middle = np.array(self.direction) / np.linalg.norm(self.direction)
        # level, for a light straight above along +x
        across = np.array([middle[2], 0.0, -middle[0]]) if np.hypot(middle[0], middle[2]) > 1e-9 else np.eye(3)[0]
        across /= np.linalg.norm(across)
        k = np.arange(self.samples)
        radius, angle = np.sqrt((k + 0.5) / self.samples), k * np.pi * (3 - np.sqrt(5))
        half = np.tan(np.radians([self.width, self.height]) / 2)
        at = (radius * [np.cos(angle), np.sin(angle)]).T * half
        out = middle + at[:, :1] * across + at[:, 1:] * np.cross(middle, across)
        return out / np.linalg.norm(out, axis=1, keepdims=True)


@dataclass(frozen=True)
class Room:
    """What lights the person, in linear light, and how the camera is exposed (locked, the same for all videos)."""

    sources: tuple[LightSource, ...]
    # radiance straight above and straight below, linear between by height; 1 all round lights to 1
    ceiling: float
    floor: float
    exposure: float


# a window in front to the left of the camera, a lamp above to the right; a white cloth turned to the window is clipped
ROOM = Room(
    sources=(
        LightSource((-0.75, 0.35, 0.60), width=55.0, height=40.0, irradiance=0.62, samples=12, gloss=14.0),
        LightSource((0.60, 0.75, 0.40), width=9.0, height=9.0, irradiance=0.28, samples=3, gloss=60.0),
    ),
    ceiling=0.30,
    floor=0.10,
    exposure=1.45,
)


class Openness(NamedTuple):
    """What the surroundings give to points of a body: enough for any turn of it under a sky linear in height."""

    # sums over directions k of max(n.k, 0) (1, k): of those that arrive, and of all
    arriving: Float[Array, "points 4"]
    whole: Float[Array, "points 4"]


class ReceivedLight(NamedTuple):
    irradiance: Float[Array, "n"]
    seen: Float[Array, "sources n"]


class VertexLight(NamedTuple):
    """Light on both sides of every vertex: first where normals point to, then behind."""

    irradiance: Float[Array, "2 vertices"]  # linear, ambient and sources
    # the share of each source that is seen
    seen: Float[Array, "sources 2 vertices"]

    def at(self, corners: Int[Array, "n 3"], weights: Float[Array, "n 3"], behind: Bool[Array, "n"]) -> ReceivedLight:
        """Interpolated to points on triangles, of which some are seen from behind."""
        side = behind.astype(np.int64)[:, None]
        irradiance = (self.irradiance[side, corners] * weights).sum(1)
        return ReceivedLight(irradiance, np.stack([(seen[side, corners] * weights).sum(1) for seen in self.seen]))


def sunlit_share(
    rasteriser: Rasteriser,
    vertices: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    points: Float[Array, "points 3"],
    normals: Float[Array, "points 3"],
    direction: Float[Array, "3"],
    size: int = SHADOW_SIZE,
) -> Float[Array, "points"]:
    """How much of the light from a far direction reaches points past the mesh: 0 to 1, smooth over a pixel.

    Points that turn away from the light get none. Each is compared with the four pixels of the depth image round it.
    """
    middle = (vertices.min(0) + vertices.max(0)) / 2
    camera_from_world = look_at(middle + SHADOW_DISTANCE * np.asarray(direction), middle)
    local = (vertices - middle) @ camera_from_world[:3, :3].T
    reach = 1.02 * float(np.abs(local[:, :2]).max())
    reach /= 1 - float(np.abs(local[:, 2]).max()) / SHADOW_DISTANCE
    focal = 0.5 * (size - 2) * SHADOW_DISTANCE / reach
    camera = Camera(np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]]), camera_from_world, (size, size))
    depth = rasteriser.draw(vertices, faces, camera).depth.ravel()
    pixel = SHADOW_DISTANCE / focal
    out = np.zeros(len(points))
    facing = np.flatnonzero(normals @ direction > 0)
    places, away = project(camera, points[facing] + LIFT * pixel * normals[facing])
    corner = np.clip(places - 0.5, 0, size - 1.001)
    column, row = corner.astype(np.int64).T
    fx, fy = corner[:, 0] - column, corner[:, 1] - row
    first = row * size + column
    reached = away - 0.5 * pixel
    passed = [(reached < depth[first + step]).astype(np.float64) for step in (0, 1, size, size + 1)]
    # a + f (b - a): exactly 1 where all pass
    upper, lower = passed[0] + fx * (passed[1] - passed[0]), passed[2] + fx * (passed[3] - passed[2])
    share = upper + fy * (lower - upper)
    out[facing] = share
    return out


def openness(
    rasteriser: Rasteriser,
    vertices: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    points: Float[Array, "points 3"],
    normals: Float[Array, "points 3"],
) -> Openness:
    """What of the surroundings points see past the mesh: ambient occlusion (Landis 2002) that knows whence."""
    arriving, whole = np.zeros((len(points), 4)), np.zeros((len(points), 4))
    for direction in fibonacci_sphere(OPEN_DIRECTIONS):
        cosine = np.maximum(normals @ direction, 0)[:, None] * np.append(1.0, direction)
        whole += cosine
        arriving += cosine * sunlit_share(rasteriser, vertices, faces, points, normals, direction, OPEN_SIZE)[:, None]
    return Openness(arriving, whole)


def ambient(
    room: Room, normals: Float[Array, "points 3"], open_to: Openness, up: Float[Array, "3"]
) -> Float[Array, "points"]:
    """Irradiance of ceiling, walls and floor; `up` is the world's +y in the frame of normals and openness.

    Unoccluded, radiance a + b d.y gives a + 2/3 b n.y (Ramamoorthi and Hanrahan 2001, Eq. 8); the directions taken
    give only which share of it arrives.
    """
    mean, slope = (room.ceiling + room.floor) / 2, (room.ceiling - room.floor) / 2
    sky = np.append(mean, slope * up)
    share = (open_to.arriving @ sky) / np.maximum(open_to.whole @ sky, 1e-12)
    return (mean + 2 / 3 * slope * (normals @ up)) * np.clip(share, 0, 1)


def turn_between(source: Float[Array, "vertices 3"], target: Float[Array, "vertices 3"]) -> Float[Array, "3 3"] | None:
    """The rotation that brings one body onto the other (Kabsch 1976), None where no rotation does."""
    a, b = source - source.mean(0), target - target.mean(0)
    turn = nearest_rotation(b.T @ a)
    return turn if np.abs(a @ turn.T - b).max() < SAME_BODY else None


class RoomLighting:
    """Light on a mesh in a room, pose by pose. Kept: what the last pose gave, and the last body's openness, which is
    good for every heading of it.
    """

    def __init__(self, rasteriser: Rasteriser, faces: Int[Array, "faces 3"], welded: Int[Array, "vertices"]):
        self.rasteriser, self.faces, self.welded = rasteriser, faces, welded
        self.last: tuple[Array, Room, VertexLight] | None = None
        self.body: tuple[Array, Openness] | None = None

    def on(self, vertices: Float[Array, "vertices 3"], room: Room) -> VertexLight:
        """Light on every vertex of a posed mesh, world."""
        if self.last is not None and self.last[1] == room and np.array_equal(self.last[0], vertices):
            return self.last[2]
        normal = vertex_normals(vertices, self.faces, self.welded)
        normals, points = np.concatenate([normal, -normal]), np.concatenate([vertices, vertices])
        turn = None if self.body is None else turn_between(self.body[0], vertices)
        if self.body is None or turn is None:
            self.body = (vertices, openness(self.rasteriser, vertices, self.faces, points, normals))
            turn = np.eye(3)
        irradiance = ambient(room, normals @ turn, self.body[1], turn.T @ [0.0, 1.0, 0.0])
        buried = self.body[1].arriving[:, 0] <= 0
        seen = []
        for source in room.sources:
            share, total = np.zeros(len(points)), np.zeros(len(points))
            for direction in source.directions():
                reached = sunlit_share(self.rasteriser, vertices, self.faces, points, normals, direction)
                total += np.maximum(normals @ direction, 0) * reached
                share += reached
            irradiance = irradiance + source.irradiance * total / source.samples
            seen.append(share / source.samples)
        values = self._unburied(np.stack([irradiance, *seen]).reshape(1 + len(seen), 2, -1), buried.reshape(2, -1))
        lit = VertexLight(values[0], values[1:])
        self.last = (vertices.copy(), room, lit)
        return lit

    def _unburied(
        self, values: Float[Array, "kinds 2 vertices"], buried: Bool[Array, "2 vertices"]
    ) -> Float[Array, "kinds 2 vertices"]:
        """Values with those of vertices inside the body taken from the neighbours outside: a triangle that dips in
        is dark as its visible corners are, not as the hidden one."""
        touching = neighbour_matrix(self.welded[self.faces], values.shape[2])
        for side in range(2):
            given = (~buried[side]).astype(np.float64)
            number = touching @ given
            filled = (touching @ (values[:, side] * given).T).T / np.maximum(number, 1)
            outside = buried[side] & (number[self.welded] > 0)
            values[:, side] = np.where(outside, filled[:, self.welded], values[:, side])
        return values


def shade_in_room(
    base: Float[Array, "n 3"],
    normals: Float[Array, "n 3"],
    towards_eye: Float[Array, "n 3"],
    lit: ReceivedLight,
    room: Room,
) -> Float[Array, "n 3"]:
    """Shown colour, 0-255, of points with base colour `base` (0-255, sRGB); clipped where the camera would.

    The highlight of a source is Blinn's with the energy that he left out (Akenine-Möller et al. 2018, Eq. 9.55):

        H = E seen R (g + 8) / 8 max(n.h, 0)^g max(n.l, 0)
    """
    linear = linear_from_srgb(base / 255) * lit.irradiance[:, None]
    for source, seen in zip(room.sources, lit.seen, strict=True):
        towards = np.array(source.direction) / np.linalg.norm(source.direction)
        half = towards_eye + towards
        half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
        bright = np.maximum((normals * half).sum(1), 0) ** source.gloss * np.maximum(normals @ towards, 0)
        strength = source.irradiance * REFLECTANCE * (source.gloss + 8) / 8
        linear = linear + (strength * seen * bright)[:, None]
    return 255 * srgb_from_linear(np.minimum(room.exposure * linear, 1))
