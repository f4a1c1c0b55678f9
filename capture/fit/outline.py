"""Silhouettes on masks: where one lies as a whole, and what of the distance of their outlines is shape."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage, signal
from scipy.spatial import KDTree

from capture.folder import CaptureSubject
from geometry.mesh import vertex_normals

# standard deviations, from where on patches of the surface know nothing of each other
REACH = 3.5


def placement(
    template: Bool[Array, "canvas_height canvas_width"],
    mask: Bool[Array, "height width"],
    centre: Float[Array, "2"],
    near: float,
) -> tuple[float, Float[Array, "2"]]:
    """The turn (radians) about `centre` and the shift (x, y; pixels) that cover the mask best with a silhouette.

    The template is drawn on a canvas three times the image, the image in its middle. Counted are template
    pixels on the mask less those beside it within the image; shifts are taxed by their square over `near`,
    turns alike over 10 degrees. Half resolution is enough: outlines are what is matched afterwards.
    """
    h, w = mask[::2, ::2].shape
    half, vote_of = template[::2, ::2].astype(np.float32), (2.0 * mask[::2, ::2] - 1)[::-1, ::-1]
    best: tuple[float, float, Array] = (-np.inf, 0.0, np.zeros(2))
    for degrees in (-16.0, -8.0, 0.0, 8.0, 16.0):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        back = np.array([[c, -s], [s, c]])  # (row, column), output to input
        middle = centre[::-1] / 2
        turned = half
        if degrees:
            offset: Any = middle - back @ middle
            turned = np.asarray(ndimage.affine_transform(half, back, offset=offset, order=0))
        vote = signal.fftconvolve(turned, vote_of, mode="valid")
        dy, dx = h - np.arange(vote.shape[0])[:, None], w - np.arange(vote.shape[1])[None, :]
        tax = 0.02 * (4 * (dy**2 + dx**2) / near**2 + (degrees / 10) ** 2)
        taxed = vote / max(float(mask.sum()) / 4, 1.0) - tax
        i, j = np.unravel_index(taxed.argmax(), vote.shape)
        if taxed[i, j] > best[0]:
            best = taxed[i, j], np.radians(degrees), 2.0 * np.array([w - j, h - i])
    return best[1], best[2]


class ShapeCells:
    """Patches of the template: what all frames agree on there is the person's shape, no error of a pose.

    Clothes and hair stand off the template; masks may be too large or small everywhere. Were the poses to answer for
    that, each frame would move its own way.
    """

    def __init__(self, subject: CaptureSubject, size: float):
        normals = vertex_normals(subject.vertices, subject.faces)
        place = np.c_[subject.vertices / size, normals / 0.7]
        _, self.cell = np.unique(np.round(place).astype(int), axis=0, return_inverse=True)
        self.cell = self.cell.ravel()
        count = np.bincount(self.cell)
        tree = KDTree(np.stack([np.bincount(self.cell, place[:, i]) / count for i in range(6)], 1))
        self.near = tree.sparse_distance_matrix(tree, REACH, output_type="coo_matrix").tocsr()
        self.near.data = np.exp(-0.5 * self.near.data**2)

    def shared(self, vertex: Int[Array, "n"], value: Float[Array, "n"], pseudocount: float) -> Float[Array, "vertices"]:
        """Of each vertex the mean of the values given around it, as if `pseudocount` more of them were zero."""
        of = self.cell[vertex]
        total, count = (np.bincount(of, w, minlength=self.near.shape[0]) for w in (value, np.ones(len(value))))
        return (self.near @ total / (self.near @ count + pseudocount))[self.cell]
