"""Limits: the angles name every rotation, clamping only touches what is outside, and real motion is inside."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from avatar.body import builtin_body
from avatar.limits import (
    allowed,
    axis_angle_from_joint_angles,
    clamped,
    joint_angles,
    limits,
    posed,
    swing_excess,
    with_angle,
    within,
)
from avatar.motion.fingers import relaxed_hands
from avatar.motion.read import read_motion
from avatar.rotation import matrix_from_axis_angle
from avatar.skeleton import JOINTS, joint_transforms
from player.pose.mirror import mirrored

FEW = settings(max_examples=12, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def any_pose(seed, scale=2.0):
    return np.random.default_rng(seed).normal(size=(52, 3)) * scale


def test_every_joint_has_three_named_angles_on_orthonormal_axes_with_zero_inside():
    table = limits()
    np.testing.assert_allclose(table.axes @ table.axes.swapaxes(1, 2), np.tile(np.eye(3), (52, 1, 1)), atol=1e-12)
    assert all(len(set(names)) == 3 for names in table.names) and len(table.names) == 52
    assert (table.low < 0).all() and (table.high > 0).all()
    # the widest corner of each swing's outline stays below half a turn, where swing and twist are unique
    t = np.linspace(0, 2 * np.pi, 721)
    direction = np.stack([np.cos(t), np.sin(t)], -1)
    bound = np.where(direction[:, None] < 0, -table.low[None, :, :2], table.high[None, :, :2])
    radius = np.sum((np.abs(direction[:, None]) / bound) ** 4, -1) ** -0.25
    assert radius[:, 1:].max() < np.pi


@FEW
@given(seeds, st.sampled_from([0.01, 1.0, 3.0]))
def test_the_angles_name_every_rotation(seed, scale):
    pose = any_pose(seed, scale)
    back = axis_angle_from_joint_angles(joint_angles(pose))
    np.testing.assert_allclose(matrix_from_axis_angle(back), matrix_from_axis_angle(pose), atol=1e-12)


def test_angles_of_a_half_turn_swing_still_give_the_rotation():
    axes = limits().axes
    for angle in (np.pi - 1e-9, np.pi, np.pi + 1e-9):
        pose = axes[:, 0] * angle
        back = axis_angle_from_joint_angles(joint_angles(pose))
        np.testing.assert_allclose(matrix_from_axis_angle(back), matrix_from_axis_angle(pose), atol=1e-8)


@FEW
@given(seeds)
def test_angles_inside_are_read_back_as_they_were_written(seed):
    table = limits()
    rng = np.random.default_rng(seed)
    angles = rng.uniform(table.low, table.high)
    angles[:, :2] *= 0.8 / np.maximum(swing_excess(angles), 0.8)[:, None]
    angles[0] *= 0.5
    np.testing.assert_allclose(joint_angles(axis_angle_from_joint_angles(angles)), angles, atol=1e-12)


@FEW
@given(seeds, st.sampled_from([0.05, 0.5, 2.0]))
def test_clamping_brings_all_inside_and_leaves_what_is_inside_to_the_last_bit(seed, scale):
    pose = any_pose(seed, scale)
    inside = within(pose)
    out = clamped(pose)
    assert within(out).all()
    assert np.array_equal(out[inside], pose[inside])
    assert not (out[~inside] == pose[~inside]).all(-1).any()
    assert np.array_equal(clamped(out), out)
    # the swing keeps its direction
    a, b = joint_angles(pose), joint_angles(out)
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    assert np.abs(cross).max() < 1e-9


@FEW
@given(seeds, seeds)
def test_clamping_is_continuous(seed, other):
    """A small step of the angles is a small step of the clamped ones, also across the boundary."""
    table = limits()
    rng = np.random.default_rng(seed)
    angles = rng.uniform(1.5 * table.low, 1.5 * table.high)
    angles[:, :2] *= np.minimum(1, 2.8 / np.linalg.norm(angles[:, :2], axis=1))[:, None]
    angles[:, 2] = np.clip(angles[:, 2], -3, 3)
    step = 1e-5 * np.random.default_rng(other).normal(size=(52, 3))
    a, b = (axis_angle_from_joint_angles(v) for v in (angles, angles + step))
    gap = matrix_from_axis_angle(clamped(a)) - matrix_from_axis_angle(clamped(b))
    assert np.abs(gap).max() < 1e-3


def test_limits_are_symmetric_a_mirrored_pose_has_the_mirrored_angles():
    pose = any_pose(3, 0.4)
    angles, other = joint_angles(pose), joint_angles(mirrored(pose))
    for k, name in enumerate(JOINTS):
        if name.startswith("left"):
            partner = JOINTS.index("right" + name[4:])
            np.testing.assert_allclose(other[partner], angles[k], atol=1e-12)
    assert np.array_equal(within(pose)[1:3], within(mirrored(pose))[[2, 1]])


@pytest.mark.parametrize(
    ("joint", "name", "end", "moves"),
    [
        ("left_elbow", "flexion", "left_wrist", (None, 0, 1)),  # forwards
        ("right_elbow", "flexion", "right_wrist", (None, 0, 1)),
        ("left_shoulder", "raise", "left_wrist", (None, 1, 0)),
        ("right_shoulder", "forwards", "right_wrist", (None, 0, 1)),
        ("left_hip", "flexion", "left_knee", (0, None, 1)),
        ("left_hip", "abduction", "left_ankle", (1, None, 0)),
        ("right_hip", "abduction", "right_ankle", (-1, None, 0)),
        ("right_knee", "flexion", "right_ankle", (0, None, -1)),  # backwards
        ("left_ankle", "toes up", "left_foot", (0, 1, None)),
        ("spine1", "bend forward", "head", (0, None, 1)),
        ("spine1", "bend to the left", "head", (1, None, 0)),
        ("left_wrist", "flexion", "left_middle1", (None, -1, 0)),  # towards the palm
        ("right_wrist", "towards the thumb", "right_middle1", (None, 0, 1)),
        ("left_collar", "raise", "left_shoulder", (None, 1, None)),
        ("left_index1", "curl", "left_index3", (None, -1, None)),
        ("right_index1", "towards the thumb's side", "right_index3", (None, None, 1)),
    ],
)
def test_a_positive_angle_moves_the_limb_where_its_name_says(joint, name, end, moves):
    joints = builtin_body("male").joints
    pose = posed({joint: {name: 20}})
    way = joint_transforms(pose, joints)[JOINTS.index(end), :3, 3] - joints[JOINTS.index(end)]
    assert np.linalg.norm(way) > 0.01
    for axis, sign in enumerate(moves):
        if sign == 0:
            assert abs(way[axis]) < 0.35 * np.abs(way).max()
        elif sign is not None:
            assert sign * way[axis] > 0.9 * np.abs(way).max() * (abs(sign) > 0) * 0.5


def test_hinges_are_hinges_and_motion_of_people_is_inside(data):
    table = limits()
    for joint, low, high in (("left_knee", -10, 150), ("right_elbow", -10, 150), ("left_index2", -10, 110)):
        k = JOINTS.index(joint)
        np.testing.assert_allclose(np.degrees([table.low[k, 0], table.high[k, 0]]), [low, high])
        assert np.degrees(table.high[k, 1]) <= 10
    for name in ("counting", "walking"):
        clip = read_motion(name).read()
        assert within(clip.axis_angle, 0.02).mean() > 0.999, name
    assert within(np.concatenate([np.zeros((22, 3)), relaxed_hands()])).all()
    # walks captured from people, retargeted: hips, knees and shoulders are inside almost always
    joints = [JOINTS.index(f"{s}_{p}") for s in ("left", "right") for p in ("hip", "knee", "shoulder")]
    for file in ("pybvh_cmu_12_01_walk", "fairmotion_cmu_01_01", "pymo_AV_8Walk_Meredith"):
        motion = read_motion(data / "bvh" / f"{file}.bvh")
        clip = motion.read(0, min(motion.frames, 400))
        assert within(clip.axis_angle, 0.02)[:, joints].mean() > 0.99, file


@FEW
@given(seeds, st.integers(1, 51), st.integers(0, 2), st.floats(-4, 4))
def test_a_slider_moves_one_angle_and_stays_inside(seed, joint, freedom, value):
    pose = clamped(any_pose(seed, 0.5))
    out = with_angle(pose, joint, freedom, value)
    assert within(out).all()
    assert np.array_equal(np.delete(out, joint, 0), np.delete(pose, joint, 0))
    before, after = joint_angles(pose)[joint], joint_angles(out)[joint]
    others = [k for k in range(3) if k != freedom]
    np.testing.assert_allclose(after[others], before[others], atol=1e-9)
    low, high = allowed(joint, before)[freedom]
    assert after[freedom] == pytest.approx(np.clip(value, low, high), abs=1e-9)
    unlimited = with_angle(pose, joint, freedom, 0.3 * value, limited=False)
    assert np.isfinite(unlimited).all()


def test_the_ends_of_a_slider_are_on_the_outline():
    k = JOINTS.index("left_shoulder")
    angles = np.zeros((52, 3))
    angles[k, 0] = np.radians(-80)
    low, high = allowed(k, angles[k])[1]
    for value in (low, high):
        angles[k, 1] = value
        assert swing_excess(angles)[k] == pytest.approx(1, abs=1e-9)
    assert np.degrees(high) < 135


def test_a_pose_in_words_names_what_it_does_not_know():
    with pytest.raises(ValueError, match="no joint 'left_tail'"):
        posed({"left_tail": {"flexion": 1}})
    with pytest.raises(ValueError, match=r"left_knee has no 'raise'; it has flexion"):
        posed({"left_knee": {"raise": 1}})
