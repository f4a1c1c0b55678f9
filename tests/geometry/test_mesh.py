"""Normals, seams, components and volumes of triangle meshes."""

import numpy as np
import trimesh
from icosphere import icosphere

from avatar.body import builtin_body
from geometry.mesh import TriangleMesh, component_labels, enclosed_volume, face_areas, largest_component, vertex_normals
from geometry.mesh import weld as welded_vertices


def test_normals_areas_and_volume_of_the_body_are_those_of_trimesh():
    body = builtin_body("male")
    mesh = trimesh.Trimesh(body.vertices.astype(np.float64), body.faces, process=False)
    expected = trimesh.geometry.mean_vertex_normals(len(mesh.vertices), mesh.faces, np.cross(
        mesh.triangles[:, 1] - mesh.triangles[:, 0], mesh.triangles[:, 2] - mesh.triangles[:, 0]))  # fmt: skip
    named = np.unique(mesh.faces)
    np.testing.assert_allclose(vertex_normals(body.vertices, body.faces)[named], expected[named], rtol=0, atol=1e-12)
    np.testing.assert_allclose(face_areas(body.vertices, body.faces), mesh.area_faces, rtol=1e-12)
    parted = mesh.split(only_watertight=False)
    assert component_labels(body.faces, len(body.vertices))[named].max() + 1 >= len(parted)


def test_normals_do_not_see_texture_seams():
    vertices, faces = icosphere(1.0)
    # every face has its own corners
    split = vertices[faces].reshape(-1, 3)
    own = np.arange(len(split)).reshape(-1, 3)
    expected = vertex_normals(vertices, faces)[faces.ravel()]
    np.testing.assert_allclose(vertex_normals(split, own, welded_vertices(split)), expected, atol=1e-12)


def test_a_vertex_without_area_has_a_unit_normal():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 5, 5]])
    np.testing.assert_array_equal(vertex_normals(vertices, np.array([[0, 1, 2]])), np.tile([0.0, 1, 0], (4, 1)))


def test_float32_vertices_are_summed_in_double_precision():
    vertices, faces = icosphere(0.3, subdivisions=4)
    single = vertices.astype(np.float32)
    np.testing.assert_array_equal(vertex_normals(single, faces), vertex_normals(single.astype(np.float64), faces))


def test_the_largest_component_is_the_one_of_greatest_area():
    small, many = icosphere(0.1, subdivisions=4)
    large, few = icosphere(1.0, (3, 0, 0), subdivisions=2)
    mesh = TriangleMesh(np.concatenate([small, large]), np.concatenate([many, few + len(small)]))
    kept, dropped, share = largest_component(mesh)
    assert dropped == 1 and len(kept.faces) == len(few)
    np.testing.assert_array_equal(kept.vertices, large)
    expected = face_areas(small, many).sum() / face_areas(*mesh).sum()
    np.testing.assert_allclose(share, expected, rtol=1e-9)
    np.testing.assert_allclose(enclosed_volume(kept), trimesh.Trimesh(large, few, process=False).volume, rtol=1e-12)
