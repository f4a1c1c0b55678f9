"""Triangle meshes: the record, normals, areas, and which vertices hang together."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer
from numpy import ndarray as Array
from scipy import sparse
from scipy.sparse.csgraph import connected_components


class TriangleMesh(NamedTuple):
    """Triangles, counter-clockwise from outside."""

    vertices: Float[Array, "vertices 3"]  # metres
    faces: Integer[Array, "faces 3"]


def check_mesh(vertices: Array, faces: Array, name: str) -> None:
    """Refuse a mesh without faces, with indices beyond its vertices, or with vertices that are not finite."""
    if len(faces) == 0:
        raise ValueError(f"{name}: a mesh with no faces has no surface to measure")
    low, high = int(faces.min()), int(faces.max())
    if low < 0 or high >= len(vertices):
        raise ValueError(f"{name}: faces name vertices {low}..{high}, the mesh has {len(vertices)}")
    if not np.isfinite(vertices).all():
        raise ValueError(f"{name}: vertices are not finite")


def area_normals(vertices: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"]) -> Float[Array, "faces 3"]:
    """Normal of each face, outward for counter-clockwise corners; its length is twice the area."""
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    return np.cross(b - a, c - a)


def face_normals(vertices: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"]) -> Float[Array, "faces 3"]:
    """Unit normal of each face; zero where it has no area."""
    normals = area_normals(vertices, faces)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)


def face_values(values: Integer[Array, "vertices"], faces: Integer[Array, "faces 3"]) -> Integer[Array, "faces"]:
    """The value that most corners of each face have; of three the middle one."""
    return np.sort(values[faces], 1)[:, 1]


def face_areas(vertices: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"]) -> Float[Array, "faces"]:
    """Area of each face, in the square of the unit of the vertices."""
    return 0.5 * np.linalg.norm(area_normals(vertices, faces), axis=1)


def vertex_areas(vertices: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"]) -> Float[Array, "vertices"]:
    """A third of the area of the faces round each vertex."""
    return np.bincount(faces.ravel(), np.repeat(face_areas(vertices, faces) / 3, 3), minlength=len(vertices))


def vertex_normals(
    vertices: Float[Array, "vertices 3"],
    faces: Integer[Array, "faces 3"],
    welded: Integer[Array, "vertices"] | None = None,
) -> Float[Array, "vertices 3"]:
    """Unit normals, area weighted and summed over `welded` vertices; a vertex without area gets (0, 1, 0)."""
    index = faces if welded is None else welded[faces]
    of_corner = np.repeat(area_normals(vertices, faces), 3, axis=0)
    normals = np.stack([np.bincount(index.ravel(), of_corner[:, c], len(vertices)) for c in range(3)], 1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 1e-20, normals / np.maximum(length, 1e-20), [0.0, 1.0, 0.0])
    return normals if welded is None else normals[welded]


def blended(
    values: Float[Array, "vertices channels"], corners: Integer[Array, "*n 3"], weight: Float[Array, "*n 3"]
) -> Float[Array, "*n channels"]:
    """Barycentric interpolation. Term by term: a sum over an axis of three takes several times as long."""
    result = weight[..., 0, None] * values[corners[..., 0]]
    for i in (1, 2):
        result += weight[..., i, None] * values[corners[..., i]]
    return result


def weld(vertices: Float[Array, "vertices 3"]) -> Integer[Array, "vertices"]:
    """For every vertex the first vertex at its place: texture seams repeat vertices that are one point.

    Places are compared to a hundredth of a millimetre.
    """
    places = np.round(vertices * 1e5).astype(np.int64)
    _, first, inverse = np.unique(places, axis=0, return_index=True, return_inverse=True)
    return first[inverse.reshape(-1)]


def half_edges(faces: Integer[Array, "faces 3"]) -> Integer[Array, "3*faces 2"]:
    """Directed edges: the first of every face, then the second ones, then the third ones."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def neighbour_matrix(faces: Integer[Array, "faces 3"], count: int) -> sparse.csr_matrix:
    """Sparse symmetric (count, count) matrix, 1 where two vertices share an edge."""
    edges = half_edges(faces)
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    matrix = sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count)).tocsr()
    matrix.data[:] = 1.0
    return sparse.csr_matrix(matrix)


def connected(pairs: Integer[Array, "pairs 2"], count: int) -> Integer[Array, "count"]:
    """Which of `count` things hang together by pairs of them: the number of each one's group, from 0."""
    graph = sparse.coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def component_labels(faces: Integer[Array, "faces 3"], count: int) -> Integer[Array, "vertices"]:
    """Connected component of every vertex, numbered from 0; one that no face names is a component of its own."""
    return connected(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]]), count)


def compact(
    vertices: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"]
) -> tuple[TriangleMesh, Integer[Array, "kept"]]:
    """The mesh without unreferenced vertices, and the old index of each that stays."""
    kept, renumbered = np.unique(faces, return_inverse=True)
    return TriangleMesh(vertices[kept], renumbered.reshape(-1, 3)), kept


def restricted(mesh: TriangleMesh, own: Bool[Array, "vertices"]) -> TriangleMesh:
    """The pieces of a mesh that these vertices make up."""
    index = np.cumsum(own) - 1
    return TriangleMesh(mesh.vertices[own], index[mesh.faces[own[mesh.faces[:, 0]]]])


def largest_component(mesh: TriangleMesh) -> tuple[TriangleMesh, int, float]:
    """The component of greatest area, how many others were dropped, and their share of the area."""
    labels, areas = _pieces(mesh)
    kept, _ = compact(mesh.vertices, mesh.faces[labels == areas.argmax()])
    return kept, max(int((areas > 0).sum()) - 1, 0), float(1 - areas.max() / areas.sum())


def separate_pieces(mesh: TriangleMesh, least: float) -> list[TriangleMesh]:
    """The connected pieces of at least so much area, the largest first."""
    labels, areas = _pieces(mesh)
    order = np.argsort(-areas, kind="stable")
    kept = order[areas[order] >= max(least, 1e-12)]
    return [compact(mesh.vertices, mesh.faces[labels == label])[0] for label in kept]


def _pieces(mesh: TriangleMesh) -> tuple[Integer[Array, "faces"], Float[Array, "pieces"]]:
    labels = component_labels(mesh.faces, len(mesh.vertices))[mesh.faces[:, 0]]
    return labels, np.bincount(labels, face_areas(mesh.vertices, mesh.faces))


def concatenated(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts)])
    return TriangleMesh(np.concatenate([mesh.vertices for mesh in meshes]), faces)


def enclosed_volume(mesh: TriangleMesh) -> float:
    """Signed volume of a closed mesh, cubic metres; positive when its triangles face outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float((np.cross(a, b) * c).sum() / 6)
