"""Which faces of a mesh can be seen from outside."""

import numpy as np
from jaxtyping import Bool, Float, Int

from avatar.camera import Camera, look_at, project
from geometry.sample import fibonacci_sphere
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
    return view_counts(rasteriser, vertices, faces) > 0


def view_counts(
    rasteriser: Rasteriser, vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> Int[np.ndarray, "faces"]:
    """From how many of VIEWS directions each face is seen.

    Seen: drawn in the view's image, or, for faces smaller than a pixel, their middle lies on the depth image.
    The cameras stand 60 metres off, which is as good as orthographic: rays over a person differ by 2 degrees.
    """
    middle = vertices[faces].mean(1).astype(np.float64)
    centre = (vertices.min(0) + vertices.max(0)) / 2
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    distance = 60.0
    focal = 0.5 * VIEW_SIZE / (1.02 * radius / distance)
    K = np.array([[focal, 0, VIEW_SIZE / 2], [0, focal, VIEW_SIZE / 2], [0, 0, 1]])
    count = np.zeros(len(faces), np.int64)
    for direction in fibonacci_sphere(VIEWS):
        camera = Camera(K, look_at(centre + distance * direction, centre), (VIEW_SIZE, VIEW_SIZE))
        fragments = rasteriser.draw(vertices, faces, camera)
        pixels, depth = project(camera, middle)
        x, y = np.clip(pixels.astype(np.int64), 0, VIEW_SIZE - 1).T
        seen = (fragments.face[y, x] >= 0) & (depth < fragments.depth[y, x] + VIEW_BIAS)
        seen[fragments.face[fragments.face >= 0]] = True
        count += seen
    return count
