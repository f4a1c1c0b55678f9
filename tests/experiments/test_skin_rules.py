from pathlib import Path

import numpy as np
import pytest
from capsules import ball_mesh

from avatar.motion.read import builtin_motion
from avatar.skinning import SkinWeights
from command.errors import AssetError
from experiments.skin_rules import crossing_pairs, nearest_vertex_weights, real_poses

COUNTING = Path(__file__).parents[2] / "avatar" / "data" / "motions" / "counting.npz"


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


def test_poses_are_spread_over_all_frames_and_too_few_are_refused():
    motion = builtin_motion("counting")
    found = real_poses([COUNTING, COUNTING], 5)
    whole = motion.read(0, motion.frames).axis_angle
    np.testing.assert_array_equal(found[0], whole[0])
    np.testing.assert_array_equal(found[-1], whole[-1])
    with pytest.raises(AssetError, match="poses asked"):
        real_poses([COUNTING], motion.frames + 1)
