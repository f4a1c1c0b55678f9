"""Pictures of the trained field in paper mode: its first surface crossing, coloured at the global view direction.

The posed fine surface is rasterised; each pixel's canonical point is moved onto the field's zero set and asked
for its colour at the interpolated mean direction d̄ (paper, Eq. 14), so colour depends on the point alone.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from train.run import Run

from avatar.camera import Camera
from avatar.skeleton import BIG_POSE, skin_transforms
from avatar.skinning import SkinWeights, skin_points
from bake.cone import view_cone
from player.raster import Rasteriser

CHUNK = 1 << 17  # field queries at once
FARTHEST = 0.004  # metres: a pixel is not moved farther than this onto the zero set
CLOSE = 1e-4  # metres: nearer to the zero set than this is on it

PointColour = Callable[[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]]


@dataclass(frozen=True)
class PosableSurface:
    """A mesh in the canonical (big) pose that follows the skeleton."""

    vertices: Float[np.ndarray, "v 3"]  # canonical, metres
    faces: Int[np.ndarray, "f 3"]
    skin: SkinWeights
    joints: Float[np.ndarray, "52 3"]  # pose 0
    canonical_pose: Float[np.ndarray, "52 3"]

    def posed(
        self, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "v 3"]:
        transforms = skin_transforms(axis_angle, self.joints, root, rest=self.canonical_pose)
        return skin_points(self.vertices, self.skin, transforms)


class Picture(NamedTuple):
    colour: Float[np.ndarray, "h w 3"]  # [0, 1] sRGB, black where nothing is
    mask: Bool[np.ndarray, "h w"]


def run_surface(run: Run) -> PosableSurface:
    """The fine surface of a run, as its own skin weights pose it."""
    s = run.surface
    skin = SkinWeights(np.asarray(s.skin_joints, np.int64), np.asarray(s.skin_weights, np.float32))
    vertices = np.asarray(s.vertices, np.float64)
    return PosableSurface(
        vertices, np.asarray(s.faces, np.int64), skin, np.asarray(run.subject.joints), BIG_POSE
    )


def run_directions(run: Run) -> Float[np.ndarray, "v 3"]:
    """Global view direction of every vertex of the run's surface, unit; unseen ones filled (FRAMES, View statistics)."""
    s = run.surface
    return view_cone(
        np.asarray(s.view_count, np.float64),
        np.asarray(s.view_mean, np.float64),
        np.asarray(s.view_covariance, np.float64),
        np.asarray(s.normals, np.float64),
        np.asarray(s.faces, np.int64),
    ).direction


def paper_colour(run: Run) -> PointColour:
    """Colour of canonical points near the surface at given unit directions, from the trained field."""
    field = run.field

    def colour(
        points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        out = np.empty((len(points), 3), np.float32)
        with torch.no_grad():
            for start in range(0, len(points), CHUNK):
                x = torch.as_tensor(points[start : start + CHUNK], dtype=torch.float32)
                d = torch.as_tensor(directions[start : start + CHUNK], dtype=torch.float32)
                out[start : start + CHUNK] = field.color(on_surface(field, x), d).clamp(0, 1).numpy()
        return out

    return colour


def on_surface(field, points: torch.Tensor) -> torch.Tensor:
    """Points moved along the gradient onto the zero set, one Newton step, at most FARTHEST."""
    distance = field.distance(points)
    off = distance.abs() > CLOSE
    if not bool(off.any()):
        return points
    moved = points.clone()
    step = distance[off].clamp(-FARTHEST, FARTHEST)[:, None] * field.normal(points[off])
    moved[off] = points[off] - step
    return moved


def draw_surface(
    raster: Rasteriser,
    surface: PosableSurface,
    posed: Float[np.ndarray, "v 3"],
    directions: Float[np.ndarray, "v 3"],
    colour: PointColour,
    camera: Camera,
    samples: int = 1,
) -> Picture:
    """One picture of a coloured canonical surface in a pose; `samples` squared rays for each pixel, averaged."""
    width, height = camera.size
    fragments = raster.draw(posed, surface.faces, camera, (samples * width, samples * height))
    hit = fragments.face >= 0
    corners = surface.faces[fragments.face[hit]]
    barycentric = fragments.barycentric[hit][:, :, None].astype(np.float64)
    points = (barycentric * surface.vertices[corners]).sum(1)
    direction = (barycentric * directions[corners]).sum(1)
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    image = np.zeros((*hit.shape, 3), np.float32)
    image[hit] = colour(points, direction)
    image = image.reshape(height, samples, width, samples, 3).mean((1, 3), dtype=np.float32)
    return Picture(image, hit.reshape(height, samples, width, samples).mean((1, 3)) >= 0.5)
