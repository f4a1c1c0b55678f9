"""The trained field of a run under posed cameras: its fine surface is posed and rasterised, and each pixel's canonical
point asked for its color at one of three view directions. bench/field/rungs.py draws the same by volume rendering.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.camera import Camera, pixel_rays, project
from avatar.skeleton import BIG_POSE, skin_transforms
from avatar.skinning import SkinWeights, blended_rotations, skin_points
from bake.cone import ViewCone, clamped_tangent, cone_direction, interpolated, view_cone
from bake.field import one_thread
from player.draw.raster import Rasteriser
from synth.photo import block_sum
from train.fused import FusedField
from train.run import Run

CHUNK = 1 << 16  # field queries at once
# metres: a vertex is not moved farther than this in one step onto the zero set
FARTHEST = 0.002
CLOSE = 5e-5  # metres: nearer than this counts as on it

# The direction that F_c (Eq. 2) is asked at:
#   global  d_bar of Eq. 14, the non-rigid ray transformation: color depends on the point alone
#   own     the pixel's own ray turned into the canonical frame by the inverse skin of the point it hits, as the
#           training rays were: section 3.5's "original view direction", the row "w/o ray transform" of Table 4
#   cone    that direction pulled into the cone that training saw (d')
Directions = Literal["global", "own", "cone"]


@dataclass(frozen=True)
class PosableSurface:
    """A mesh in the canonical (big) pose that follows the skeleton."""

    vertices: Float[Array, "vertices 3"]  # canonical, metres
    faces: Int[Array, "faces 3"]
    skin: SkinWeights
    joints: Float[Array, "52 3"]  # pose 0
    canonical_pose: Float[Array, "52 3"]

    def posed(self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"]) -> Float[Array, "vertices 3"]:
        return skin_points(self.vertices, self.skin, self.transforms(axis_angle, root))

    def transforms(self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"]) -> Float[Array, "52 4 4"]:
        return skin_transforms(axis_angle, self.joints, root, rest=self.canonical_pose)


class MaskedPicture(NamedTuple):
    color: Float[Array, "height width 3"]  # [0, 1] sRGB, black where nothing is
    mask: Bool[Array, "height width"]


class PosedField:
    """A run's field with its fine surface, skin and view cone, asked with arrays, a piece at a time."""

    @one_thread()
    def __init__(self, run: Run):
        s = run.surface
        self.field = run.field
        # as the body's video was lit, world; None where no light is known apart from the albedo
        self.light = run.world_light
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

    def distance(self, points: Float[Array, "n 3"]) -> Float[Array, "n"]:
        """Signed distance of canonical points, metres."""
        return in_pieces(self.field.distance, points)

    def color(self, points: Float[Array, "n 3"], directions: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Color of canonical points on the surface at given unit directions, [0, 1] sRGB."""
        return in_pieces(self.field.color, points, directions).clip(0, 1)

    def shown(
        self,
        points: Float[Array, "n 3"],
        seen: ViewCone,
        rotations: Float[Array, "n 3 3"],
        rays: Float[Array, "n 3"],
        directions: Directions,
    ) -> Float[Array, "n 3"]:
        """Color of canonical points that rays of the world meet; `rotations` are world_from_canonical."""
        asked = seen.direction
        if directions != "global":
            asked = np.einsum("nji,nj->ni", rotations, rays)
        if directions == "cone":
            asked = cone_direction(clamped_tangent(asked, seen), seen)
        if self.light is None:
            return self.color(points, asked)
        albedo = in_pieces(self.field.albedo, points, asked).astype(np.float64)
        normals = in_pieces(self.field.light_normal, points).astype(np.float64)
        normals = np.einsum("nij,nj->ni", rotations, normals)
        return self.light.shown(albedo, self.light.shading(normals), self.light.highlight(normals, -rays))

    def draw(
        self,
        raster: Rasteriser,
        axis_angle: Float[Array, "52 3"],
        root: Float[Array, "3"],
        camera: Camera,
        *,
        samples: int = 1,
        directions: Directions = "global",
        where: Bool[Array, "height width"] | None = None,
    ) -> MaskedPicture:
        """One picture on black, silhouettes smoothed by `samples` squared a pixel; colors outside `where` stay black.
        Where the run has a light, it is lit as the body's video was."""
        surface, posed = self.surface, self.surface.posed(axis_angle, root)
        faces = faces_in_picture(posed, surface.faces, camera)
        fragments = raster.draw(posed, faces, camera, (samples * camera.size[0], samples * camera.size[1]))
        cover = fragments.face >= 0
        chosen = first_samples(cover, samples)
        if where is not None:
            inside = where[chosen[0] // samples, chosen[1] // samples]
            chosen = chosen[0][inside], chosen[1][inside]
        corners = faces[fragments.face[chosen]]
        weight = fragments.barycentric[chosen].astype(np.float64)
        points = (weight[:, :, None] * surface.vertices[corners]).sum(1)
        seen = interpolated(self.cone, corners, weight)
        if directions == "global" and self.light is None:
            return shaded(cover, chosen, self.color(points, seen.direction), samples)
        rotations = blended_rotations(surface.skin, surface.transforms(axis_angle, root))
        rows, columns = chosen
        rays = pixel_rays(camera, (np.stack([columns, rows], -1) + 0.5) / samples)[1]
        rotations = rotations[corners[np.arange(len(corners)), weight.argmax(1)]]
        return shaded(cover, chosen, self.shown(points, seen, rotations, rays, directions), samples)


def in_pieces(function: Callable[..., torch.Tensor], *arrays: Float[Array, "n 3"]) -> Array:
    """A function of points of the field, for arrays of any length: float32, CHUNK rows at once, without a graph."""
    with one_thread(), torch.no_grad():
        tensors = [torch.as_tensor(array, dtype=torch.float32).split(CHUNK) for array in arrays]
        return torch.cat([function(*own) for own in zip(*tensors, strict=True)]).numpy()


def on_zero_set(field: FusedField, points: Float[Array, "n 3"], steps: int = 2) -> Float[Array, "n 3"]:
    """Points near the surface moved along the gradient onto the zero set: Newton steps, each at most FARTHEST."""

    def moved(part: torch.Tensor) -> torch.Tensor:
        """Points after some steps of Newton's towards the surface."""
        for _ in range(steps):
            distance = field.distance(part)
            # what lies farther off is no surface of the field's but where layers were divided (layers.py)
            off = (distance.abs() > CLOSE) & (distance.abs() < 3 * FARTHEST)
            if not bool(off.any()):
                break
            step = distance[off].clamp(-FARTHEST, FARTHEST)[:, None] * field.normal(part[off])
            part = part.index_put((off,), part[off] - step)
        return part

    return in_pieces(moved, points).astype(np.float64)


def faces_in_picture(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], camera: Camera
) -> Int[Array, "g 3"]:
    """Faces that may show in the picture: not all three corners beyond the same edge."""
    pixels, depth = project(camera, vertices)
    width, height = camera.size
    front = depth > 1e-6
    beyond = np.stack([pixels[:, 0] < 0, pixels[:, 0] > width, pixels[:, 1] < 0, pixels[:, 1] > height], axis=-1)
    code = (beyond * np.array([1, 2, 4, 8], np.uint8)).sum(-1, dtype=np.uint8)
    # its pixel means nothing: left to the rasteriser, which clips
    code[~front] = 0
    a, b, c = faces.T
    return faces[(code[a] & code[b] & code[c]) == 0]


def first_samples(cover: Bool[Array, "a b"], samples: int) -> tuple[Array, Array]:
    """Row and column of the first covered sample of every pixel that has one: the one that is shaded."""
    height, width = cover.shape[0] // samples, cover.shape[1] // samples
    blocks = cover.reshape(height, samples, width, samples).transpose(0, 2, 1, 3).reshape(height, width, -1)
    rows, columns = np.nonzero(blocks.any(-1))
    within = blocks[rows, columns].argmax(-1)
    return rows * samples + within // samples, columns * samples + within % samples


def shaded(
    cover: Bool[Array, "a b"], chosen: tuple[Array, Array], color: Float[Array, "n 3"], samples: int
) -> MaskedPicture:
    """The picture of one shaded sample a pixel, dimmed by the share of the pixel that is covered."""
    share = block_sum(cover.astype(np.uint8), samples) / np.float32(samples**2)
    image = np.zeros((*share.shape, 3), np.float32)
    image[chosen[0] // samples, chosen[1] // samples] = color
    return MaskedPicture(image * share[..., None], share >= 0.5)


def averaged(image: Float[Array, "a b 3"], mask: Bool[Array, "a b"], samples: int) -> MaskedPicture:
    """Means of samples x samples blocks; a pixel is inside when at least half of it is."""
    cover = block_sum(mask.astype(np.uint8), samples)
    return MaskedPicture(block_sum(image, samples) / np.float32(samples**2), 2 * cover >= samples**2)
