"""Points spread over meshes."""

import numpy as np
import pytest
from icosphere import icosphere
from scipy.spatial import KDTree

from geometry.mesh import face_areas
from geometry.sample import lattice_samples, stratified_samples


def test_samples_are_seeded_uniform_by_area_and_keep_to_the_faces_kept():
    vertices, faces = icosphere(1.0)
    # faces of many sizes
    vertices = vertices * np.exp(vertices[:, :1])
    keep = vertices[faces].mean(1)[:, 1] > 0
    samples = stratified_samples(vertices, faces, 20_000, seed=1, weight=keep)
    share = np.bincount(samples.face, minlength=len(faces)) / 20_000
    area = face_areas(vertices, faces) * keep
    # one point of 20 000 at either end
    np.testing.assert_allclose(share, area / area.sum(), atol=1.001e-4)
    again = stratified_samples(vertices, faces, 20_000, seed=1, weight=keep)
    np.testing.assert_array_equal(samples.face, again.face)
    expected = np.average(vertices[faces].mean(1), weights=area, axis=0)
    np.testing.assert_allclose(samples.on(vertices, faces).mean(0), expected, atol=2e-3)


def test_a_generator_goes_on_where_it_stands():
    vertices, faces = icosphere(1.0)
    rng = np.random.default_rng(4)
    first = stratified_samples(vertices, faces, 50, seed=rng)
    second = stratified_samples(vertices, faces, 50, seed=rng)
    np.testing.assert_array_equal(first.barycentric, stratified_samples(vertices, faces, 50, seed=4).barycentric)
    assert not np.array_equal(first.barycentric, second.barycentric)


@pytest.mark.parametrize("area_at", ["first", "last"])
def test_no_point_falls_on_a_face_without_area(area_at):
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    faces = np.array([[0, 0, 1], [0, 1, 2], [1, 1, 2]])[:: 1 if area_at == "first" else -1]
    samples = stratified_samples(corners, faces, 5000, seed=2)
    assert (face_areas(corners, faces)[samples.face] > 0).all()
    assert samples.barycentric.min() >= 0
    np.testing.assert_allclose(samples.barycentric.sum(1), 1, atol=1e-15)


def test_lattice_samples_are_no_farther_apart_than_asked_and_cover_by_area():
    vertices, faces = icosphere(0.5, subdivisions=2)
    samples = lattice_samples(vertices, faces, np.full(len(faces), 0.02))
    points = samples.on(vertices, faces)
    anywhere = stratified_samples(vertices, faces, 5000, seed=0).on(vertices, faces)
    assert KDTree(points).query(anywhere)[0].max() < 0.02
