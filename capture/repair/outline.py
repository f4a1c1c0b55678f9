"""Outlines of silhouettes: which pixel of one belongs to which of another, and what of their distance is shape."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage, signal
from scipy.spatial import KDTree

from capture.folder import CaptureSubject
from geometry.mesh import vertex_normals

Array = np.ndarray

# standard deviations, from where on patches of the surface know nothing of each other
REACH = 3.5


class Outline:
    """Outline pixels of an area with their outward normals."""

    def __init__(self, area: Bool[Array, "height width"]):
        edge = area & ~np.asarray(ndimage.binary_erosion(area, border_value=1), bool)
        smooth = ndimage.gaussian_filter(area.astype(np.float32), 1.5, mode="nearest")
        down, right = np.gradient(smooth)
        slope = np.stack([right, down], -1)
        self.pixels = np.argwhere(edge)
        self.at = self.pixels[:, ::-1] + 0.5  # x, y
        n = -slope[self.pixels[:, 0], self.pixels[:, 1]]
        self.normals = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-6)

    def nearest(self, other: "Outline", bend: float) -> tuple[Int[Array, "n"], Float[Array, "n"]]:
        """For each pixel of ours the nearest of `other` with a like normal, and how far it is in pixels."""
        # a k-d tree moves a split beside equal points to the next float; next to 0 that is a denormal, and where
        # those are flushed (train.trainer.flushed_denormals) the tree would grow for ever: keep away from 0
        far = 1e5
        tree = KDTree(np.c_[other.at, bend * other.normals] + far)
        index = np.asarray(tree.query(np.c_[self.at, bend * self.normals] + far)[1])
        return index, np.linalg.norm(other.at[index] - self.at, axis=1)


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
        back = np.array([[c, -s], [s, c]])  # of (row, column): output to input
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

    def shared(self, vertex: Int[Array, "n"], value: Float[Array, "n"], doubt: float) -> Float[Array, "vertices"]:
        """Of each vertex the mean of the values given around it, as if `doubt` more of them were zero."""
        of = self.cell[vertex]
        total, count = (np.bincount(of, w, minlength=self.near.shape[0]) for w in (value, np.ones(len(value))))
        return (self.near @ total / (self.near @ count + doubt))[self.cell]
