import numpy as np
import pytest
from capsules import ball_mesh

from bake.cone import FLOOR, REACH, clamped_tangent, matrix_from_six, six_from_matrix, tangent_frame, view_cone


@pytest.fixture(scope="module")
def ball():
    return ball_mesh(step=0.02)


def seen_ball(ball, count=100.0, spread=0.04):
    normals = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    axes = np.stack(tangent_frame(-normals), 1)
    covariance = spread * np.einsum("nki,nkj->nij", axes, axes)
    return np.full(len(normals), count), -0.9 * normals, six_from_matrix(covariance), normals, ball.faces


def test_metric_is_the_inverse_of_the_widened_covariance_in_the_tangent_plane(ball):
    cone = view_cone(*seen_ball(ball))
    first, _ = tangent_frame(cone.direction)
    matrix = matrix_from_six(cone.metric)
    expected = 1 / (REACH**2 * (0.04 + FLOOR**2))
    np.testing.assert_allclose(np.einsum("ni,nij,nj->n", first, matrix, first), expected, rtol=1e-9)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", matrix, cone.direction), 0, atol=1e-9)
    np.testing.assert_array_equal(cone.seen, 1.0)


@pytest.mark.parametrize("degrees, reached", [(10, 10), (20, 18), (40, 32)])
def test_directions_as_far_out_as_the_data_are_bent_as_designed(degrees, reached):
    s2 = np.array([[np.sin(np.radians(degrees)) ** 2 / 1.0, 0, 0, 0, 0, 0]])
    cone = view_cone(np.array([100.0]), np.array([[0, 0, 1.0]]), s2, np.array([[0, 0, -1.0]]), np.array([[0, 0, 0]]))
    direction = np.array([[np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))]])
    angle = np.degrees(np.arcsin(np.linalg.norm(clamped_tangent(direction, cone))))
    assert angle <= degrees and angle == pytest.approx(reached, abs=0.2 * degrees)


def test_visibility_rises_with_the_count(ball):
    count, *rest = seen_ball(ball)
    count = np.resize([0.0, 5.0, 12.5, 20.0, 1e6], len(count))
    seen = view_cone(count, *rest).seen
    np.testing.assert_allclose(seen[:5], [0, 0, 0.5, 1, 1])


def test_surface_never_seen_looks_against_its_normals(ball):
    count, mean, covariance, normals, faces = seen_ball(ball)
    cone = view_cone(0 * count, 0 * mean, 0 * covariance, normals, faces)
    np.testing.assert_allclose(cone.direction, -normals, atol=1e-12)
    assert (cone.seen == 0).all()
