"""The canonical template as a cloud of surface samples and as a signed distance grid: where a part field starts.

Only faces that can be reached from outside count. The inside of the mouth and the eye sockets would flip the
sign of the distance a few millimetres under the skin.
"""

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.spatial import KDTree
from torch import Tensor

from avatar.skinning import SkinWeights, dense_weights, strongest_four
from train.capture import Subject
from train.cells import connected_to, distance_to, nearest_marked
from train.mesh import face_normals, vertex_normals

Array = np.ndarray


@dataclass(frozen=True)
class SurfaceCloud:
    """Dense samples of the visible template, canonical frame; a nearest sample stands for the closest triangle."""

    points: Float[Array, "samples 3"]
    normals: Float[Array, "samples 3"]  # unit, outward
    skin: SkinWeights
    part: Int[Array, "samples"]
    tree: KDTree
    spacing: float  # metres, of the finest part
    gap: Float[Array, "samples"]  # metres, of each sample's own face

    def distance(self, points: Float[Array, "n 3"]) -> tuple[Float[Array, "n"], Int[Array, "n"]]:
        """Signed distance to the samples, and the nearest sample. Right near the surface, see `signed`."""
        length, row = self.tree.query(points)
        return signed(points, length, self.points[row], self.normals[row], self.gap[row]), row


def signed(points: Array, length: Array, nearest: Array, normals: Array, spacing: Array) -> Array:
    """Distance with sign from the nearest sample: to its tangent plane when close, to the sample itself when far.

    Close to the surface the plane removes the scalloping of the samples; farther than 1.5 spacings the sample's
    own distance is right to a tenth of a spacing.
    """
    along = ((points - nearest) * normals).sum(-1)
    return np.where(length < 1.5 * spacing, along, np.where(along < 0, -length, length))


def sample_faces(
    vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], spacing: Float[Array, "f"]
) -> tuple[Int[Array, "s"], Float[Array, "s 3"]]:
    """Face and barycentric coordinates of samples about `spacing` apart.

    Each face is cut into n^2 equal triangles, n = longest edge / spacing rounded, and sampled at their centres.
    """
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    counts = np.clip(np.round(longest / spacing), 1, 64).astype(int)
    rows, weights = [], []
    for n in np.unique(counts):
        chosen = np.flatnonzero(counts == n)
        i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
        up = (i + j) < n
        down = (i + j) < n - 1
        a = np.concatenate([(i[up] + 1 / 3) / n, (i[down] + 2 / 3) / n])
        b = np.concatenate([(j[up] + 1 / 3) / n, (j[down] + 2 / 3) / n])
        barycentric = np.stack([1 - a - b, a, b], 1)
        rows.append(np.repeat(chosen, len(barycentric)))
        weights.append(np.tile(barycentric, (len(chosen), 1)))
    return np.concatenate(rows), np.concatenate(weights)


def visible_faces(subject: Subject, cell: float = 0.003) -> Bool[Array, "f"]:
    """Faces of the template that the outside air reaches.

    Only head and feet are tried: the inside of mouth and eye sockets, and toes folded together in a shoe, are
    where a body template has hidden surface. Hands are never touched, their gaps are narrower than a cell.
    """
    vertices, faces = subject.vertices, subject.faces
    visible = np.ones(len(faces), bool)
    neck = neck_height(subject)
    ankles = float(vertices[:, 1].min()) + 0.12
    for chosen, cut, above in (
        ((subject.part[faces] == 1).any(1), neck, True),
        ((vertices[faces, 1] < ankles).any(1), ankles, False),
    ):
        visible[chosen] = air_reaches(vertices, faces[chosen], cell, cut, above)
    return visible


def neck_height(subject: Subject) -> float:
    """The lowest skin of the head part."""
    return float(subject.vertices[(subject.part == 1) & ~subject.hair][:, 1].min())


