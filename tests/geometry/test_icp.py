"""Eq. 6 and Eq. 5: the right transform, or a refusal."""

import numpy as np
import pytest
import trimesh
import trimesh.registration

from avatar.body import builtin_body
from avatar.rotation import matrix_from_axis_angle
from avatar.similarity import similarity_from_landmarks
from geometry.closest import triangle_index
from geometry.icp import Anchors, refine_by_surfaces, rigid_icp
from geometry.sample import stratified_samples


def _landmarks(count: int = 8, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.08, (count, 3))


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1.0, np.pi - 1e-9, np.pi])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 7.3, 1e3])
def test_similarity_is_recovered_exactly(angle, scale):
    source = _landmarks()
    R = matrix_from_axis_angle(angle * np.array([0.6, 0.0, 0.8]))
    target = scale * source @ R.T + [1.0, -2.0, 3.0]
    found = similarity_from_landmarks(source, target)
    np.testing.assert_allclose(found.transform[:3, :3], scale * R, atol=1e-9 * scale)
    assert found.residual < 1e-9 * scale + 1e-12
    assert np.linalg.det(found.transform[:3, :3]) > 0


def test_coplanar_landmarks_give_a_rotation_not_a_reflection():
    source = _landmarks() * [1, 1, 0]
    R = matrix_from_axis_angle(np.array([0.3, 2.0, -0.4]))
    found = similarity_from_landmarks(source, source @ R.T)
    np.testing.assert_allclose(found.transform[:3, :3], R, atol=1e-9)


@pytest.mark.parametrize(
    "source, target, reason",
    [
        (_landmarks(2), _landmarks(2), "at least 3"),
        (np.outer(np.arange(5), [1.0, 2, 3]), _landmarks(5), "on a line"),
        (np.zeros((4, 3)), _landmarks(4), "on a line"),
        (_landmarks(), _landmarks() * [-1, 1, 1], "mirror images"),
        (np.full((4, 3), np.nan), _landmarks(4), "not finite"),
    ],
)
def test_landmarks_that_determine_nothing_are_refused(source, target, reason):
    with pytest.raises(ValueError, match=reason):
        similarity_from_landmarks(source, target)


def _egg(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of an ellipsoid with three different axes."""
    axes = np.array([0.07, 0.11, 0.09])
    d = np.random.default_rng(seed).normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    normals = d / axes
    return d * axes, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _moved(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    R, t = matrix_from_axis_angle(np.array([0.02, -0.03, 0.01])), np.array([0.004, -0.003, 0.002])
    return (points - t) @ R, np.block([[R, t[:, None]], [np.zeros((1, 3)), 1]])


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.45])
def test_surfaces_are_brought_together_despite_outliers(outliers):
    target, normals = _egg(20000)
    points = _egg(3000, 1)[0]
    bad = np.random.default_rng(2).random(len(points)) < outliers
    points[bad] *= 1.12
    source, transform = _moved(points)
    found = refine_by_surfaces(source, target, normals)
    # the samples are 2 mm apart, their tangent planes a hundredth of that off the egg
    np.testing.assert_allclose(found.transform, transform, atol=2e-4)


def test_a_sheet_that_faces_the_other_way_has_no_say():
    """Two sheets 6 mm apart, as lips are: without normals the wrong one attracts."""
    target, normals = _egg(20000)
    inner = 0.93 * _egg(20000, 5)[0]
    source, transform = _moved(target[:4000])
    turned, n = np.concatenate([target, inner]), np.concatenate([normals, -normals])
    own = normals[:4000] @ transform[:3, :3]
    found = refine_by_surfaces(source, turned, n, source_normals=own)
    np.testing.assert_allclose(found.transform, transform, atol=1e-6)


def test_a_sphere_is_centred_and_its_rotation_left_alone():
    d = np.random.default_rng(0).normal(size=(30000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    found = refine_by_surfaces(0.1 * d[:4000] + [0.003, 0, 0], 0.1 * d, d)
    centre = found.transform[:3, :3] @ [0.003, 0, 0] + found.transform[:3, 3]
    assert np.linalg.norm(centre) < 5e-4
    assert np.linalg.norm(found.transform[:3, :3] - np.eye(3)) < 0.05


def test_surfaces_that_do_not_overlap_or_have_other_units_are_refused():
    target, normals = _egg(5000)
    with pytest.raises(ValueError, match="under 10 %"):
        refine_by_surfaces(target + 1.0, target, normals)
    with pytest.raises(ValueError, match="under 10 %"):
        refine_by_surfaces(target * 1000, target, normals)


def test_landmarks_hold_what_the_surfaces_do_not_and_the_scale_is_found():
    """On a sphere the surfaces say nothing of the rotation; Eq. 6's scale is 1 % off and both sides say so."""
    rng = np.random.default_rng(5)
    d = rng.standard_normal((3000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    places = 0.1 * d[:14]
    spread = 0.002
    anchors = Anchors(1.01 * places, places, spread)
    found = refine_by_surfaces(1.01 * 0.1 * d[::2], 0.1 * d, d, source_normals=d[::2], anchors=anchors).transform
    np.testing.assert_allclose(found, np.diag([1 / 1.01] * 3 + [1.0]), atol=1e-4)


def test_noisy_landmarks_give_way_to_surfaces_that_determine_the_place():
    rng = np.random.default_rng(6)
    target, normals = _egg(8000)
    places = target[rng.choice(len(target), 14)]
    wrong = places + [0.004, 0, 0]  # all landmarks 4 mm to one side, believed to 2 mm
    free = refine_by_surfaces(target[::2], target, normals, anchors=Anchors(places, places, 0.002)).transform
    np.testing.assert_allclose(free, np.eye(4), atol=1e-6)
    pulled = refine_by_surfaces(target[::2], target, normals, anchors=Anchors(places, wrong, 0.002)).transform
    assert np.linalg.norm(pulled[:3, 3]) < 0.0015


def test_rigid_icp_undoes_a_rigid_motion():
    mesh = trimesh.creation.box((0.3, 0.5, 1.7))
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    points = stratified_samples(vertices, faces, 800, seed=0).on(vertices, faces)
    moved_from_truth = trimesh.transformations.rotation_matrix(0.05, [1, 2, 3])
    moved_from_truth[:3, 3] = [0.01, -0.02, 0.015]
    moved = points @ moved_from_truth[:3, :3].T + moved_from_truth[:3, 3]
    found = rigid_icp(moved, triangle_index(vertices, faces), rounds=100)
    np.testing.assert_allclose(found @ moved_from_truth, np.eye(4), atol=2e-3)


def test_rigid_icp_takes_the_steps_of_trimesh():
    body = builtin_body("male")
    # millimetres: trimesh's tolerances are absolute
    vertices = 1000 * body.vertices.astype(np.float64)
    turn = trimesh.transformations.rotation_matrix(0.03, [1, -1, 2])
    moved = trimesh.transform_points(vertices[::40], turn) + [5, -4, 6]
    found = rigid_icp(moved, triangle_index(vertices, body.faces), rounds=5)
    mesh = trimesh.Trimesh(vertices, body.faces, process=False)
    expected, _, _ = trimesh.registration.icp(moved, mesh, max_iterations=5, threshold=0, reflection=False, scale=False)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
