"""The canonical template as a cloud of surface samples.

Only faces that can be reached from outside count. The inside of the mouth and the eye sockets would flip the
sign of the distance a few millimetres under the skin.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage
from scipy.spatial import KDTree

from avatar.skinning import SkinWeights, dense_weights, strongest_four
from capture.folder import CaptureSubject
from geometry.cells import connected_to, nearest_marked
from geometry.mesh import face_areas, face_normals, face_values, vertex_normals
from geometry.sample import lattice_samples


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
    area: Float[Array, "samples"]  # square metres that each stands for

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


def visible_faces(subject: CaptureSubject, cell: float = 0.003) -> Bool[Array, "faces"]:
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


def neck_height(subject: CaptureSubject) -> float:
    """The lowest skin of the head part."""
    return float(subject.vertices[(subject.part == 1) & ~subject.hair][:, 1].min())


def air_reaches(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], cell: float, cut: float, above: bool
) -> Bool[Array, "faces"]:
    """Faces with air in front of them; the open side of the piece, at height `cut`, is closed.

    Air is the flood fill of a voxel grid from its border with the surface two cells thick, which closes lips and
    eyelids; it then creeps back three cells through free cells, never through a wall.
    """
    normals = face_normals(vertices, faces)
    occupied, low = occupied_cells(vertices, faces, cell)
    shape = occupied.shape
    height = low[1] + (np.arange(shape[1]) + 0.5) * cell
    closed = height < cut if above else height > cut
    occupied[:, closed] = True
    outside = air_beyond(occupied, (0, -1 if above else 0, 0))
    air = np.asarray(ndimage.binary_dilation(outside, iterations=3, mask=~occupied), bool)
    reached = np.zeros(len(faces), bool)
    middle = vertices[faces].mean(1)
    for step in (1.0, 1.75, 2.5):
        at = ((middle + step * cell * normals - low) / cell).astype(int)
        reached |= air[tuple(np.clip(at, 0, np.array(shape) - 1).T)]
    beyond = middle[:, 1] < cut + 4 * cell if above else middle[:, 1] > cut - 4 * cell
    return reached | beyond


def occupied_cells(
    vertices: Float[Array, "vertices 3"], faces: Int[Array, "faces 3"], cell: float
) -> tuple[Bool[Array, "x y z"], Float[Array, "3"]]:
    """Cells that a surface lies in, with six free ones round it, and the corner of the first, metres."""
    points = lattice_samples(vertices, faces, np.full(len(faces), 0.5 * cell)).on(vertices, faces)
    low = points.min(0) - 6 * cell
    index = ((points - low) / cell).astype(int)
    occupied = np.zeros(tuple(index.max(0) + 7), bool)
    occupied[tuple(index.T)] = True
    return occupied, low


def air_beyond(occupied: Bool[Array, "x y z"], start: tuple[int, int, int]) -> Bool[Array, "x y z"]:
    """What the air at the cell `start` reaches when walls are two cells thicker on both sides."""
    return connected_to(~np.asarray(ndimage.binary_dilation(occupied, iterations=2), bool), start)


def surface_cloud(
    subject: CaptureSubject, fine_part: int, visible: Bool[Array, "faces"], fine: float, coarse: float = 0.02
) -> SurfaceCloud:
    """Samples of the visible template: `fine` spacing on one part, `coarse` elsewhere (metres)."""
    faces = subject.faces[visible]
    part = face_values(subject.part, faces)
    gap = np.where(part == fine_part, fine, max(fine, coarse))
    samples = lattice_samples(subject.vertices, faces, gap)
    face = samples.face
    normals = samples.on(vertex_normals(subject.vertices, subject.faces), faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    points = samples.on(subject.vertices, faces)
    skin = blend_skin(subject.skin, faces[face], samples.barycentric)
    area = (face_areas(subject.vertices, faces) / np.maximum(np.bincount(face, minlength=len(faces)), 1))[face]
    return SurfaceCloud(points, normals, skin, part[face], KDTree(points), fine, gap[face], area)


def blend_skin(skin: SkinWeights, corners: Int[Array, "s 3"], barycentric: Float[Array, "s 3"]) -> SkinWeights:
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
    points: Float[Array, "samples 3"], low: Float[Array, "3"], high: Float[Array, "3"], cell: float
) -> SampleGrid:
    """Nearest samples on a grid over a box, by the feature transform of the occupied cells."""
    shape = tuple(np.ceil((high - low) / cell).astype(int) + 1)
    rows = np.full(shape, -1)
    index = np.floor((points - low) / cell).astype(int)
    inside = np.flatnonzero(((index >= 0) & (index < shape)).all(1))
    rows[tuple(index[inside].T)] = inside
    return SampleGrid(rows[nearest_marked(rows >= 0)].astype(np.int32), low, cell)