def air_reaches(
    vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], cell: float, cut: float, above: bool
) -> Bool[Array, "f"]:
    """Faces with air in front of them; the open side of the piece, at height `cut`, is closed.

    Air is the flood fill of a voxel grid from its border with the surface two cells thick, which closes lips and
    eyelids; it then creeps back three cells through free cells, never through a wall.
    """
    normals = face_normals(vertices, faces)
    face, barycentric = sample_faces(vertices, faces, np.full(len(faces), 0.5 * cell))
    points = np.einsum("sk,skc->sc", barycentric, vertices[faces[face]])
    low = points.min(0) - 6 * cell
    index = ((points - low) / cell).astype(int)
    shape = tuple(index.max(0) + 7)
    occupied = np.zeros(shape, bool)
    occupied[tuple(index.T)] = True
    height = low[1] + (np.arange(shape[1]) + 0.5) * cell
    closed = height < cut if above else height > cut
    occupied[:, closed] = True
    outside = _air_beyond(occupied, (0, -1 if above else 0, 0))
    air = np.asarray(ndimage.binary_dilation(outside, iterations=3, mask=~occupied), bool)
    reached = np.zeros(len(faces), bool)
    middle = vertices[faces].mean(1)
    for step in (1.0, 1.75, 2.5):
        at = ((middle + step * cell * normals - low) / cell).astype(int)
        reached |= air[tuple(np.clip(at, 0, np.array(shape) - 1).T)]
    beyond = middle[:, 1] < cut + 4 * cell if above else middle[:, 1] > cut - 4 * cell
    return reached | beyond


def _air_beyond(occupied: Bool[Array, "x y z"], start: tuple[int, int, int]) -> Bool[Array, "x y z"]:
    """What the air at the cell `start` reaches when walls are two cells thicker on both sides."""
    return connected_to(~np.asarray(ndimage.binary_dilation(occupied, iterations=2), bool), start)


def surface_cloud(
    subject: Subject, fine_part: int, visible: Bool[Array, "f"], fine: float, coarse: float = 0.02
) -> SurfaceCloud:
    """Samples of the visible template: `fine` spacing on one part, `coarse` elsewhere (metres)."""
    faces = subject.faces[visible]
    part = np.sort(subject.part[faces], 1)[:, 1]  # the majority of the three
    gap = np.where(part == fine_part, fine, max(fine, coarse))
    face, barycentric = sample_faces(subject.vertices, faces, gap)
    corners = faces[face]
    blend = lambda values: np.einsum("sk,skc->sc", barycentric, values[corners])
    normals = blend(vertex_normals(subject.vertices, subject.faces))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    points = blend(subject.vertices)
    skin = blend_skin(subject.skin, corners, barycentric)
    return SurfaceCloud(points, normals, skin, part[face], KDTree(points), fine, gap[face])


def blend_skin(
    skin: SkinWeights, corners: Int[Array, "s 3"], barycentric: Float[Array, "s 3"]
) -> SkinWeights:
    """Skin weights inside triangles: the barycentric blend of the corners, its four strongest bones."""
    dense = dense_weights(skin).astype(np.float32)
    out_joints, out_weights = [], []
    for start in range(0, len(corners), 65536):
        stop = start + 65536
        a, b, c = (barycentric[start:stop, k, None] * dense[corners[start:stop, k]] for k in range(3))
        joints, weights = strongest_four(a + b + c)
        out_joints.append(joints)
        out_weights.append(weights)
    return SkinWeights(np.concatenate(out_joints), np.concatenate(out_weights))


