"""The canonical template as a signed distance grid: what hair and clothes are carved from, and where a field starts."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array
from scipy import ndimage

from capture.folder import CaptureSubject
from capture.template.surface import SurfaceCloud, air_beyond
from geometry.cells import distance_to
from geometry.isosurface import zero_set_mesh
from geometry.mesh import TriangleMesh
from geometry.sample import lattice_samples
from geometry.winding import winding_grid

# winding numbers of what is surely out of the person and surely in it
OUTSIDE, INSIDE = 0.25, 0.75


class DistanceGrid(NamedTuple):
    """Signed distance of the template at the nodes of a grid, metres, canonical."""

    values: Float32[Array, "x y z"]
    low: Float32[Array, "3"]  # place of values[0, 0, 0]
    cell: float  # metres between nodes

    def at(self, points: Float[Array, "n 3"]) -> Float32[Array, "n"]:
        """Trilinear distance at points; outside the box that of the border plus the way there."""
        last = np.array(self.values.shape) - 1
        place = (points.astype(np.float32) - self.low) / np.float32(self.cell)
        inside = np.clip(place, 0, last.astype(np.float32))
        away = np.linalg.norm((place - inside) * np.float32(self.cell), axis=1)
        return ndimage.map_coordinates(self.values, inside.T, order=1, mode="nearest") + away


def trilinear(
    values: Float[Array, "x y z"], low: Float[Array, "3"], cell: float, points: Float[Array, "n 3"], outside: float
) -> Float[Array, "n"]:
    """Values on a grid whose first node is at `low`, interpolated to points; `outside` of its box."""
    places = ((points - low) / cell).T
    return ndimage.map_coordinates(values, places, order=1, mode="constant", cval=outside)


def distance_grid(
    cloud: SurfaceCloud,
    low: Float[Array, "3"],
    high: Float[Array, "3"],
    cell: float,
    closed: tuple[CaptureSubject, float] | None = None,
) -> DistanceGrid:
    """Signed distance of the cloud on a grid over a box; `closed` fills the cavities of the head.

    The sign is that of the winding number where that is clear, near the surface that of the nearest sample: neither
    one bad normal nor a cut through a sheet opens a hole.
    """
    axes = [np.arange(low[i], high[i] + cell, cell) for i in range(3)]
    shape = (len(axes[0]), len(axes[1]), len(axes[2]))
    # exact within four cells of a sample; farther out the distance between cells is near enough
    distance = distance_to(nodes_at(cloud.points, low, cell, shape)) * cell
    near = np.argwhere(distance < 4 * cell)
    exact, _ = cloud.distance(np.stack([axes[i][near[:, i]] for i in range(3)], 1))
    winding = winding_grid(cloud.points, cloud.normals * cloud.area[:, None], low, shape, cell)
    distance = np.where(winding > 0.5, -distance, distance)
    wound = winding[tuple(near.T)]
    exact = np.where(wound < OUTSIDE, np.abs(exact), np.where(wound > INSIDE, -np.abs(exact), exact))
    distance[tuple(near.T)] = exact
    if closed is not None:
        distance = close_cavities(distance, axes, cell, closed)
    return DistanceGrid(distance.astype(np.float32), low.astype(np.float32), cell)


def nodes_at(
    points: Float[Array, "n 3"], low: Float[Array, "3"], cell: float, shape: tuple[int, ...]
) -> Bool[Array, "x y z"]:
    """The nodes of a grid nearest to points within it."""
    marked = np.zeros(shape, bool)
    index = np.round((points - low) / cell).astype(int)
    marked[tuple(index[((index >= 0) & (index < shape)).all(1)].T)] = True
    return marked


def closed_surface(values: Float[Array, "x y z"], low: Float[Array, "3"], cell: float, outside: float) -> TriangleMesh:
    """The closed zero set of values on a grid whose first node is at `low`; beyond the grid they are `outside`."""
    padded = np.pad(values, 1, constant_values=outside)
    return zero_set_mesh(padded, [first + cell * (np.arange(n) - 1) for first, n in zip(low, padded.shape)])


def close_cavities(
    distance: Float[Array, "x y z"], axes: list[Array], cell: float, closed: tuple[CaptureSubject, float]
) -> Float[Array, "x y z"]:
    """The head's distance with nostrils, ears, eye sockets and mouth filled: a field learns outwards from a plain
    shape more easily than it repairs folds that a grid cannot hold.

    Where the distance disagrees by more than 1.5 cells with that of the closed volume (flood fill round the
    surface two cells thick), the closed volume is right. `closed` names the subject and the height of the neck,
    under which nothing is changed.
    """
    subject, neck = closed
    faces = subject.faces[(subject.vertices[subject.faces, 1] > neck - 0.05).any(1)]
    samples = lattice_samples(subject.vertices, faces, np.full(len(faces), 0.5 * cell))
    points = samples.on(subject.vertices, faces)
    occupied = nodes_at(points, np.array([axis[0] for axis in axes]), cell, distance.shape)
    occupied[:, axes[1] < neck] = True
    outside = air_beyond(occupied, (0, -1, 0))
    air = np.asarray(ndimage.binary_dilation(outside, iterations=2), bool)
    volume = distance_to(~air) - distance_to(air)
    volume = ndimage.gaussian_filter(volume * cell, 1.0)
    above = np.broadcast_to((axes[1] > neck + 3 * cell)[None, :, None], distance.shape)
    surface = above & (np.abs(distance) < 2 * cell)
    # the flood stops at the outer side of the surface cells
    volume += np.median((distance - volume)[surface])
    wrong = above & (np.abs(distance - volume) > 1.5 * cell)
    return ndimage.gaussian_filter(np.where(wrong, volume, distance), 0.6)
