"""Triangle meshes: normals, areas, and which vertices hang together."""

from typing import Any

import numpy as np
from jaxtyping import Float, Integer
from scipy import sparse
from scipy.sparse.csgraph import connected_components

Array = np.ndarray


def area_normals(vertices: Float[Array, "v 3"], faces: Integer[Array, "f 3"]) -> Float[Array, "f 3"]:
    """Normal of each face, outward for counter-clockwise corners; its length is twice the area."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def face_normals(vertices: Float[Array, "v 3"], faces: Integer[Array, "f 3"]) -> Float[Array, "f 3"]:
    """Unit normal of each face; zero where it has no area."""
    normals = area_normals(vertices, faces)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)


def face_areas(vertices: Float[Array, "v 3"], faces: Integer[Array, "f 3"]) -> Float[Array, "f"]:
    """Area of each face, in square units of the vertices."""
    return 0.5 * np.linalg.norm(area_normals(vertices, faces), axis=1)


def vertex_normals(vertices: Float[Array, "v 3"], faces: Integer[Array, "f 3"]) -> Float[Array, "v 3"]:
    """Unit normals, area weighted; a vertex without area gets (0, 1, 0)."""
    of_face = area_normals(vertices, faces)
    normals = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(normals, faces[:, i], of_face)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 1e-20, normals / np.maximum(length, 1e-20), [0.0, 1.0, 0.0])


def half_edges(faces: Integer[Array, "f 3"]) -> Integer[Array, "3*f 2"]:
    """Directed edges: the first of every face, then the second ones, then the third ones."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def neighbour_matrix(faces: Integer[Array, "f 3"], count: int) -> Any:
    """Sparse symmetric (count, count) matrix, 1 where two vertices share an edge."""
    edges = half_edges(faces)
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    matrix = sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count)).tocsr()
    matrix.data[:] = 1.0
    return matrix


def component_labels(faces: Integer[Array, "f 3"], count: int) -> Integer[Array, "v"]:
    """Connected component of every vertex, numbered from 0; one that no face names is a component of its own."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = sparse.coo_matrix((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1]
