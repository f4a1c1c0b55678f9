"""Pictures of the trained field: its first surface crossing under a posed camera.

The fine surface is moved onto the field's zero set, posed and rasterised, and each pixel's canonical point is
asked for its colour there: at the global view direction d̄ (the paper, Eq. 14: colour depends on the point alone), or
at the pixel's own direction pulled into the cone that training saw (d').
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from avatar.camera import Camera, pixel_rays
from avatar.skeleton import BIG_POSE, skin_transforms
from avatar.skinning import SkinWeights, blended_rotations, skin_points
from bake.cone import clamped_tangent, cone_direction, interpolated, view_cone
from player.raster import Rasteriser
from train.fused import FusedField
from train.run import Run

CHUNK = 1 << 16  # field queries at once
FARTHEST = 0.002  # metres: a vertex is not moved farther than this in one step onto the zero set
CLOSE = 5e-5  # metres: nearer than this counts as on it


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
        return skin_points(self.vertices, self.skin, self.transforms(axis_angle, root))

    def transforms(
        self, axis_angle: Float[np.ndarray, "52 3"], root: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "52 4 4"]:
        return skin_transforms(axis_angle, self.joints, root, rest=self.canonical_pose)


class Picture(NamedTuple):
    colour: Float[np.ndarray, "h w 3"]  # [0, 1] sRGB, black where nothing is
    mask: Bool[np.ndarray, "h w"]


class FieldView:
    """A run made ready for drawing: fine surface, its skin, its view cone."""

    def __init__(self, run: Run):
        s = run.surface
        self.field = run.field
        self.surface = PosableSurface(
            on_zero_set(run.field, np.asarray(s.vertices, np.float64)),
            np.asarray(s.faces, np.int64),
            SkinWeights(s.skin.joints.astype(np.int64), s.skin.weights),
            np.asarray(run.subject.joints, np.float64),
            BIG_POSE,
        )
        count, mean, covariance, normals = (
            np.asarray(a, np.float64) for a in (s.view_count, s.view_mean, s.view_covariance, s.normals)
        )
        self.cone = view_cone(count, mean, covariance, normals, self.surface.faces)

    def draw(
        self,
        raster: Rasteriser,
        axis_angle: Float[np.ndarray, "52 3"],
        root: Float[np.ndarray, "3"],
        camera: Camera,
        *,
        samples: int = 1,
        cone: bool = False,
        surface: PosableSurface | None = None,
    ) -> Picture:
        """One picture on black, silhouettes smoothed by `samples` squared a pixel. `cone` asks the field at d' instead of at d̄;
        `surface` is the same mesh with other skin weights."""
        surface = surface or self.surface
        posed = surface.posed(axis_angle, root)
        fragments = raster.draw(
            posed, surface.faces, camera, (samples * camera.size[0], samples * camera.size[1])
        )
        cover = fragments.face >= 0
        chosen = first_samples(cover, samples)
        corners = surface.faces[fragments.face[chosen]]
        weight = fragments.barycentric[chosen].astype(np.float64)
        points = (weight[:, :, None] * surface.vertices[corners]).sum(1)
        seen = interpolated(self.cone, corners, weight)
        direction = seen.direction
        if cone:
            rotations = blended_rotations(surface.skin, surface.transforms(axis_angle, root))
            rows, columns = chosen
            rays = pixel_rays(camera, (np.stack([columns, rows], -1) + 0.5) / samples)[1]
            strongest = corners[np.arange(len(corners)), weight.argmax(1)]
            in_canonical = np.einsum("nji,nj->ni", rotations[strongest], rays)
            direction = cone_direction(clamped_tangent(in_canonical, seen), seen)
        return shaded(cover, chosen, self.colour(points, direction), samples)

    def colour(
        self, points: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 3"]:
        """Colour of canonical points on the surface at given unit directions."""
        out = np.empty((len(points), 3), np.float32)
        with torch.no_grad():
            for start in range(0, len(points), CHUNK):
                x = torch.as_tensor(points[start : start + CHUNK], dtype=torch.float32)
                d = torch.as_tensor(directions[start : start + CHUNK], dtype=torch.float32)
                out[start : start + CHUNK] = self.field.color(x, d).clamp(0, 1).numpy()
        return out


def on_zero_set(
    field: FusedField, points: Float[np.ndarray, "n 3"], steps: int = 2
) -> Float[np.ndarray, "n 3"]:
    """Points near the surface moved along the gradient onto the zero set: Newton steps, each at most FARTHEST."""
    moved = torch.as_tensor(points, dtype=torch.float32).clone()
    with torch.no_grad():
        for start in range(0, len(moved), CHUNK):
            part = moved[start : start + CHUNK]
            for _ in range(steps):
                distance = field.distance(part)
                off = distance.abs() > CLOSE
                if not bool(off.any()):
                    break
                step = distance[off].clamp(-FARTHEST, FARTHEST)[:, None] * field.normal(part[off])
                part[off] = part[off] - step
    return moved.numpy().astype(np.float64)


def first_samples(cover: Bool[np.ndarray, "a b"], samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the first covered sample of every pixel that has one: the one that is shaded."""
    height, width = cover.shape[0] // samples, cover.shape[1] // samples
    blocks = cover.reshape(height, samples, width, samples).transpose(0, 2, 1, 3).reshape(height, width, -1)
    rows, columns = np.nonzero(blocks.any(-1))
    within = blocks[rows, columns].argmax(-1)
    return rows * samples + within // samples, columns * samples + within % samples


def shaded(
    cover: Bool[np.ndarray, "a b"],
    chosen: tuple[np.ndarray, np.ndarray],
    colour: Float[np.ndarray, "n 3"],
    samples: int,
) -> Picture:
    """The picture of one shaded sample a pixel, dimmed by the share of the pixel that is covered."""
    height, width = cover.shape[0] // samples, cover.shape[1] // samples
    share = cover.reshape(height, samples, width, samples).mean((1, 3), dtype=np.float32)
    image = np.zeros((height, width, 3), np.float32)
    image[chosen[0] // samples, chosen[1] // samples] = colour
    return Picture(image * share[..., None], share >= 0.5)


def averaged(image: Float[np.ndarray, "a b 3"], mask: Bool[np.ndarray, "a b"], samples: int) -> Picture:
    """Means of samples x samples blocks; a pixel is inside when at least half of it is."""
    if samples == 1:
        return Picture(image, mask)
    height, width = mask.shape[0] // samples, mask.shape[1] // samples
    blocks = image.reshape(height, samples, width, samples, 3)
    cover = mask.reshape(height, samples, width, samples).mean((1, 3))
    return Picture(blocks.mean((1, 3), dtype=np.float32), cover >= 0.5)
