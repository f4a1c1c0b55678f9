"""Body models: the built-in ones and the SMPL+H file format, and the outer points of a body."""

import numpy as np
import pytest
from memory_use import at_most
from smplh_model import write_model

from avatar.body import builtin_body, read_body, shaped
from avatar.hull import CHUNK, body_hull, lowest_points, outermost, posed_hull
from avatar.rotation import fibonacci_sphere
from avatar.skeleton import JOINTS, PARENTS
from command.errors import AssetError


@pytest.mark.parametrize("sex", ["male", "female"])
def test_the_builtin_body_is_a_person_of_plausible_size_in_a_t_pose(sex):
    body = builtin_body(sex)
    height = np.ptp(body.vertices[:, 1])
    assert 1.5 < height < 1.95
    np.testing.assert_array_equal(body.joints[0], 0)
    left_arm = body.joints[JOINTS.index("left_wrist")] - body.joints[JOINTS.index("left_shoulder")]
    assert left_arm[0] > 0.95 * np.linalg.norm(left_arm)  # +x is the subject's left
    toes = body.joints[JOINTS.index("left_foot")] - body.joints[JOINTS.index("left_ankle")]
    assert toes[2] > 0.05  # +z is out of the chest
    np.testing.assert_allclose(body.skin.weights.sum(1), 1, atol=1e-6)


def test_fingers_hang_from_their_own_wrist_and_shapes_move_joints_and_vertices_linearly():
    for joint in range(22, 52):
        side = "left" if joint < 37 else "right"
        assert JOINTS[joint].startswith(side)
        assert JOINTS[PARENTS[joint]].startswith(side)
    assert JOINTS[22:37:3] == ("left_index1", "left_middle1", "left_pinky1", "left_ring1", "left_thumb1")
    body = builtin_body("male")
    once, twice = shaped(body, np.array([0.5])), shaped(body, np.array([1.0]))
    np.testing.assert_allclose(twice.vertices - body.vertices, 2 * (once.vertices - body.vertices), atol=1e-12)
    np.testing.assert_array_equal(twice.joints[0], 0)


@pytest.mark.parametrize("change, message", [
    ({"weights": np.zeros((60, 24))}, r"weights should be \(\d+, 52\), is \(60, 24\)"),
    ({"v_template": np.full((60, 3), np.nan)}, "v_template is not finite, first at"),
    ({"f": np.array([[0, 1, 99_999]])}, r"f should index \d+ vertices"),
    ({"J": None, "J_regressor": None}, "neither J nor J_regressor"),
    ({"kintree_table": np.zeros((2, 52))}, "the parent of right_knee|the parent of left_knee"),
    ({"shapedirs": None}, "no shapedirs; the file has"),
    ({"hands_meanl": np.zeros(12)}, r"hands_meanl should be \(45\), is \(12,\)"),
    ({"hands_componentsr": np.zeros((12, 45))}, "hands_componentsr should be"),
    ({"hands_meanr": np.full(45, np.nan)}, "hands_meanr is not finite"),
])  # fmt: skip
def test_a_bad_model_is_refused_by_field(tmp_path, change, message):
    path = write_model(tmp_path / "m.npz", change)
    with pytest.raises(AssetError, match=rf"m\.npz: .*({message})"):
        read_body(path)


def test_joints_that_no_regressor_follows_move_with_no_shape(tmp_path):
    body = read_body(write_model(tmp_path / "m.npz", {"J_regressor": None}))
    assert body.shape_directions.any() and not body.joint_directions.any()


def test_hull_points_are_the_farthest_ones_found_in_little_memory_and_their_heights_those_of_posed_points():
    points = np.random.default_rng(0).normal(size=(2 * CHUNK + 100, 3))
    chosen = outermost(points, 64)
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # 64 directions leave gaps of 20 degrees: what is cut off is small beside the cloud
    missed = (points @ directions.T).max(0) - (points[chosen] @ directions.T).max(0)
    assert missed.min() >= 0 and missed.max() < 0.8
    assert set(np.argmax(points @ fibonacci_sphere(64).T, axis=0)) == set(chosen)
    points = np.random.default_rng(0).normal(size=(500_000, 3))
    with at_most(150e6):
        outermost(points)
    hull = body_hull(builtin_body("male"))
    rng = np.random.default_rng(0)
    pose, root = rng.normal(size=(40, 52, 3)), rng.normal(size=(40, 3))
    expected = posed_hull(hull, pose, root)[..., 1].min(1)
    np.testing.assert_allclose(lowest_points(hull, pose, root), expected, rtol=0, atol=1e-12)
