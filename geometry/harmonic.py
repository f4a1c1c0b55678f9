"""Values that a mesh lacks, from those it has: the discrete Laplace equation."""

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array
from scipy.sparse import diags

from geometry.least_squares import factorised
from geometry.mesh import component_labels, neighbour_matrix


def anchored(known: Bool[Array, "vertices"], faces: Integer[Array, "faces 3"]) -> Bool[Array, "vertices"]:
    """Vertices that hang together with a known one."""
    labels = component_labels(faces, len(known))
    return np.isin(labels, labels[known])


def fill_harmonic(
    values: Float[Array, "vertices channels"], known: Bool[Array, "vertices"], faces: Integer[Array, "faces 3"]
) -> Float[Array, "vertices channels"]:
    """Unknown rows become the average of their neighbours, all at once, the known rows being the boundary.

        L values = 0  at unknown vertices,  L the uniform graph Laplacian

    Raises:
        ValueError: an unknown vertex hangs together with no known one: nothing to fill it from.
    """
    free, fixed = np.flatnonzero(~known), np.flatnonzero(known)
    if len(free) == 0:
        return values
    if len(fixed) == 0:
        raise ValueError(f"none of {len(known)} vertices is known, nothing to fill from")
    loose = int((~anchored(known, faces)).sum())
    if loose:
        raise ValueError(f"{loose} vertices hang together with no known vertex")
    rows = neighbour_matrix(faces, len(values))[free]
    laplacian = diags(np.asarray(rows.sum(1)).ravel()) - rows[:, free]
    factors = factorised(laplacian)
    filled = values.astype(np.float64).copy()
    filled[free] = factors.solve(rows[:, fixed] @ values[fixed])
    return filled


def fill_reached(
    values: Float[Array, "vertices channels"], known: Bool[Array, "vertices"], faces: Integer[Array, "faces 3"]
) -> Float[Array, "vertices channels"]:
    """As `fill_harmonic`; rows that hang together with no known one stay as they are."""
    return fill_harmonic(values, known | ~anchored(known, faces), faces)
