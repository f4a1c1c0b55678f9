"""A hand and a head that turn before a camera, and a pose in one picture, are found again from their points."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, joint_transforms
from capture.fit import hand, head
from capture.fit.body import CUTS, MOVING, body_names
from capture.fit.footage import Estimate
from capture.fit.person import person_of
from capture.fit.picture import fit_pose
from capture.fit.scan import STEPS, template_of
from capture.fit.solve import posed_frames, solve
from capture.keypoints.record import Keypoints
from tests.turning_twin import in_clothes, pictured

FRAMES, SIZE = 16, 400


def shown(truth, names, moving):
    """Footage of an estimate that is the truth, with half a pixel of noise."""
    truth, footage = pictured(truth, names, moving, size=SIZE, focal=700.0)
    noise = 0.5 * np.random.default_rng(0).standard_normal(footage.pixels.shape)
    return truth, replace(footage, pixels=footage.pixels + noise, sure=2 * footage.sure)


def posed(person, root, heading, angles):
    """The truth of frames of a person of the free body's shape."""
    return Estimate(person, np.zeros(len(person.sigma)), np.zeros((1, 3)), 0.0, angles[0], root, heading, angles)


def degrees(a, b):
    return np.degrees(np.linalg.norm(axis_angle_from_matrix(np.swapaxes(a, -1, -2) @ b), axis=-1))


def turned_hand(side):
    """A bent hand that turns once, its roll and its footage."""
    person = person_of("male")
    wrist = person.body.joints[JOINTS.index(f"{side}_wrist")]
    roll = 2 * np.pi * np.arange(FRAMES) / FRAMES
    sign = 1 if side == "left" else -1
    up = matrix_from_axis_angle(np.array([0, 0, sign * np.pi / 2]))
    heading = matrix_from_axis_angle(roll[:, None] * [0, 1.0, 0]) @ up
    angles = np.zeros((FRAMES, 52, 3))
    angles[:, hand.hand_joints(side)[1:], 0] = np.radians(12)
    truth = posed(person, np.array([0, 0, -0.5]) - heading @ wrist, heading, angles)
    return shown(truth, hand.hand_names(side)[:-1], hand.hand_joints(side))


def joints_off(truth, found, side):
    """Metres from joints of the hand to where they are."""
    own = hand.hand_joints(side)
    return posed_frames(found).place[:, own] - posed_frames(truth).place[:, own]


@pytest.mark.parametrize("side", ["left", pytest.param("right", marks=pytest.mark.slow)])
def test_hand_that_turns_is_found(side):
    truth, footage = turned_hand(side)
    found = hand.first_guess(truth.person, truth.g, footage, side)
    assert np.median(degrees(truth.heading, found.heading)) < 25
    priors = hand.holding(found, footage, side)
    found = solve(found, footage, priors, cuts=(hand.FIRST, *CUTS), rounds=12)
    assert np.linalg.norm(joints_off(truth, found, side), axis=2).mean(1).max() < 0.008


@pytest.mark.slow
def test_outlines_of_thicker_fingers_do_not_draw_the_hand_nearer():
    truth, footage = turned_hand("left")
    told: list[str] = []
    found = hand.fit_hand(truth.person, truth.g, in_clothes(truth, footage, 0.002), "left", told.append)
    assert len(told) == STEPS["hand_left"]
    # .2 cm; 5.5 of 50 cm where fingers' lengths and poses moved before offsets
    assert np.linalg.norm(joints_off(truth, found, "left"), axis=2).mean() < 0.006


def test_head_is_followed_through_frames_that_show_no_face():
    person = person_of("female")
    turn = 2 * np.pi * np.arange(FRAMES) / FRAMES
    heading = matrix_from_axis_angle(turn[:, None] * [0, 1.0, 0])
    neck = person.body.joints[head.HEAD]
    truth = posed(person, np.array([0, 0, -0.7]) - heading @ neck, heading, np.zeros((FRAMES, 52, 3)))
    truth, footage = shown(truth, head.NAMES, np.zeros(0, np.int64))
    behind = np.cos(turn) < -0.3
    footage = replace(footage, sure=np.where(behind[:, None], 0.0, footage.sure))
    found = head.first_guess(person, truth.g, footage)
    priors = head.turning(found, footage)
    found = solve(found, footage, priors, cuts=(head.FIRST, *CUTS), rounds=10)
    off = degrees(heading, found.heading)
    assert off[~behind].max() < 1.5 and off[behind].max() < 8
    cameras = head.camera_from_head(found)
    # a point of the head lands where the person has it
    x = cameras[0, :3, :3] @ neck + cameras[0, :3, 3]
    np.testing.assert_allclose(x, [0, 0, 0.7], atol=0.01)


def in_one_picture(thickness=0.0):
    """Somebody who poses, in clothes so thick (metres); keypoints and mask."""
    angles = np.zeros((1, 52, 3))
    for side, forwards in (("left", 50), ("right", -10)):
        angles[0, JOINTS.index(f"{side}_shoulder"), :2] = np.radians([-45, forwards])
        angles[0, JOINTS.index(f"{side}_elbow"), 0] = np.radians(70)
    angles[0, JOINTS.index("left_hip"), 0] = angles[0, JOINTS.index("left_knee"), 0] = np.radians(60)
    heading = matrix_from_axis_angle(np.array([[0, np.radians(30), 0]]))
    truth = posed(person_of("male"), np.array([[0.1, 0.1, -3.5]]), heading, angles)
    truth, footage = shown(truth, body_names(), MOVING)
    seen = Keypoints(footage.names, footage.pixels, np.ones_like(footage.sure), footage.size)
    return truth, seen, in_clothes(truth, footage, thickness).masks[0], footage.focal


def limbs_in_camera(truth, seen, mask, focal):
    """Joints as fitted and as they are, in the camera's frame."""
    camera, axis_angle, root = fit_pose(template_of(truth), seen, mask, focal=focal)
    ours = joint_transforms(axis_angle, truth.person.joints(truth.g), root)[:22, :3, 3]
    ours = ours @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    return ours, posed_frames(truth).place[0, :22] * [1, -1, -1]


def test_pose_of_a_known_person_in_one_picture():
    ours, theirs = limbs_in_camera(*in_one_picture())
    assert np.linalg.norm(ours - ours.mean(0) - theirs + theirs.mean(0), axis=1).mean() < 0.03


@pytest.mark.slow
def test_clothes_that_the_template_lacks_do_not_draw_it_nearer_to_one_picture():
    ours, theirs = limbs_in_camera(*in_one_picture(thickness=0.015))
    assert abs((ours - theirs)[:, 2].mean()) < 0.06
