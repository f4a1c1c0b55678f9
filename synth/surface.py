"""Measuring a triangle mesh: normals across texture seams, points spread over it, distances to it, what is seen."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from avatar.camera import Camera, look_at, project
from player.raster import Rasteriser

# orthographic directions from which a face may be seen (FRAMES.md, Evaluation)
VIEWS = 64
VIEW_SIZE = 640  # pixels over 2.3 metres: 3.6 mm
# metres: how far behind the depth image a point still counts as on it
VIEW_BIAS = 0.002


class Samples(NamedTuple):
    """Points spread evenly over a mesh."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    # the face each lies on
    faces: Int[np.ndarray, " N"]


def weld(vertices: Float[np.ndarray, "V 3"]) -> Int[np.ndarray, " V"]:
    """For every vertex the first vertex at its place: texture seams repeat vertices that are one point.

    Places are compared to a hundredth of a millimetre.
    """
    _, first, inverse = np.unique(
        np.round(vertices * 1e5).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    return first[inverse.reshape(-1)]


def vertex_normals(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    welded: Int[np.ndarray, " V"] | None = None,
) -> Float[np.ndarray, "V 3"]:
    """Unit normals: the faces' normals, weighted by area and summed over `welded` vertices; 0 where no face is."""
    corners = vertices[faces].astype(np.float64)
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    index = faces if welded is None else welded[faces]
    normals = np.stack(
        [np.bincount(index.ravel(), np.repeat(area[:, c], 3), minlength=len(vertices)) for c in range(3)], 1
    )
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return normals if welded is None else normals[welded]


def spread_points(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int, seed: int) -> Samples:
    """`count` points spread over a mesh by area: stratified along the faces, uniform inside each."""
    corners = vertices[faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice_area = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(twice_area, 1e-30)[:, None]
    rng = np.random.default_rng(seed)
    cumulative = np.cumsum(twice_area)
    at = (np.arange(count) + rng.random(count)) / count * cumulative[-1]
    face = np.minimum(np.searchsorted(cumulative, at), len(faces) - 1)
    u, v = rng.random((2, count))
    flip = u + v > 1
    u[flip], v[flip] = 1 - u[flip], 1 - v[flip]
    a, b, c = corners[face, 0], corners[face, 1], corners[face, 2]
    return Samples(a + u[:, None] * (b - a) + v[:, None] * (c - a), normals[face], face)


def surface_distance(points: Float[np.ndarray, "N 3"], surface: Samples) -> Float[np.ndarray, " N"]:
    """Distance from points to a densely sampled surface: along the nearest sample's normal, when it is that near.

    The tangential part below the samples' own spacing is sampling, not distance, and is taken off.
    """
    tree = KDTree(surface.points)
    spacing = 2 * np.median(tree.query(surface.points[:: max(1, len(surface.points) // 2000)], k=2)[0][:, 1])
    _, nearest = tree.query(points)
    apart = points - surface.points[nearest]
    along = (apart * surface.normals[nearest]).sum(1)
    across = np.sqrt(np.maximum((apart * apart).sum(1) - along * along, 0))
    return np.hypot(along, np.maximum(across - spacing, 0))


def visible_faces(
    rasteriser: Rasteriser, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Bool[np.ndarray, " F"]:
    """Faces seen from any of VIEWS directions spread over the sphere."""
    return view_counts(rasteriser, vertices, faces) > 0


def view_counts(
    rasteriser: Rasteriser, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Int[np.ndarray, " F"]:
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


def fibonacci_sphere(count: int) -> Float[np.ndarray, "count 3"]:
    """Unit directions spread evenly over the sphere."""
    i = np.arange(count) + 0.5
    y = 1 - 2 * i / count
    angle = np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(angle), y, r * np.sin(angle)], 1)
