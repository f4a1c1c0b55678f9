"""The eyes of the displayed surface: lids that are open and the eyeballs behind them, as the template has them.

A field fills the recess between the lids, 3 to 5 mm in front of the eyeballs: color says little of depth there, and its
planes and sections are several times as wide as a lid is thick. So round the opening between the lids the distance that
is shown is the template's with its sockets open, joined with the eyeballs (capture/template/eyes.py):

    F(x) = (1 - share(x)) F_s(x) + share(x) E(x)

share is 1 within OWN of the opening and 0 from OTHER on. E lies on a grid with cells a third as large as the head's
template grid; what the lids hide (between them and the ball, behind it) is filled. Eyeballs are flat at the iris
(capture/register/iris.py).
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage
from scipy.spatial import KDTree
from torch import Tensor

from capture.folder import CaptureSubject, PartVideo
from capture.register.iris import FlatIris, IrisFit, fit_iris
from capture.template.eyes import EyeSpheres, eye_openings, eye_spheres, hidden_lengths
from geometry.isosurface import Detail
from geometry.mesh import face_normals
from geometry.sample import lattice_samples
from train.template_grid import TemplateGrid, interpolated, sampled

# cells of the fine grid to one of the coarse: 1 mm at the head's 3 mm
FINER = 3
# metres off the opening up to which E counts alone, and from which on F_s does
OWN, OTHER = 0.004, 0.012
# metres off an eyeball up to which E is the open template, and from which on it is the closed one
LIDS, SKIN = 0.006, 0.01
# metres: so far into the back of a lid what it hides is filled
OVERLAP = 0.001
# metres off the opening: cells and triangles of the surface are as small as E's here
DETAIL = 0.004


class OpenEyes(torch.nn.Module):
    """E and its share on one grid, canonical; values and gradients are of one interpolant."""

    values: Float[Tensor, "x y z"]  # E, metres
    share: Float[Tensor, "x y z"]  # 0 on the box's faces
    low: Float[Tensor, "3"]  # place of values[0, 0, 0]

    def __init__(
        self, values: Float[Tensor, "x y z"], share: Float[Tensor, "x y z"], low: Float[Tensor, "3"], cell: float
    ):
        super().__init__()
        self.register_buffer("values", values)
        self.register_buffer("share", share)
        self.register_buffer("low", low)
        self.cell = cell

    def inside(self, points: Float[Tensor, "n 3"]) -> Int[Tensor, "k"]:
        """Rows of the points in the grid's box; elsewhere nothing is changed."""
        size = self.cell * (torch.tensor(self.values.shape, device=points.device) - 1)
        return ((points > self.low) & (points < self.low + size)).all(1).nonzero()[:, 0]

    def distance(self, points: Float[Tensor, "n 3"], field: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
        """F at points where F_s is `field`."""
        rows = self.inside(points)
        if not len(rows):
            return field
        share, eyes = (interpolated(grid, self.low, self.cell, points[rows]) for grid in (self.share, self.values))
        return field.index_put((rows,), field[rows] + share * (eyes - field[rows]))

    def gradient(
        self, points: Float[Tensor, "n 3"], field: Float[Tensor, "n"], slope: Float[Tensor, "n 3"]
    ) -> tuple[Float[Tensor, "n"], Float[Tensor, "n 3"]]:
        """F and its gradient at points where F_s is `field` and its gradient `slope`; no graph."""
        rows = self.inside(points)
        if not len(rows):
            return field, slope
        with torch.no_grad():
            share, rise = sampled(self.share, self.low, self.cell, points[rows])
            eyes, own = sampled(self.values, self.low, self.cell, points[rows])
            apart = eyes - field[rows]
            turned = slope[rows] + share[:, None] * (own - slope[rows]) + apart[:, None] * rise
            return field.index_put((rows,), field[rows] + share * apart), slope.index_put((rows,), turned)

    def details(self) -> tuple[Detail, ...]:
        """Boxes round what lies within DETAIL of each opening, where the surface needs cells as small as these."""
        # the share falls by half per half of the way between OWN and OTHER, but is 1 up to OWN
        share = self.share.cpu().numpy()
        near = np.zeros(share.shape, np.int32)
        ndimage.label(share > _share(np.array([DETAIL]))[0] - 1e-3, output=near)
        low = self.low.double().cpu().numpy()
        boxes = np.array([[(one.start, one.stop - 1) for one in piece] for piece in ndimage.find_objects(near)], float)
        return tuple(Detail(low + self.cell * box[:, 0], low + self.cell * box[:, 1], self.cell) for box in boxes)


class FilmedEyes(NamedTuple):
    """Eyes as the head's video has them."""

    eyes: OpenEyes | None  # None: there are none to open
    # how flat their irises are; None: too little of them was filmed
    fit: IrisFit | None

    def in_words(self) -> str:
        """For the log."""
        if self.eyes is None:
            return "none in the template"
        deep = "" if self.fit is None or self.fit.iris is None else f", irises {1000 * self.fit.depth:.1f} mm deep"
        return f"open, as the template has them{deep}"


def filmed_eyes(
    subject: CaptureSubject, closed: TemplateGrid, video: PartVideo, canonical_from_head: Float[Array, "4 4"]
) -> FilmedEyes:
    """The eyes of a template with irises as flat as the head's video says; `closed` as for `open_eyes`."""
    fit = fit_iris(subject, video, canonical_from_head)
    return FilmedEyes(open_eyes(subject, closed, None if fit is None else fit.iris), fit)


def open_eyes(subject: CaptureSubject, closed: TemplateGrid, iris: FlatIris | None = None) -> OpenEyes | None:
    """The eyes of a template; `closed` is its distance with sockets filled. None where there are no eyes to open.

    The balls are cut by the `iris` where one is given.
    """
    spheres = eye_spheres(subject)
    opening = eye_openings(subject)
    if spheres is None or not len(opening):
        return None
    low, shape = _box(closed, spheres)
    if min(shape) < 2:
        return None
    cell = closed.cell / FINER
    axes = [low[i] + cell * np.arange(shape[i]) for i in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    with torch.no_grad():
        outer = closed(torch.as_tensor(points, dtype=torch.float32)).double().numpy()
    ball = spheres.distance(points) if iris is None else iris.distance(spheres, points)
    asked = (ball < SKIN) & (ball > -LIDS)
    solid = np.where(asked, template_distance(subject, points, asked, shape, cell), ball)
    solid = np.minimum(np.minimum(solid, ball), hidden_distance(subject, spheres, points))
    solid = ndimage.gaussian_filter(solid.reshape(shape), 0.5).ravel()
    lids = np.clip((SKIN - ball) / (SKIN - LIDS), 0, 1)
    values = lids * solid + (1 - lids) * outer
    share = _share(KDTree(opening).query(points, distance_upper_bound=OTHER)[0]).reshape(shape)
    for axis in range(3):
        # else the field would have a step at the faces
        np.moveaxis(share, axis, 0)[[0, -1]] = 0
    tensor = lambda array: torch.tensor(array, dtype=torch.float32)
    return OpenEyes(tensor(values.reshape(shape)), tensor(share), tensor(low), cell)


def _share(off: Float[Array, "*any"]) -> Float[Array, "*any"]:
    """E's share so far off the opening."""
    s = np.clip((OTHER - off) / (OTHER - OWN), 0, 1)
    return s * s * (3 - 2 * s)


def _box(grid: TemplateGrid, spheres: EyeSpheres) -> tuple[Float[Array, "3"], tuple[int, ...]]:
    """Low corner and number of fine nodes of a box round both eyes; its faces are planes of coarse nodes."""
    reach = spheres.radii[:, None] + SKIN
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
    most of its nodes beside a face have: one bad normal turns no region. At most 2 SKIN; there where not asked.
    """
    far = 2 * SKIN
    rows = np.flatnonzero(asked)
    low, high = points[rows].min(0) - far, points[rows].max(0) + far
    corners = subject.vertices[subject.faces]
    faces = subject.faces[((corners.max(1) > low) & (corners.min(1) < high)).all(1)]
    found = lattice_samples(subject.vertices, faces, np.full(len(faces), 0.5 * cell))
    samples, normals = found.on(subject.vertices, faces), face_normals(subject.vertices, faces)[found.face]
    # deep in a ball hundreds of samples are equally far: none is looked for beyond SKIN
    length, nearest = KDTree(samples).query(points[rows], distance_upper_bound=SKIN)
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
    """How deep points lie behind the lids and in the sockets, seen from the front: negative there, else inf."""
    out = np.full(len(points), np.inf)
    for centre, radius, hidden in zip(spheres.centres, spheres.radii, hidden_lengths(subject, spheres)):
        near = np.flatnonzero(np.linalg.norm(points - centre, axis=1) < radius + SKIN)
        offset = points[near] - hidden.origin
        away = np.linalg.norm(offset, axis=1)
        apart, nearest = KDTree(hidden.directions).query(offset / away[:, None])
        behind = away - (hidden.length[nearest] + OVERLAP)
        held = (apart < hidden.spacing) & np.isfinite(behind) & (behind < 0)
        out[near] = np.where(held, np.minimum(out[near], behind), out[near])
    return out
