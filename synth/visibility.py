"""Which faces of a mesh can be seen from outside."""

import numpy as np
from jaxtyping import Bool, Float, Int

from avatar.camera import Camera, look_at, project
from avatar.rotation import fibonacci_sphere
from player.draw.raster import Rasteriser

# orthographic directions from which a face may be seen (FRAMES.md, Evaluation)
VIEWS = 64
VIEW_SIZE = 640  # pixels over 2.3 metres: 3.6 mm
# metres: how far behind the depth image a point still counts as on it
VIEW_BIAS = 0.002


def visible_faces(
    rasteriser: Rasteriser, vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> Bool[np.ndarray, "faces"]:
    """Faces seen from any of VIEWS directions spread over the sphere."""
    return view_counts(rasteriser, vertices, faces, enough=1) > 0


def view_counts(
    rasteriser: Rasteriser, vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"], enough: int
) -> Int[np.ndarray, "faces"]:
    """From how many of VIEWS directions each face is seen; beyond `enough` not all of them are counted.

    Seen: drawn in the view's image, or, for faces smaller than a pixel, their middle lies on the depth image.
    """
    middles, count = vertices[faces].mean(1).astype(np.float64), np.zeros(len(faces), np.int64)
    for camera in outside_cameras(vertices):
        fragments = rasteriser.draw(vertices, faces, camera)
        seen = np.zeros(len(faces), bool)
        seen[fragments.face[fragments.face >= 0]] = True
        left = np.flatnonzero(~seen & (count < enough))
        # on what was drawn, or before it
        pixels, depth = project(camera, middles[left])
        x, y = np.clip(pixels.astype(np.int64), 0, VIEW_SIZE - 1).T
        seen[left] = (fragments.face[y, x] >= 0) & (depth < fragments.depth[y, x] + VIEW_BIAS)
        count += seen
    return count


def outside_cameras(vertices: Float[np.ndarray, "vertices 3"]) -> list[Camera]:
    """Cameras all round, 60 metres off, which is as good as orthographic: rays over a person differ by 2 degrees."""
    centre = (vertices.min(0) + vertices.max(0)) / 2
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    distance = 60.0
    focal = 0.5 * VIEW_SIZE / (1.02 * radius / distance)
    K = np.array([[focal, 0, VIEW_SIZE / 2], [0, focal, VIEW_SIZE / 2], [0, 0, 1]])
    size = (VIEW_SIZE, VIEW_SIZE)
    return [Camera(K, look_at(centre + distance * d, centre), size) for d in fibonacci_sphere(VIEWS)]
