"""How far clothes, hair and the person's own shape stand off the template, along its normals, from all outlines.

    min over d  sum over pairs  rho((r - c . (M n) d)^2 / s^2) + lambda integral (Laplacian d)^2

r the distance of the outline from the template without offsets along the outline's normal, M n the posed normal of the
vertex. The bilaplacian L^T A^-1 L of the graph is sparse; one solve takes a fraction of a second.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import sparse

from avatar.kinematics import pixel_rows, skinned
from capture.fit.footage import Estimate, Footage
from capture.fit.outline_term import SIGMA, Outlines
from capture.fit.priors import Priors
from capture.fit.solve import posed_frames
from geometry.least_squares import factorised, robust_weight
from geometry.mesh import neighbour_matrix, vertex_areas, vertex_normals

# weights of the integral, from stiff to soft; once offsets are there, the softest is enough
STIFFNESS = (1000.0, 100.0, 30.0)
# standard deviations beyond which a pair says little
CUT = 8.0
# one over square metres: what keeps an offset that nothing is known of from growing without end
BARELY = 0.04


def bilaplacian(vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"]) -> sparse.csc_matrix:
    """Q with d^T Q d the integral of the squared Laplacian of d over the surface.

    The Laplacian of a vertex is the mean over its neighbours of (d_j - d_i) / |x_j - x_i|^2, times 4.
    """
    count = len(vertices)
    near = neighbour_matrix(faces, count).tocoo()
    length = np.linalg.norm(vertices[near.row] - vertices[near.col], axis=1)
    weight = 4 / np.maximum(length, 1e-4) ** 2
    degree = np.bincount(near.row, minlength=count)
    weight = weight / np.maximum(degree[near.row], 1)
    L = sparse.coo_matrix((weight, (near.row, near.col)), shape=(count, count)).tocsr()
    L = L - sparse.diags(np.asarray(L.sum(1)).ravel())
    return (L.T @ sparse.diags(vertex_areas(vertices, faces)) @ L).tocsc()


def fit_offsets(
    estimate: Estimate, footage: Footage, outlines: Outlines, chosen: Bool[Array, "vertices"],
    stiffness: tuple[float, ...] = STIFFNESS,
) -> Float[Array, "vertices 3"]:  # fmt: skip
    """Offsets in pose 0 for which the outlines agree best, within what they may stand off; only those of the `chosen`
    vertices change.
    """
    person = estimate.person
    bare = person.vertices(estimate.g) - person.offsets
    normals = vertex_normals(bare, person.body.faces)
    start = (person.offsets * normals).sum(1)
    rows, columns, values = [], [], []
    camera = estimate.camera(footage)
    for frame, pair in zip(posed_frames(estimate).each, outlines.pairs(estimate, footage, chosen)):
        points = estimate.skin(pair.vertices)
        x = skinned(frame, points)
        at, moves = pixel_rows(camera, x)
        c = np.einsum("ni,nij->nj", pair.normals, moves)
        n = normals[pair.vertices]
        out = np.einsum("nsij,nj,ns->ni", frame.R[points.joints], n, points.weights)
        slope = (c * out).sum(1)
        rows.append(((pair.at - at) * pair.normals).sum(1) + slope * start[pair.vertices])
        columns.append(pair.vertices)
        values.append(slope)
    r, vertex, slope = np.concatenate(rows), np.concatenate(columns), np.concatenate(values)
    Q = bilaplacian(bare, person.body.faces)
    sigma = SIGMA * outlines.scale
    d = start.copy()
    free, fixed = np.flatnonzero(chosen), np.flatnonzero(~chosen)
    among, across = Q[free][:, free], Q[free][:, fixed] @ start[fixed]
    for stiff in stiffness:
        e = (r - slope * d[vertex]) ** 2 / sigma**2
        weight = robust_weight(e, CUT) / sigma**2
        H = np.bincount(vertex, weight * slope**2, minlength=len(d))
        b = np.bincount(vertex, weight * slope * r, minlength=len(d))
        A = stiff * among + sparse.diags(H[free] + BARELY)
        d[free] = factorised(A).solve(b[free] - stiff * across)
    if outlines.standoff is not None:
        d[free] = np.clip(d[free], -outlines.standoff[free], outlines.standoff[free])
    return d[:, None] * normals


def dressed(
    estimate: Estimate, footage: Footage, outlines: Outlines, chosen: Bool[Array, "vertices"],
    stiffness: tuple[float, ...] = STIFFNESS,
) -> Estimate:  # fmt: skip
    offsets = fit_offsets(estimate, footage, outlines, chosen, stiffness)
    return replace(estimate, person=replace(estimate.person, offsets=offsets))


def fit_dressed(
    estimate: Estimate, footage: Footage, priors: Priors, chosen: Bool[Array, "vertices"], weights: tuple[float, ...],
    cut: float, report: Callable[[str], None], standoff: Float[Array, "vertices"] | None = None,
) -> Estimate:  # fmt: skip
    """What stands off the shape of the `chosen` vertices, then shape and poses from outlines and keypoints; in turn.

    Clothes, hair and shoes come first: a bare body grows to fill the outline of a clothed one, and where its stature is
    known, it comes nearer instead.
    """
    outlines = Outlines(footage, standoff)
    estimate = dressed(estimate, footage, outlines, chosen)
    report("offsets")
    for weight in weights:
        estimate = outlines.fit(estimate, footage, priors, chosen, (weight,), cut=cut)
        report("outlines")
        estimate = dressed(estimate, footage, outlines, chosen, STIFFNESS[-1:])
        report("offsets")
    return estimate
