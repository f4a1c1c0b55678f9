"""Surface distances against closed forms."""

import numpy as np
import pytest
import trimesh
from mesh_distance import mesh_distance


def sphere(radius, centre=(0.0, 0.0, 0.0), subdivisions=5):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.asarray(mesh.vertices) + centre, np.asarray(mesh.faces)


def test_a_moved_sphere_has_the_mean_distance_of_the_closed_form():
    # |x + s| - r averaged over the sphere, both directions: s/2 in the limit of a small shift s
    shift = 0.002
    measured = mesh_distance(sphere(0.3), sphere(0.3, (shift, 0, 0)), count=20_000)
    assert measured.chamfer == pytest.approx(100 * shift / 2, rel=0.02)


def test_half_a_sphere_is_exact_one_way_and_incomplete_the_other():
    vertices, faces = sphere(0.3)
    upper = faces[(vertices[faces][:, :, 1] > 0).all(1)]
    measured = mesh_distance((vertices, faces), (vertices, upper))
    assert measured.p2s == pytest.approx(0, abs=1e-6)
    assert measured.completeness > 5
