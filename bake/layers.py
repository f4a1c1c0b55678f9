"""Surfaces of a person that are extracted, collapsed and given weights apart: the body and hanging hair.

A person without hanging hair has one layer, which is the field as it is.
"""

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer
from numpy import ndarray as Array

from avatar.skeleton import PARTS
from bake.cone import ViewCone
from bake.field import NumpyField
from bake.level import LayeredMesh, SourceSurface, TransferredData, transferred_data
from capture.folder import CaptureSubject
from capture.template.layers import BODY, HAIR, LEAST_HAIR, carved_faces, hair_layers, without_hair
from capture.template.solid import solid_inside, template_behind_cloth
from capture.template.surface import visible_faces
from geometry.decimate import Enlargement, Magnifier, balanced, decimate, enlarged
from geometry.isosurface import Detail, Extraction, GridSteps, Hints, PointFunction, extract
from geometry.mesh import TriangleMesh, compact, component_labels, concatenated, face_areas, restricted, vertex_normals


class SurfaceLayer(NamedTuple):
    """One layer of a person as functions of canonical points."""

    # made solid deep inside (capture/template/solid.py): for extraction
    solid: PointFunction
    distance: PointFunction
    normal: PointFunction


def layers_of(field: NumpyField, subject: CaptureSubject, origin: SourceSurface) -> list[SurfaceLayer]:
    """The layers of a run's surface, the body first."""
    distance = template_behind_cloth(field.distance, subject)
    whole = solid_inside(distance, subject)
    divided = hair_layers(subject, whole) if origin.layer.any() else None
    if divided is None:
        return [SurfaceLayer(whole, distance, field.normal)]
    normal = lambda k: divided.normal(k, distance, field.normal)
    return [SurfaceLayer(divided.distance(k, whole), divided.distance(k, distance), normal(k)) for k in (BODY, HAIR)]


def layer_hints(origin: SourceSurface, subject: CaptureSubject, given_up: Collection[str], count: int) -> list[Hints]:
    """Where the surface of each of `count` layers is looked for: on the run's, and in parts that were given up on the
    outside of the template, which what they learned may lie deep inside of."""
    moved, body = [PARTS.index(part) for part in given_up], PARTS.index("body")
    outside = outer_faces(subject, count) if moved else [np.zeros((0, 3), np.int64)] * count
    facing, out = vertex_normals(origin.vertices, origin.faces), []
    for k, faces in enumerate(outside):
        own = (origin.layer == k) & ~np.isin(origin.part, moved)
        back = np.unique(faces)
        back = back[np.isin(subject.part[back], moved)]
        part = np.concatenate([origin.part[own], subject.part[back]])
        normals = np.concatenate([facing[own], vertex_normals(subject.vertices, faces)[back]])
        out.append(Hints(np.concatenate([origin.vertices[own], subject.vertices[back]]), part != body, normals))
    return out


def outer_faces(subject: CaptureSubject, count: int) -> list[Integer[Array, "faces 3"]]:
    """The faces of the template that each of `count` layers shows."""
    if count == 1:
        return [subject.faces[visible_faces(subject)]]
    skin = without_hair(subject)
    return [skin.faces[visible_faces(skin)], subject.faces[carved_faces(subject)]]


def extract_layers(
    layers: list[SurfaceLayer], hints: list[Hints], steps: GridSteps, details: Sequence[Detail] = ()
) -> Extraction:
    """The zero sets of all layers as one mesh; vertices know their layer. Details are the body's."""
    found = []
    for k, (layer, near) in enumerate(zip(layers, hints, strict=True)):
        found.append(
            extract(
                layer.solid, layer.normal, near, steps, least=LEAST_HAIR if k == HAIR else None,
                details=details if k == BODY else (),
            )
        )  # fmt: skip
    if len(found) == 1:
        return found[0]
    queries, islands, slits = (sum(counts) for counts in zip(*((one.queries, one.islands, one.slits) for one in found)))
    return Extraction(
        concatenated([one.mesh for one in found]), np.concatenate([one.normals for one in found]), queries, islands,
        found[0].island_area, max(one.residual for one in found), slits,
        np.concatenate([np.full(len(one.normals), k) for k, one in enumerate(found)]),
    )  # fmt: skip


def collapsed(
    mesh: TriangleMesh, layer: Integer[Array, "vertices"], layers: list[SurfaceLayer], count: int,
    parts: Sequence[Enlargement | Magnifier], report: Callable[[str], None],
) -> LayeredMesh:  # fmt: skip
    """Each connected piece of a mesh collapsed to its share of `count` triangles and balanced on its own layer's
    surface."""
    pieces = pieces_of(mesh, layer)
    areas = np.array([face_areas(enlarged(piece.vertices, parts), piece.faces).sum() for piece, _ in pieces])
    meshes, normals, labels = [], [], []
    for (piece, k), share in zip(pieces, areas / areas.sum(), strict=True):
        own = decimate(piece, max(int(round(count * share)), 4), parts, report=report)
        own = balanced(own, layers[k].distance, layers[k].normal)
        meshes.append(own)
        normals.append(layers[k].normal(own.vertices))
        labels.append(np.full(len(own.vertices), k))
    nearest = lambda points: np.min([np.abs(layer.distance(points)) for layer in layers], axis=0)
    return LayeredMesh(concatenated(meshes), np.concatenate(normals), np.concatenate(labels), nearest)


def pieces_of(mesh: TriangleMesh, layer: Integer[Array, "vertices"]) -> list[tuple[TriangleMesh, int]]:
    """The connected pieces of a mesh, each with its layer."""
    if not layer.any():
        return [(mesh, BODY)]
    piece = component_labels(mesh.faces, len(mesh.vertices))
    out = []
    for label in np.unique(piece[mesh.faces[:, 0]]):
        faces = mesh.faces[piece[mesh.faces[:, 0]] == label]
        out.append((compact(mesh.vertices, faces)[0], int(layer[faces[0, 0]])))
    return out


def layered_data(
    origin: SourceSurface, mesh: TriangleMesh, normals: Float[Array, "n 3"], layer: Integer[Array, "n"]
) -> TransferredData:
    """What the run's surface says of the vertices of another mesh, each layer's from the same layer."""
    if not layer.any():
        return transferred_data(origin, mesh, normals)
    count = len(mesh.vertices)
    weights = np.zeros((count, origin.weights.shape[1]))
    cone, part, filled = None, np.zeros(count, np.int64), 0
    for k in np.unique(layer):
        own, source = layer == k, origin.layer == k
        vertices, faces = restricted(TriangleMesh(origin.vertices, origin.faces), source)
        given = SourceSurface(
            vertices, faces, origin.part[source], origin.cone.of(source), origin.weights[source], origin.layer[source]
        )
        data = transferred_data(given, restricted(mesh, own), normals[own])
        if cone is None:
            cone = ViewCone(*(np.zeros((count, *value.shape[1:])) for value in data.cone))
        weights[own], part[own], filled = data.weights, data.part, filled + data.filled
        for whole, value in zip(cone, data.cone):
            whole[own] = value
    assert cone is not None
    return TransferredData(weights, cone, part, filled)
