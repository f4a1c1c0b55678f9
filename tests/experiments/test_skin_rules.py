import numpy as np
from capsules import ball_mesh

from avatar.skinning import SkinWeights
from experiments.skin_rules import crossing_pairs, nearest_vertex_weights


def test_two_balls_cross_exactly_where_they_overlap():
    ball = ball_mesh(step=0.02)
    apart = np.concatenate([ball.vertices, ball.vertices + [0.25, 0, 0]])
    faces = np.concatenate([ball.faces, ball.faces + len(ball.vertices)])
    assert len(crossing_pairs(apart, faces)) == 0
    near = np.concatenate([ball.vertices, ball.vertices + [0.15, 0, 0.001]])
    found = crossing_pairs(near, faces)
    assert len(found) > 10
    assert ((found.min(1) < len(ball.faces)) & (found.max(1) >= len(ball.faces))).all()
    # the balls of radius .1 meet in a circle in the plane half way
    assert np.abs(near[faces[found]].mean((1, 2))[:, 0] - 0.075).max() < 0.02


def test_nearest_vertex_rule_copies_a_vertex():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0]])
    skin = SkinWeights(np.array([[3, 0, 0, 0], [5, 7, 0, 0]]), np.array([[1, 0, 0, 0], [0.6, 0.4, 0, 0]], np.float32))
    found = nearest_vertex_weights(np.array([[0.4, 0, 0], [0.6, 0, 0]]), vertices, skin)
    np.testing.assert_array_equal(found.joints[:, 0], [3, 5])
    np.testing.assert_allclose(found.weights[1], [0.6, 0.4, 0, 0], atol=1 / 255)
