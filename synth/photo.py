"""Taking a picture of a subject: fragments, textures, light, supersampling; with its mask and part image.

Samples are averaged as sRGB values, as most renderers of training data do; the background is black.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from avatar.camera import Camera
from avatar.skeleton import PARTS, skin_transforms
from avatar.skinning import skin_points
from avatar.texture import sample_texture
from geometry.mesh import blended, vertex_normals, weld
from player.draw.raster import Rasteriser
from synth.light import FilmLight, shade, sheen_of
from synth.room import Room, RoomLighting, VertexLight, shade_in_room
from synth.subject import SynthSubject


class Photo(NamedTuple):
    """One picture; row 0 is the top."""

    image: UInt8[Array, "height width 3"]
    # 255 where the person covers half of the pixel or more
    mask: UInt8[Array, "height width"]
    parts: UInt8[Array, "height width"]  # 1 + part (index in PARTS) that covers most of the pixel, 0 outside the mask


class Studio:
    """A subject before the camera: what does not change from picture to picture is prepared once.

    `sheen`: how much the subject shines (synth/light.py), 0 to 1.
    """

    def __init__(self, rasteriser: Rasteriser, subject: SynthSubject, supersample: int = 3, sheen: float = 0.0):
        self.rasteriser, self.subject, self.supersample, self.sheen = rasteriser, subject, supersample, sheen
        self.welded = weld(subject.vertices)
        self.face_part = subject.part[subject.faces[:, 0]]
        self.lighting = RoomLighting(rasteriser, subject.faces, self.welded)

    def posed(
        self, axis_angle: Float[Array, "52 3"], root: Float[Array, "3"], moved: Float[Array, "vertices 3"] | None = None
    ) -> Float[Array, "vertices 3"]:
        """The vertices in a pose; `moved`: how far they are off their places in pose 0 before it."""
        joints = self.subject.joints.astype(np.float64)
        transforms = skin_transforms(axis_angle, joints, root, rest=np.zeros((52, 3)))
        places = self.subject.vertices if moved is None else self.subject.vertices + moved
        return skin_points(places, self.subject.skin, transforms)

    def take(self, vertices: Float[Array, "vertices 3"], camera: Camera, light: FilmLight) -> Photo:
        """A picture of posed vertices."""
        n = self.supersample
        samples, hit, face = self._samples(vertices, camera, light, None)
        image = np.round(block_sum(samples, n) / n**2).astype(np.uint8)
        covered = 2 * block_sum(hit.astype(np.uint8), n) >= n**2
        labels = np.zeros(hit.shape, np.uint8)
        labels[hit] = 1 + self.face_part[face]
        counts = np.stack([block_sum((labels == 1 + part).astype(np.uint8), n) for part in range(len(PARTS))])
        parts = np.where(covered, 1 + counts.argmax(0), 0).astype(np.uint8)
        return Photo(image, np.where(covered, 255, 0).astype(np.uint8), parts)

    def expose(
        self, vertices: Float[Array, "vertices 3"], camera: Camera, light: FilmLight, lit: VertexLight | None = None
    ) -> tuple[Float[Array, "height width 3"], Float[Array, "height width"]]:
        """A picture to lay over another one, color + (1 - coverage) * what lies behind: color, sRGB 0 to 255, times
        coverage, and coverage, the share of the pixel that shows the person. `lit`: light in a room, found before."""
        n = self.supersample
        samples, hit, _ = self._samples(vertices, camera, light, lit)
        return block_sum(samples, n) / n**2, block_sum(hit.astype(np.float32), n) / n**2

    def _samples(
        self,
        vertices: Float[Array, "vertices 3"],
        camera: Camera,
        light: FilmLight,
        lit: VertexLight | None,
    ) -> tuple[Float[Array, "height width 3"], Bool[Array, "height width"], Int[Array, "hits"]]:
        """Colours of all samples, 0 where nothing is; where something is; and the faces there."""
        width, height = camera.size
        n = self.supersample
        fragments = self.rasteriser.draw(vertices, self.subject.faces, camera.resized((n * width, n * height)))
        hit = fragments.face >= 0
        face, weights = fragments.face[hit], fragments.barycentric[hit]
        color = self._color(face, weights)
        if isinstance(light, Room) or light.key > 0 or self.sheen > 0:
            corners = self.subject.faces[face]
            normals = blended(vertex_normals(vertices, self.subject.faces, self.welded), corners, weights)
            normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
            towards_eye = camera.eye - blended(vertices, corners, weights)
            towards_eye /= np.linalg.norm(towards_eye, axis=1, keepdims=True)
            if isinstance(light, Room):
                facing = (normals * towards_eye).sum(1)
                lit = self.lighting.on(vertices, light) if lit is None else lit
                arriving = lit.at(corners, weights, behind=facing < 0)
                normals = np.where(facing[:, None] < 0, -normals, normals)
                color = shade_in_room(color, normals, towards_eye, arriving, light)
                color += 255 * sheen_of(np.abs(facing), self.sheen)[:, None]
            else:
                color = shade(color, normals, towards_eye, light, self.sheen)
        samples = np.zeros((*hit.shape, 3), np.float32)
        samples[hit] = np.clip(color, 0, 255)
        return samples, hit, face

    def _color(self, face: Int[Array, "n"], weights: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        subject = self.subject
        # float32: a ten-thousandth of a texel
        uv = blended(subject.uv, subject.faces[face], weights)
        # the samplers repeat; a coordinate of exactly 1 is the far edge, not the near one
        uv = np.where((uv < 0) | (uv > 1), uv - np.floor(uv), uv)
        if len(subject.textures) == 1:
            return sample_texture(subject.textures[0], uv)
        material = subject.material[face]
        color = np.empty((len(face), 3), np.float32)
        for i, texture in enumerate(subject.textures):
            rows = material == i
            if rows.any():
                color[rows] = sample_texture(texture, uv[rows])
        return color


def block_sum(samples: Array, n: int) -> Array:
    """Sums of n x n blocks; slices are several times faster than a reduction over two inner axes."""
    total = samples[::n, ::n].copy()
    for k in range(1, n * n):
        total += samples[k // n :: n, k % n :: n]
    return total