class TemplateGrid(torch.nn.Module):
    """Trilinear signed distance of the template in a box; outside it, the distance at the border plus the way there.

    Value and gradient come from the same interpolant. The gradient is a constant of the training.
    """

    values: Float[Tensor, "x y z"]  # signed distance, metres
    low: Float[Tensor, "3"]  # place of values[0, 0, 0], canonical

    def __init__(self, values: Float[Tensor, "x y z"], low: Float[Tensor, "3"], cell: float):
        super().__init__()
        self.register_buffer("values", values)
        self.register_buffer("low", low)
        self.cell = cell

    def sample(self, points: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, "n"], Float[Tensor, "n 3"]]:
        """Distance and its gradient; no graph."""
        with torch.no_grad():
            shape = torch.tensor(self.values.shape, device=points.device)
            at = (points - self.low) / self.cell
            inside = torch.minimum(at.clamp_min(0), (shape - 1 - 1e-4).to(at.dtype))
            beyond = (at - inside) * self.cell
            corner = inside.floor().long()
            f = inside - corner
            strides = torch.tensor([self.values.shape[1] * self.values.shape[2], self.values.shape[2], 1])
            strides = strides.to(points.device)
            base = (corner * strides).sum(-1)
            flat = self.values.reshape(-1)
            v = [flat[base + (strides * torch.tensor(o, device=base.device)).sum()] for o in _CORNERS]
            fx, fy, fz = f.unbind(-1)
            # interpolate along z, then y, then x, keeping the differences for the gradient
            z00, z01, z10, z11 = (v[2 * i] + fz * (v[2 * i + 1] - v[2 * i]) for i in range(4))
            d00, d01, d10, d11 = (v[2 * i + 1] - v[2 * i] for i in range(4))
            y0, y1 = z00 + fy * (z01 - z00), z10 + fy * (z11 - z10)
            gx = y1 - y0
            gy = (z01 - z00) + fx * ((z11 - z10) - (z01 - z00))
            dz0, dz1 = d00 + fy * (d01 - d00), d10 + fy * (d11 - d10)
            gz = dz0 + fx * (dz1 - dz0)
            gradient = torch.stack([gx, gy, gz], -1) / self.cell
            away = beyond.norm(dim=-1)
            out = away > 0
            gradient = torch.where(out[:, None], beyond / away.clamp_min(1e-12)[:, None], gradient)
            return y0 + fx * gx + away, gradient

    def forward(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n"]:
        """The value alone, differentiable once: torch's own interpolation, eight times as fast as `sample`."""
        shape = torch.tensor(self.values.shape, dtype=points.dtype, device=points.device)
        unit = (points - self.low) / self.cell / (shape - 1) * 2 - 1
        inside = unit.clamp(-1, 1)
        beyond = (unit - inside) * (shape - 1) * (0.5 * self.cell)
        at = inside.flip(-1)[None, :, None, None]  # grid_sample counts its last axis first
        sampled = F.grid_sample(self.values[None, None], at, align_corners=True)[0, 0, :, 0, 0]
        # the square root's slope at zero is infinite; a hundredth of a millimetre hides it
        return sampled + (beyond.square().sum(-1) + 1e-10).sqrt() - 1e-5


_CORNERS = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]


@dataclass(frozen=True)
class SampleGrid:
    """The nearest sample of the cloud at every cell of a box: a look-up instead of a tree search.

    Right to about a cell, over which skin weights hardly change. Points outside the box get -1.
    """

    rows: Int[Array, "x y z"]
    low: Float[Array, "3"]
    cell: float

    def nearest(self, points: Float[Array, "n 3"]) -> Int[Array, "n"]:
        """Row of the nearest sample; -1 outside the box."""
        index = np.floor((points - self.low) / self.cell).astype(np.int64)
        inside = ((index >= 0) & (index < self.rows.shape)).all(1)
        index[~inside] = 0
        return np.where(inside, self.rows[tuple(index.T)], -1)


def sample_grid(
    cloud: SurfaceCloud, low: Float[Array, "3"], high: Float[Array, "3"], cell: float
) -> SampleGrid:
    """Nearest samples on a grid over a box, by the feature transform of the occupied cells."""
    shape = tuple(np.ceil((high - low) / cell).astype(int) + 1)
    rows = np.full(shape, -1)
    index = np.floor((cloud.points - low) / cell).astype(int)
    inside = np.flatnonzero(((index >= 0) & (index < shape)).all(1))
    rows[tuple(index[inside].T)] = inside
    return SampleGrid(rows[nearest_marked(rows >= 0)].astype(np.int32), low, cell)


