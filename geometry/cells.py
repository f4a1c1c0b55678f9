"""Cells of a regular grid, in any number of dimensions: the nearest marked one, and what hangs together."""

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage


def distance_to(marked: Bool[Array, "*cells"]) -> Float[Array, "*cells"]:
    """Euclidean distance of every cell's centre to the nearest marked cell's, in cells; 0 in marked ones."""
    distance = np.empty(marked.shape, np.float64)
    ndimage.distance_transform_edt(~marked, distances=distance)
    return distance


def nearest_marked(marked: Bool[Array, "*cells"]) -> tuple[Int[Array, "..."], ...]:
    """Index of the nearest marked cell, one array per axis."""
    index = np.empty((marked.ndim, *marked.shape), np.int32)
    ndimage.distance_transform_edt(~marked, return_distances=False, return_indices=True, indices=index)
    return tuple(index[axis] for axis in range(marked.ndim))


def rim_of(marked: Bool[Array, "*cells"]) -> Bool[Array, "*cells"]:
    """Marked cells with a face to one that is not; what lies beyond the grid counts as marked."""
    return marked & ~np.asarray(ndimage.binary_erosion(marked, border_value=1), bool)


def pieces(marked: Bool[Array, "*cells"], reach: int = 1) -> Int[Array, "*cells"]:
    """Connected pieces of the marked cells, numbered from 1: through faces, with reach 3 also edges and corners."""
    label = np.empty(marked.shape, np.int32)
    ndimage.label(marked, ndimage.generate_binary_structure(marked.ndim, reach), output=label)
    return label


def connected_to(free: Bool[Array, "*cells"], start: tuple[int, ...]) -> Bool[Array, "*cells"]:
    """The free cells that are reached from the cell `start` through faces of free cells (flood fill)."""
    label = pieces(free)
    return label == label[start]
