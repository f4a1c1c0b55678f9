"""The template's distance round the eyes, on a grid of its own: lids that are open and the eyeballs behind them.

`close_cavities` fills the sockets, as a grid of 3 mm must: a lid is 1 mm thick. Here, in a box round both eyes, the
cells are a third as large and the solid is the template joined with the eyeballs (capture/eyes.py); what the lids hide
(between them and the ball, behind it) is filled.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.spatial import KDTree

from capture.eyes import EyeSpheres, eye_covers, eye_spheres
from capture.folder import CaptureSubject
from geometry.mesh import face_normals
from geometry.sample import lattice_samples
from train.template_grid import FineGrid, TemplateGrid

Array = np.ndarray

# cells of the fine grid to one of the coarse: 1 mm at the head's 3 mm
FINER = 3
# metres off an eyeball up to which the fine distance counts alone, and from which on the coarse one does
OWN, OTHER = 0.004, 0.008
# metres: so far into the back of a lid what it hides is filled
OVERLAP = 0.001


def with_open_eyes(grid: TemplateGrid, subject: CaptureSubject) -> TemplateGrid:
    """The template's distance with the eyes open and filled with eyeballs; the grid itself where there are none."""
    spheres = eye_spheres(subject)
    if spheres is None:
        return grid
    low, shape = _box(grid, spheres)
    if min(shape) < 2:
        return grid
    cell = grid.cell / FINER
    axes = [low[i] + cell * np.arange(shape[i]) for i in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    with torch.no_grad():
        closed = grid(torch.as_tensor(points, dtype=torch.float32)).double().numpy()
    ball = spheres.distance(points)
    asked = (ball < OTHER) & (ball > -OWN)
    solid = np.where(asked, template_distance(subject, points, asked, shape, cell), ball)
    solid = np.minimum(np.minimum(solid, ball), hidden_distance(subject, spheres, points))
    solid = ndimage.gaussian_filter(solid.reshape(shape), 0.5).ravel()
    own = np.clip((OTHER - ball) / (OTHER - OWN), 0, 1)
    # on the box's own faces both agree, so that F_s has no step
    value = own * solid + (1 - own) * closed
    values = torch.tensor(value.reshape(shape), dtype=torch.float32)
    eyes = torch.tensor(np.concatenate([spheres.centres, spheres.radii[:, None]], 1), dtype=torch.float32)
    fine = FineGrid(values, torch.tensor(low, dtype=torch.float32), cell, eyes)
    return TemplateGrid(grid.values, grid.low, grid.cell, fine)


def _box(grid: TemplateGrid, spheres: EyeSpheres) -> tuple[Float[Array, "3"], tuple[int, ...]]:
    """Low corner and number of fine nodes of a box round both eyes; its faces are planes of coarse nodes."""
    reach = spheres.radii[:, None] + OTHER
    origin = grid.low.double().numpy()
    low = np.floor(((spheres.centres - reach).min(0) - origin) / grid.cell).astype(int)
    high = np.ceil(((spheres.centres + reach).max(0) - origin) / grid.cell).astype(int)
    last = np.array(grid.values.shape) - 1
    low, high = np.clip(low, 0, last), np.clip(high, 0, last)
    return origin + grid.cell * low, tuple(int(n) for n in FINER * (high - low) + 1)


def template_distance(
    subject: CaptureSubject, points: Float[Array, "n 3"], asked: Bool[Array, "n"], shape: tuple[int, ...], cell: float
) -> Float[Array, "n"]:
    """Signed distance to all faces of the template, sockets and all, at those nodes of a grid that are `asked`.

    Near a face it is that to the nearest sample's plane. Farther off, a connected region of nodes takes the sign that
    most of its nodes beside a face have: one bad normal turns no region. At most 2 OTHER; there where not asked.
    """
    far = 2 * OTHER
    rows = np.flatnonzero(asked)
    low, high = points[rows].min(0) - far, points[rows].max(0) + far
    corners = subject.vertices[subject.faces]
    faces = subject.faces[((corners.max(1) > low) & (corners.min(1) < high)).all(1)]
    face, barycentric = lattice_samples(subject.vertices, faces, np.full(len(faces), 0.5 * cell))
    samples = np.einsum("sk,skc->sc", barycentric, subject.vertices[faces[face]])
    normals = face_normals(subject.vertices, faces)[face]
    # deep in a ball hundreds of samples are equally far: none is looked for beyond OTHER
    length, nearest = KDTree(samples).query(points[rows], distance_upper_bound=OTHER)
    found = np.isfinite(length)
    length, nearest = np.where(found, length, far), np.where(found, nearest, 0)
    along = ((points[rows] - samples[nearest]) * normals[nearest]).sum(1)
    beside = length < 0.87 * cell
    free = np.zeros(len(points), bool)
    free[rows] = ~beside
    labels = np.empty(shape, np.int32)
    ndimage.label(free.reshape(shape), output=labels)
    region = labels.ravel()[rows]
    votes = np.bincount(region, np.sign(along) * (length < 2.5 * cell))
    out = np.full(len(points), far)
    out[rows] = np.where(beside, along, np.where(votes[region] < 0, -length, length))
    return out


def hidden_distance(subject: CaptureSubject, spheres: EyeSpheres, points: Float[Array, "n 3"]) -> Float[Array, "n"]:
    """How deep points lie behind the lids and in the sockets, as seen from the middle of the balls: negative there."""
    out = np.full(len(points), np.inf)
    for centre, radius, cover in zip(spheres.centres, spheres.radii, eye_covers(subject, spheres)):
        away = np.linalg.norm(points - centre, axis=1)
        rows = np.flatnonzero(away < radius + OTHER)
        _, nearest = KDTree(cover.directions).query((points[rows] - centre) / np.maximum(away[rows, None], 1e-9))
        behind = away[rows] - (cover.length[nearest] + OVERLAP)
        out[rows] = np.where(np.isfinite(behind) & (behind < 0), np.minimum(out[rows], behind), out[rows])
    return out
