"""The library: what ships stands on the ground inside the limits."""

import dataclasses

import numpy as np
import pytest

from avatar.limits import within
from avatar.skeleton import JOINTS, joint_transforms
from player.draw.posing import grounded
from player.pose.library import BUILTIN, builtin_pose

ROOT = np.array([0.5, 0.0, -1.0])


def lowest(avatar, axis_angle):
    """Height of the lowest point above the pelvis."""
    return -grounded(avatar, axis_angle, np.zeros(3))[1]


@pytest.mark.parametrize("name", BUILTIN)
def test_built_in_poses_are_inside_the_limits_and_on_the_ground(name, avatar):
    axis_angle = builtin_pose(name)
    root = grounded(avatar, axis_angle, ROOT)
    assert within(axis_angle).all()
    assert root[1] + lowest(avatar, axis_angle) == pytest.approx(0, abs=1e-9)
    assert np.array_equal(root[[0, 2]], ROOT[[0, 2]])


def test_the_ground_is_that_of_the_third_level_where_coarser_ones_follow(avatar):
    fine = avatar.levels[0]
    sunk = dataclasses.replace(fine, positions=fine.positions - np.float32([0, 0.01, 0]))
    high = dataclasses.replace(fine, positions=fine.positions + np.float32([0, 0.5, 0]))
    still = np.zeros((52, 3))
    four, two, one = (
        lowest(avatar, still) - lowest(dataclasses.replace(avatar, levels=levels), still)
        for levels in ((fine, fine, sunk, high), (fine, sunk), (fine,))
    )
    assert four == two > 0.005 and one == 0  # legs are spread in the canonical pose: less than the centimetre


def test_built_in_poses_look_like_their_names(avatar):
    joints = avatar.joint_positions.astype(float)

    def at(name):
        places = joint_transforms(builtin_pose(name), joints)[:, :3, 3]
        return dict(zip(JOINTS, places, strict=True))

    assert not builtin_pose("T-pose").any()
    assert at("victory")["left_wrist"][1] > at("victory")["head"][1] + 0.2
    assert at("waving")["right_wrist"][1] > at("waving")["right_elbow"][1] + 0.15 > at("waving")["left_wrist"][1]
    assert at("pointing")["right_wrist"][2] > 0.35
    sitting = at("sitting")
    assert sitting["left_knee"][2] > 0.35 and abs(sitting["left_knee"][1] - sitting["left_hip"][1]) < 0.05
    assert sitting["left_ankle"][1] < sitting["left_knee"][1] - 0.35
    assert at("squatting")["pelvis"][1] - at("squatting")["left_ankle"][1] < 0.45
    assert at("bowing")["head"][2] > 0.35
    thinking = at("thinking")
    assert np.linalg.norm(thinking["right_middle1"] - thinking["head"]) < 0.25
    assert abs(at("standing")["left_wrist"][0]) < 0.45 < at("A-pose")["left_wrist"][0] < at("T-pose")["left_wrist"][0]
    with pytest.raises(ValueError, match="no built-in pose 'dab'"):
        builtin_pose("dab")
