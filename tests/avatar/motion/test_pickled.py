"""Pickled pose sequences: names, lengths, up axes, and what is refused."""

import pickle

import numpy as np
import pytest
from smplh_model import model_body

from avatar.body import shaped
from avatar.motion.pose_vector import USUAL_PELVIS
from avatar.motion.read import read_motion
from avatar.rotation import matrix_from_axis_angle
from command.errors import AssetError

FRAMES = 5


def poses(columns=156, seed=0):
    values = 0.2 * np.random.default_rng(seed).normal(size=(FRAMES, columns))
    return values


TRANS = np.random.default_rng(9).normal(size=(FRAMES, 3))


def saved(path, value, protocol=2):
    path.write_bytes(pickle.dumps(value, protocol))
    return path


@pytest.mark.parametrize(
    "name, place",
    [("poses", "trans"), ("pose", "transl"), ("fullpose", "trans"), ("pose_est_fullposes", "pose_est_trans")],
)
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_names_that_programs_give(tmp_path, name, place, kind):
    values = poses().astype(kind)
    motion = read_motion(saved(tmp_path / "a.pkl", {name: values, place: TRANS, "fps": 60.0, "gender": "male"}))
    clip = motion.read()
    assert (motion.frames, motion.rate) == (FRAMES, 60)
    np.testing.assert_allclose(clip.axis_angle.reshape(FRAMES, 156), values, atol=1e-15)
    np.testing.assert_allclose(clip.root, TRANS + USUAL_PELVIS)
    np.testing.assert_array_equal(motion.read(2, 4).root, clip.root[2:4])


def test_mosh_coefficients_are_left_for_the_full_pose(tmp_path):
    fields = {"pose": poses(90), "fullpose": poses(156), "trans": TRANS, "mocap_framerate": 120}
    clip = read_motion(saved(tmp_path / "a.pkl", fields)).read()
    np.testing.assert_allclose(clip.axis_angle.reshape(FRAMES, 156), fields["fullpose"], atol=1e-15)


def test_joints_in_rows_of_three_are_the_same(tmp_path):
    a = read_motion(saved(tmp_path / "a.pkl", {"poses": poses(72)})).read()
    b = read_motion(saved(tmp_path / "b.pkl", {"poses": poses(72).reshape(FRAMES, 24, 3)})).read()
    np.testing.assert_array_equal(a.axis_angle, b.axis_angle)


def test_root_and_body_apart(tmp_path):
    fields = {"global_orient": poses(3), "body_pose": poses(69, 1), "transl": TRANS, "betas": np.zeros((FRAMES, 10))}
    clip = read_motion(saved(tmp_path / "a.pkl", fields)).read()
    np.testing.assert_allclose(clip.axis_angle[:, 0], fields["global_orient"], atol=1e-15)
    np.testing.assert_allclose(clip.axis_angle[:, 1:22].reshape(FRAMES, 63), fields["body_pose"][:, :63], atol=1e-15)
    body = model_body(tmp_path)
    fields |= {"left_hand_pose": poses(6, 2), "right_hand_pose": poses(6, 3)}
    path = saved(tmp_path / "b.pkl", fields)
    clip = read_motion(path, body=body).read()
    left = fields["left_hand_pose"] @ body.hands.components[0, :6] + body.hands.mean[0]
    np.testing.assert_allclose(clip.axis_angle[:, 22:37].reshape(FRAMES, 45), left, atol=1e-12)
    fields |= {"left_hand_pose": poses(45, 2), "right_hand_pose": poses(45, 3)}
    clip = read_motion(saved(tmp_path / "c.pkl", fields)).read()
    np.testing.assert_allclose(clip.axis_angle[:, 37:].reshape(FRAMES, 45), fields["right_hand_pose"], atol=1e-15)


@pytest.mark.parametrize("axis, turn", [("+z", [np.pi / 2, 0, 0]), ("-y", [np.pi, 0, 0]), ("+x", [0, 0, -np.pi / 2])])
def test_the_up_axis_is_found_and_said(tmp_path, axis, turn):
    values = np.zeros((FRAMES, 72))
    values[:, :3] = turn
    motion = read_motion(saved(tmp_path / "a.pkl", {"poses": values, "trans": TRANS}))
    clip = motion.read()
    up = matrix_from_axis_angle(clip.axis_angle[:, 0])[:, :, 1]
    np.testing.assert_allclose(up, np.broadcast_to([0.0, 1, 0], up.shape), atol=1e-12)
    heights = (TRANS + USUAL_PELVIS)[:, "xyz".index(axis[1])] * (1 if axis[0] == "+" else -1)
    np.testing.assert_allclose(clip.root[:, 1], heights, atol=1e-12)
    assert any(f"up: {axis}, the axis the body mostly stands along" in n for n in motion.notes)


def test_a_file_that_says_its_up_axis_is_believed(tmp_path):
    values = np.zeros((FRAMES, 72))
    values[:, 0] = np.pi / 2  # lying on the back in a y-up world
    motion = read_motion(saved(tmp_path / "a.pkl", {"poses": values, "trans": TRANS, "up_axis": "y"}))
    np.testing.assert_allclose(motion.read().axis_angle[:, 0, 0], np.pi / 2)


def test_the_model_places_the_pelvis(tmp_path):
    body = model_body(tmp_path)
    fields = {"poses": poses(72), "trans": TRANS, "betas": np.array([0.7, -0.4, 0.1])}
    motion = read_motion(saved(tmp_path / "a.pkl", fields), body=body)
    own = shaped(body, np.array([0.7, -0.4]))
    np.testing.assert_allclose(motion.read().root, TRANS + own.origin, atol=1e-12)
    assert motion.pelvis_height == pytest.approx(-own.vertices[:, 1].min())


@pytest.mark.parametrize(
    "fields, message",
    [
        ({"betas": np.zeros(10)}, "no poses; expected one of poses, .* found .*betas"),
        ([1.0], "no poses; .* found a list"),
        ({"poses": poses(69)}, "poses should have 156, .* has 69: 69 is 23 joints"),
        ({"poses": poses(100)}, "poses should have .* has 100: no known layout"),
        ({"poses": "x"}, "poses should be numbers"),
        ({"poses": np.zeros(())}, r"poses should be \(frames, numbers\)"),
        ({"poses": [[1.0, 2], [3.0]]}, ".* unequal lengths"),
        ({"poses": poses(72), "fps": np.zeros(2)}, "fps should be positive"),
        ({"poses": poses(72), "betas": np.array([np.inf])}, "betas should be finite"),
        ({"poses": poses(72), "up_axis": "q"}, "up_axis should be"),
        ({"body_pose": poses(63)}, "no global_orient or root_orient beside body_pose"),
        ({"body_pose": poses(60), "global_orient": poses(3)}, "body_pose should have 63 or 69 columns, has 60"),
        ({"body_pose": poses(63), "global_orient": poses(3)[:2]}, "global_orient should be"),
        ({"body_pose": poses(63), "global_orient": poses(3), "left_hand_pose": poses(6), "right_hand_pose": poses(45)},
         ".* should have 45 numbers a hand"),
    ],
)  # fmt: skip
def test_what_cannot_be_explained_is_named(tmp_path, fields, message):
    with pytest.raises(AssetError, match=rf"a\.pkl: {message}"):
        read_motion(saved(tmp_path / "a.pkl", fields))
