"""Points spread over a mesh: at a spacing, or a number of them drawn by area."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array

from geometry.mesh import check_mesh, face_areas


class SurfaceSamples(NamedTuple):
    """Points that ride on their triangles when the mesh is posed."""

    face: Integer[Array, "n"]
    barycentric: Float[Array, "n 3"]

    def on(self, values: Float[Array, "vertices c"], faces: Integer[Array, "faces 3"]) -> Float[Array, "n c"]:
        """Vertex values interpolated to the samples; with posed vertices, the posed sample points."""
        return np.einsum("ni,nic->nc", self.barycentric, values[faces[self.face]])


def lattice_samples(
    vertices: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"], spacing: Float[Array, "faces"]
) -> SurfaceSamples:
    """Samples about `spacing` apart, nothing by chance; none where there is no face.

    Each face is cut into n^2 equal triangles, n = longest edge / spacing rounded, and sampled at their centres.
    """
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    counts = np.clip(np.round(longest / spacing), 1, 64).astype(int)
    rows, weights = [np.zeros(0, np.int64)], [np.zeros((0, 3))]
    for n in np.unique(counts):
        chosen = np.flatnonzero(counts == n)
        i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
        up = (i + j) < n
        down = (i + j) < n - 1
        a = np.concatenate([(i[up] + 1 / 3) / n, (i[down] + 2 / 3) / n])
        b = np.concatenate([(j[up] + 1 / 3) / n, (j[down] + 2 / 3) / n])
        barycentric = np.stack([1 - a - b, a, b], 1)
        rows.append(np.repeat(chosen, len(barycentric)))
        weights.append(np.tile(barycentric, (len(chosen), 1)))
    return SurfaceSamples(np.concatenate(rows), np.concatenate(weights))


def stratified_samples(
    vertices: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"], count: int, *,
    seed: int | np.random.Generator, weight: Float[Array, "faces"] | Bool[Array, "faces"] | None = None,
) -> SurfaceSamples:  # fmt: skip
    """`count` seeded points, uniform by area times `weight`: one in each of `count` equal slices of it.

    Unlike trimesh.sample, whose faces are drawn independently, a few samples already cover small parts.

    Raises:
        ValueError: no face has any area (times weight), or the mesh names vertices that it lacks.
    """
    check_mesh(vertices, faces, "mesh to sample")
    area = face_areas(vertices, faces)
    if weight is not None:
        area = area * weight
    cumulative = np.cumsum(area)
    if not cumulative[-1] > 0:
        raise ValueError("mesh to sample: no face that is kept has any area")
    rng = np.random.default_rng(seed)
    level = np.minimum((np.arange(count) + rng.random(count)) / count * cumulative[-1], np.nextafter(cumulative[-1], 0))
    face = np.searchsorted(cumulative, level, side="right")
    u, v = rng.random((2, count))
    # the far half of the parallelogram is folded back onto the triangle
    beyond = u + v > 1
    u[beyond], v[beyond] = 1 - u[beyond], 1 - v[beyond]
    return SurfaceSamples(face.astype(np.int64), np.stack([1 - u - v, u, v], 1))
