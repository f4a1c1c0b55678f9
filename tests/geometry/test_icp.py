"""Eq. 6 and Eq. 5: the right transform, or a refusal."""

import numpy as np
import trimesh
import trimesh.registration
from icosphere import egg

from avatar.body import builtin_body
from avatar.rotation import matrix_from_axis_angle
from geometry.closest import triangle_index
from geometry.icp import Anchors, refine_by_surfaces, rigid_icp


def _moved(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    R, t = matrix_from_axis_angle(np.array([0.02, -0.03, 0.01])), np.array([0.004, -0.003, 0.002])
    return (points - t) @ R, np.block([[R, t[:, None]], [np.zeros((1, 3)), 1]])


def test_a_sheet_that_faces_the_other_way_has_no_say():
    """Two sheets 6 mm apart, as lips are: without normals the wrong one attracts."""
    target, normals = egg(20000)
    inner = 0.93 * egg(20000, 5)[0]
    source, transform = _moved(target[:4000])
    turned, n = np.concatenate([target, inner]), np.concatenate([normals, -normals])
    own = normals[:4000] @ transform[:3, :3]
    found = refine_by_surfaces(source, turned, n, source_normals=own)
    np.testing.assert_allclose(found.transform, transform, atol=1e-6)


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
    target, normals = egg(8000)
    places = target[rng.choice(len(target), 14)]
    wrong = places + [0.004, 0, 0]  # all landmarks 4 mm to one side, believed to 2 mm
    free = refine_by_surfaces(target[::2], target, normals, anchors=Anchors(places, places, 0.002)).transform
    np.testing.assert_allclose(free, np.eye(4), atol=1e-6)
    pulled = refine_by_surfaces(target[::2], target, normals, anchors=Anchors(places, wrong, 0.002)).transform
    assert np.linalg.norm(pulled[:3, 3]) < 0.0015


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
