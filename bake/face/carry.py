"""Shapes carried from a registered template to a baked level: each vertex moves as the template's skin under it."""

import numpy as np
from jaxtyping import Float32, Integer
from numpy import ndarray as Array
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from avatar.baked_avatar import Level
from avatar.face import SHAPES
from avatar.face_template import BODY
from bake.face.lips import LIPS, LipLine
from bake.face.template import PersonFace
from geometry.closest import match_surface
from geometry.mesh import blended, half_edges

# metres off the template up to which a vertex moves with it, and from which on it stays: hair, a collar
WITH, WITHOUT = 0.006, 0.016


def carried(
    level: Level, person: PersonFace, line: LipLine, lip: Integer[Array, "vertices"], flat: bool = False
) -> Float32[Array, "52 vertices 3"]:
    """What each shape moves the vertices of a level by; `lip` says of which lip each is (lips.py).

    `flat`: the template's lids are not of this surface; what lies behind what then counts little.
    """
    squash = np.array([1, 1, 0.2]) if flat else np.ones(3)
    points, normals = level.positions.astype(np.float64), level.normals.astype(np.float64)
    offsets = np.zeros((len(SHAPES), len(points), 3), np.float32)
    low, high = (f(person.vertices[person.skin].reshape(-1, 3), axis=0) for f in (np.min, np.max))
    rows = np.flatnonzero(((points > low - WITHOUT) & (points < high + WITHOUT)).all(1))
    faces = lips_of_faces(person, line)
    every = person.face.offsets[:, :BODY].transpose(1, 0, 2).reshape(BODY, -1)
    for side in (-1, 0, 1):
        own, skin = rows[lip[rows] == side], person.skin[(faces != -side) | (side == 0)]
        match = match_surface(squash * points[own], normals[own], squash * person.vertices, skin)
        share = np.clip((WITHOUT - match.distance) / (WITHOUT - WITH), 0, 1)
        share = share * share * (3 - 2 * share)
        moved = blended(every, skin[match.face], match.barycentric)
        offsets[:, own] = (share[:, None] * moved).reshape(len(own), len(SHAPES), 3).transpose(1, 0, 2)
    return offsets


def lips_of_faces(person: PersonFace, line: LipLine) -> Integer[Array, "skin"]:
    """1 for the template's faces of the upper lip, -1 for those of the lower one, 0 elsewhere.

    It is the lip whose edge is nearer along the template's own edges, for lips touch and overlap.
    """
    upper, lower = (half[1:-1] for half in person.face.seam)
    edge = half_edges(person.skin)
    length = np.linalg.norm(person.vertices[edge[:, 0]] - person.vertices[edge[:, 1]], axis=1)
    graph = coo_matrix((length, edge.T), shape=(BODY, BODY)).tocsr()
    sources = dijkstra(graph, False, np.r_[upper, lower], min_only=True, return_predecessors=True)[2]
    lip = np.where(np.isin(sources, upper), 1, -1)
    lip[(line.away(person.vertices) > LIPS) | np.isin(np.arange(BODY), person.face.seam[0][[0, -1]])] = 0
    lip = lip[person.skin]
    return np.where((lip == 0).any(1), 0, np.sign(lip.sum(1)))
