"""Particles and the capsules that they keep out of."""

import numpy as np
from jaxtyping import Float

Array = np.ndarray


def capsule_distances(
    points: Float[Array, "n 3"], starts: Float[Array, "capsules 3"], ends: Float[Array, "capsules 3"]
) -> Float[Array, "n capsules"]:
    """From each point to the line in the middle of each capsule."""
    return np.sqrt(np.maximum(_squared(points, starts, ends), 0)).T


def _squared(points: Array, starts: Array, ends: Array) -> Float[Array, "capsules n"]:
    """The distances' squares, to rounding.

    |p - s - t a|^2 = |p - s|^2 + t (t - 2 q) |a|^2        q = (p - s) a / |a|^2, t = q between 0 and 1

    |p - s|^2 and q are linear in (p, |p|^2, 1): one product of matrices, the rest in place.
    """
    count = len(starts)
    along = ends - starts
    length2 = np.maximum(np.einsum("ki,ki->k", along, along), 1e-18)[:, None]
    linear = np.empty((2 * count, 5))
    linear[:count, :3] = along
    linear[:count, 3] = 0
    linear[:count, 4] = -np.einsum("ki,ki->k", starts, along)
    linear[:count] /= length2
    linear[count:, :3] = -2 * starts
    linear[count:, 3] = 1
    linear[count:, 4] = np.einsum("ki,ki->k", starts, starts)
    lifted = np.empty((5, len(points)))
    lifted[:3] = points.T
    lifted[3] = np.einsum("ni,ni->n", points, points)
    lifted[4] = 1
    products = linear @ lifted
    q, out = products[:count], products[count:]
    share = np.minimum(np.maximum(q, 0), 1)
    q *= -2
    q += share
    q *= share
    q *= length2
    out += q
    return out


class Apart:
    """How far particles keep off capsules."""

    def __init__(self, radii: Float[Array, "particles capsules"], least: float):
        """radii: what a particle keeps off the line in the middle; deeper in than `least` it is moved."""
        self._radii = np.ascontiguousarray(radii.T)
        self._limits = np.where(self._radii > least, (self._radii - least) ** 2, -1.0)

    def pushed(self, y: Float[Array, "particles 3"], ends: Float[Array, "2 capsules 3"]) -> Array | None:
        """The particles, each moved out of the capsule that it is deepest in; None: none is deep in any."""
        if not self._limits.size:
            return None
        within = _squared(y, *ends) < self._limits
        if not within.any():
            return None
        which, own = np.nonzero(within)
        start = ends[0][which]
        along = ends[1][which] - start
        point = y[own] - start
        length2 = np.maximum(np.einsum("nc,nc->n", along, along), 1e-18)
        share = np.minimum(np.maximum(np.einsum("nc,nc->n", point, along) / length2, 0), 1)
        off = point - share[:, None] * along
        far = np.sqrt(np.einsum("nc,nc->n", off, off))
        deep = self._radii[which, own] - far
        # the deepest is written last
        order = np.argsort(deep, kind="stable")
        out = y.copy()
        out[own[order]] = (y[own] + (deep / np.maximum(far, 1e-9))[:, None] * off)[order]
        return out
