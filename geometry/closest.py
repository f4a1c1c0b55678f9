"""The point of a triangle closest to a given one."""

import numpy as np
from jaxtyping import Float

Array = np.ndarray


def closest_on_triangles(
    points: Float[Array, "n 3"], corners: Float[Array, "n 3 3"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Closest point of one triangle per row, and its barycentric coordinates (Ericson 2004, section 5.1.5).

    A triangle without area gives a point of its longest edge.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    d1, d2 = (ab * ap).sum(1), (ac * ap).sum(1)
    aa, cc, ac_ab = (ab * ab).sum(1), (ac * ac).sum(1), (ab * ac).sum(1)
    area = aa * cc - ac_ab**2
    safe = np.where(area > 1e-30, area, 1.0)
    v, w = (cc * d1 - ac_ab * d2) / safe, (aa * d2 - ac_ab * d1) / safe
    inside = (v >= 0) & (w >= 0) & (v + w <= 1) & (area > 1e-30)
    best = np.stack([1 - v - w, v, w], 1)
    shortest = np.where(inside, 0.0, np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        edge = corners[:, j] - corners[:, i]
        length = (edge * edge).sum(1)
        t = np.clip(((points - corners[:, i]) * edge).sum(1) / np.where(length > 0, length, 1.0), 0, 1)
        gap = ((points - corners[:, i] - t[:, None] * edge) ** 2).sum(1)
        nearer = ~inside & (gap < shortest)
        shortest = np.where(nearer, gap, shortest)
        on_edge = np.zeros_like(best)
        on_edge[:, i], on_edge[:, j] = 1 - t, t
        best = np.where(nearer[:, None], on_edge, best)
    return np.einsum("nk,nkc->nc", best, corners), best
