"""Joints and turns of two skeletons: what a rigid motion or a constant turn makes, and what is left of others."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.camera import orbit_camera
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS
from bench.score.skeleton_distance import BODY, LIMBS, joints_off, posed_skeletons, turned_off
from capture.held_out import HeldOutView

REST = builtin_body("male").joints


@pytest.fixture
def views(tmp_path):
    rng = np.random.default_rng(0)
    camera = orbit_camera(np.zeros(3), 3.0, 0.0, 0.0, (64, 64))
    return [HeldOutView(tmp_path, "", "body", i, 0.3 * rng.standard_normal((52, 3)), rng.standard_normal(3), camera)
            for i in range(7)]  # fmt: skip


def turned(view, joint, vector):
    axis_angle = view.axis_angle.copy()
    k = JOINTS.index(joint)
    axis_angle[k] = axis_angle_from_matrix(matrix_from_axis_angle(axis_angle[k]) @ matrix_from_axis_angle(vector))
    return replace(view, axis_angle=axis_angle)


def test_a_shift_is_off_in_place_alone(views, within):
    posed = posed_skeletons([replace(v, root=v.root + [0, 0.03, 0.04]) for v in views], views, REST, REST)
    within(abs(joints_off(posed, LIMBS, aligned=False) - 5.0), 1e-9, "cm")
    within(joints_off(posed, LIMBS, aligned=True), 1e-9, "cm")


def test_a_turn_that_is_the_same_in_all_frames_is_no_error_of_poses(views, within):
    same = posed_skeletons([turned(v, "left_elbow", np.array([0, 0, 0.1])) for v in views], views, REST, REST)
    within(turned_off(same, BODY), 1e-9, "degrees")
    assert joints_off(same, LIMBS, aligned=False) > 0.1  # a wrist of the twelve joints moved
    swinging = [turned(v, "left_elbow", np.array([np.radians(6.0) * (-1) ** i, 0, 0])) for i, v in enumerate(views)]
    posed = posed_skeletons(swinging, views, REST, REST)
    # seven frames: mean 6 / 7 of a degree, (3 x 48 / 7 + 4 x 36 / 7) / 7, of one joint in 21
    assert turned_off(posed, BODY) == pytest.approx((3 * 48 + 4 * 36) / 49 / 21, abs=1e-6)