def template_grid(
    cloud: SurfaceCloud,
    low: Float[Array, "3"],
    high: Float[Array, "3"],
    cell: float,
    closed: tuple[Subject, float] | None = None,
) -> TemplateGrid:
    """Signed distance of the cloud on a grid over a box; `closed` fills the cavities of the head.

    Deeper than three cells the sign comes from a flood fill, so that one bad normal cannot open a hole there.
    """
    axes = [np.arange(low[i], high[i] + cell, cell) for i in range(3)]
    shape = tuple(len(axis) for axis in axes)
    # exact within four cells of a sample; farther out the distance between cells is near enough
    occupied = np.zeros(shape, bool)
    index = np.round((cloud.points - low) / cell).astype(int)
    index = index[((index >= 0) & (index < shape)).all(1)]
    occupied[tuple(index.T)] = True
    distance = distance_to(occupied) * cell
    near = np.argwhere(distance < 4 * cell)
    exact, _ = cloud.distance(np.stack([axes[i][near[:, i]] for i in range(3)], 1))
    # air is what the border reaches through cells clearly off the surface and not known to lie under it
    blocked = np.zeros(shape, bool)
    blocked[tuple(near.T)] = exact < 0.87 * cell
    air = connected_to(np.pad(~blocked, 1, constant_values=True), (0, 0, 0))[1:-1, 1:-1, 1:-1]
    distance = np.where(air, distance, -distance)
    deep = np.abs(exact) > 3 * cell
    exact = np.where(deep & ~air[tuple(near.T)], -np.abs(exact), exact)
    distance[tuple(near.T)] = exact
    if closed is not None:
        distance = close_cavities(distance, axes, cell, closed)
    return TemplateGrid(
        torch.tensor(distance, dtype=torch.float32), torch.tensor(low, dtype=torch.float32), cell
    )


def close_cavities(
    distance: Float[Array, "x y z"], axes: list[Array], cell: float, closed: tuple[Subject, float]
) -> Float[Array, "x y z"]:
    """The head's distance with nostrils, ears, eye sockets and mouth filled: a field learns outwards from a plain
    shape more easily than it repairs folds that a grid cannot hold.

    Where the distance disagrees by more than 1.5 cells with that of the closed volume (flood fill round the
    surface two cells thick), the closed volume is right. `closed` names the subject and the height of the neck,
    under which nothing is changed.
    """
    subject, neck = closed
    faces = subject.faces[(subject.vertices[subject.faces, 1] > neck - 0.05).any(1)]
    face, barycentric = sample_faces(subject.vertices, faces, np.full(len(faces), 0.5 * cell))
    points = np.einsum("sk,skc->sc", barycentric, subject.vertices[faces[face]])
    low = np.array([axis[0] for axis in axes])
    index = np.round((points - low) / cell).astype(int)
    index = index[((index >= 0) & (index < distance.shape)).all(1)]
    occupied = np.zeros(distance.shape, bool)
    occupied[tuple(index.T)] = True
    occupied[:, axes[1] < neck] = True
    outside = _air_beyond(occupied, (0, -1, 0))
    air = np.asarray(ndimage.binary_dilation(outside, iterations=2), bool)
    volume = distance_to(~air) - distance_to(air)
    volume = ndimage.gaussian_filter(volume * cell, 1.0)
    above = np.broadcast_to((axes[1] > neck + 3 * cell)[None, :, None], distance.shape)
    surface = above & (np.abs(distance) < 2 * cell)
    # the flood stops at the outer side of the surface cells
    volume += np.median((distance - volume)[surface])
    wrong = above & (np.abs(distance - volume) > 1.5 * cell)
    return ndimage.gaussian_filter(np.where(wrong, volume, distance), 0.6)
