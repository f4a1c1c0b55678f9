"""Pose sequences in the layouts of AMASS and in pickles: names, frames, up axes, and reading back."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from smplh_model import model_body

from avatar.body import builtin_body, shaped
from avatar.motion.amass import read_amass, write_amass
from avatar.motion.clip import Clip
from avatar.motion.pose_vector import SMPLX_PELVIS, USUAL_PELVIS
from avatar.motion.read import builtin_motion, read_motion
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import joint_transforms
from command.errors import AssetError

Z_FROM_Y = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
RNG = np.random.default_rng(4)
POSES = RNG.normal(0, 0.4, (7, 156))
TRANS = RNG.normal(0, 1.0, (7, 3))


def save(path, **fields):
    fields = dict({"poses": POSES, "trans": TRANS, "mocap_framerate": np.array(120.0)}, **fields)
    np.savez(path, **{k: v for k, v in fields.items() if v is not None})
    return path


def rotations_agree(a, b, atol):
    np.testing.assert_allclose(matrix_from_axis_angle(a), matrix_from_axis_angle(b), atol=atol)


def test_z_up_becomes_y_up_about_the_pelvis_and_a_y_up_file_puts_it_at_trans(tmp_path):
    motion = read_motion(save(tmp_path / "a.npz"))
    clip = motion.read()
    assert motion.frames == 7 and motion.rate == 120.0
    z_world = TRANS + USUAL_PELVIS
    np.testing.assert_allclose(clip.root, z_world @ Z_FROM_Y, atol=1e-14)  # x_y = Z_FROM_Y^T x_z
    expected = Z_FROM_Y.T @ matrix_from_axis_angle(POSES[:, :3])
    np.testing.assert_allclose(matrix_from_axis_angle(clip.axis_angle[:, 0]), expected, atol=1e-13)
    np.testing.assert_array_equal(clip.axis_angle[:, 1:].reshape(7, -1), POSES[:, 3:])
    assert any("up: z" in n for n in clip.notes) and any("J0" in n for n in clip.notes)
    clip = read_motion(save(tmp_path / "a.npz", up_axis=np.array("y"))).read()
    np.testing.assert_array_equal(clip.root, TRANS)
    np.testing.assert_array_equal(clip.axis_angle.reshape(7, 156), POSES)


@pytest.mark.parametrize("up", ["y", "z"])
def test_written_clips_read_back(tmp_path, up):
    clip = builtin_motion("counting").read(0, 40)
    write_amass(tmp_path / "a.npz", clip, up=up)
    back = read_motion(tmp_path / "a.npz").read()
    np.testing.assert_allclose(back.root, clip.root, atol=1e-12)
    rotations_agree(back.axis_angle, clip.axis_angle, 1e-12)
    assert back.rate == clip.rate and back.pelvis_height == pytest.approx(clip.pelvis_height)


def test_a_written_z_up_file_means_the_same_to_a_tool_that_knows_only_amass(tmp_path):
    """Standard SMPL: joints = R (J - J0) + J0 + trans in a z-up world; turned upright they are our joints."""
    clip = builtin_motion("walking").read(100, 110)
    write_amass(tmp_path / "a.npz", clip)
    joints = builtin_body("male").joints
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        poses, trans = file["poses"].reshape(-1, 52, 3), file["trans"]
    theirs = joint_transforms(poses, joints + USUAL_PELVIS, USUAL_PELVIS + trans)[:, :, :3, 3]
    ours = joint_transforms(clip.axis_angle, joints, clip.root)[:, :, :3, 3]
    np.testing.assert_allclose(theirs @ Z_FROM_Y, ours, atol=1e-12)


@pytest.mark.parametrize("root, body", [("root_orient", "pose_body"), ("global_orient", "body_pose")])
@pytest.mark.parametrize("hands", [True, False])
def test_newer_keys_mean_the_same(tmp_path, hands, root, body):
    split = {
        "poses": None,
        "mocap_framerate": None,
        "mocap_frame_rate": np.array(60),
        root: POSES[:, :3],
        body: POSES[:, 3:66],
        "pose_hand": POSES[:, 66:] if hands else None,
        "pose_jaw": np.ones((7, 3)),
        "up_axis": np.array("z"),
    }
    clip = read_motion(save(tmp_path / "a.npz", **split)).read()
    old = read_motion(save(tmp_path / "b.npz")).read()
    assert clip.rate == 60
    np.testing.assert_array_equal(clip.axis_angle[:, :22], old.axis_angle[:, :22])
    np.testing.assert_array_equal(clip.axis_angle[:, 22:], old.axis_angle[:, 22:] * hands)
    assert any("flat" in n for n in clip.notes if "hands" in n)


@pytest.mark.parametrize("gender", [np.array("female"), np.array(b"female"), np.array(["male"])])
def test_gender_may_be_text_or_bytes(tmp_path, gender):
    assert read_motion(save(tmp_path / "a.npz", gender=gender)).frames == 7


def test_an_unusual_rate_is_kept_and_betas_are_ignored_or_used_as_asked(tmp_path):
    path = save(tmp_path / "a.npz", mocap_framerate=np.array(120.00004577636719))
    assert read_motion(path).rate == 120.00004577636719
    motion = read_motion(save(tmp_path / "b.npz", mocap_framerate=None))
    assert motion.rate == 30 and any("30 frames per second assumed" in n for n in motion.notes)
    path = save(tmp_path / "a.npz", betas=np.arange(16) / 10)
    assert any("betas ignored" in n for n in read_motion(path).notes)
    body = replace(builtin_body("male"), name="mine", origin=np.array([0.1, 0.2, 0.3]))
    motion = read_amass(path, body=body)
    J0 = np.array([0.1, 0.2, 0.3]) + body.joint_directions[0] @ (np.arange(10) / 10)
    np.testing.assert_allclose(motion.read().root, (TRANS + J0) @ Z_FROM_Y, atol=1e-12)
    assert motion.pelvis_height > 0.5 and any("10 of the file's 16 betas" in n for n in motion.notes)


@pytest.mark.parametrize("deflated", [False, True])
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64, ">f8", np.float16])
def test_random_stretches_equal_the_whole(tmp_path, deflated, order, dtype):
    poses = np.asarray(RNG.normal(0, 0.3, (500, 156)).astype(dtype), order=order)
    trans = RNG.normal(0, 1, (500, 3))
    (np.savez_compressed if deflated else np.savez)(tmp_path / "a.npz", poses=poses, trans=trans, fps=30, up_axis="y")
    motion = read_motion(tmp_path / "a.npz")
    for start, stop in [(0, 10), (10, 200), (5, 6), (499, 500), (0, 500), (7, 7), (100, 110)]:
        clip = motion.read(start, stop)
        np.testing.assert_array_equal(clip.axis_angle.reshape(-1, 156), poses[start:stop].astype(np.float64))
        np.testing.assert_array_equal(clip.root, trans[start:stop])


def test_writing_refuses_what_cannot_be_read_back_and_a_root_near_half_a_turn_survives(tmp_path):
    clip = builtin_motion("counting").read(0, 2)
    refused(ValueError, "up should be", write_amass, tmp_path / "a.npz", clip, up="x")
    with pytest.raises(ValueError, match="0 frames"):
        write_amass(tmp_path / "a.npz", replace(clip, axis_angle=clip.axis_angle[:0], root=clip.root[:0]))
    refused(ValueError, "finite", write_amass, tmp_path / "a.npz", replace(clip, root=clip.root * np.nan))
    assert not list(tmp_path.iterdir())
    v = axis_angle_from_matrix(matrix_from_axis_angle(np.array([np.pi - 1e-9, 0, 0])))
    pose = np.zeros((1, 52, 3))
    pose[0, 0] = v
    clip = Clip(pose, np.zeros((1, 3)), 30.0)
    write_amass(tmp_path / "a.npz", clip)
    rotations_agree(read_motion(tmp_path / "a.npz").read().axis_angle, pose, 1e-12)


FRAMES = 5


def poses(columns=156, seed=0):
    values = 0.2 * np.random.default_rng(seed).normal(size=(FRAMES, columns))
    return values


MOVES = np.random.default_rng(9).normal(size=(FRAMES, 3))


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
    motion = read_motion(saved(tmp_path / "a.pkl", {name: values, place: MOVES, "fps": 60.0, "gender": "male"}))
    clip = motion.read()
    assert (motion.frames, motion.rate) == (FRAMES, 60)
    np.testing.assert_allclose(clip.axis_angle.reshape(FRAMES, 156), values, atol=1e-15)
    np.testing.assert_allclose(clip.root, MOVES + USUAL_PELVIS)
    np.testing.assert_array_equal(motion.read(2, 4).root, clip.root[2:4])


def test_the_full_pose_goes_before_mosh_coefficients_and_joints_in_rows_of_three_are_the_same(tmp_path):
    fields = {"pose": poses(90), "fullpose": poses(156), "trans": MOVES, "mocap_framerate": 120}
    clip = read_motion(saved(tmp_path / "a.pkl", fields)).read()
    np.testing.assert_allclose(clip.axis_angle.reshape(FRAMES, 156), fields["fullpose"], atol=1e-15)
    a = read_motion(saved(tmp_path / "a.pkl", {"poses": poses(72)})).read()
    b = read_motion(saved(tmp_path / "b.pkl", {"poses": poses(72).reshape(FRAMES, 24, 3)})).read()
    np.testing.assert_array_equal(a.axis_angle, b.axis_angle)


def test_root_and_body_apart(tmp_path):
    fields = {"global_orient": poses(3), "body_pose": poses(69, 1), "transl": MOVES, "betas": np.zeros((FRAMES, 10))}
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
    np.testing.assert_allclose(clip.root, MOVES + USUAL_PELVIS)
    # a jaw is SMPL-X's, whose pelvis rests elsewhere than that of any model of SMPL+H
    fields["jaw_pose"] = poses(3)
    for model in (None, body):
        clip = read_motion(saved(tmp_path / "c.pkl", fields), body=model).read()
        np.testing.assert_allclose(clip.root, MOVES + SMPLX_PELVIS)
    np.testing.assert_allclose(clip.axis_angle[:, 37:].reshape(FRAMES, 45), fields["right_hand_pose"], atol=1e-15)


@pytest.mark.parametrize("kind", ["a.pkl", "a.npz"])
@pytest.mark.parametrize("axis, turn", [("+z", [np.pi / 2, 0, 0]), ("-y", [np.pi, 0, 0]), ("+x", [0, 0, -np.pi / 2])])
def test_the_up_axis_is_found_and_said(tmp_path, kind, axis, turn):
    fields = {"global_orient": np.tile(turn, (FRAMES, 1)), "body_pose": np.zeros((FRAMES, 63)), "transl": MOVES}
    if kind == "a.npz":
        np.savez(tmp_path / kind, **fields)
    motion = read_motion(saved(tmp_path / kind, fields) if kind == "a.pkl" else tmp_path / kind)
    clip = motion.read()
    up = matrix_from_axis_angle(clip.axis_angle[:, 0])[:, :, 1]
    np.testing.assert_allclose(up, np.broadcast_to([0.0, 1, 0], up.shape), atol=1e-12)
    heights = (MOVES + USUAL_PELVIS)[:, "xyz".index(axis[1])] * (1 if axis[0] == "+" else -1)
    np.testing.assert_allclose(clip.root[:, 1], heights, atol=1e-12)
    assert any(f"up: {axis}, the axis the body mostly stands along" in n for n in motion.notes)


def test_an_up_axis_that_a_file_names_is_believed_and_the_model_places_the_pelvis(tmp_path):
    values = np.zeros((FRAMES, 72))
    values[:, 0] = np.pi / 2  # lying on the back in a y-up world
    motion = read_motion(saved(tmp_path / "a.pkl", {"poses": values, "trans": MOVES, "up_axis": "y"}))
    np.testing.assert_allclose(motion.read().axis_angle[:, 0, 0], np.pi / 2)
    body = model_body(tmp_path)
    fields = {"poses": poses(72), "trans": MOVES, "betas": np.array([0.7, -0.4, 0.1])}
    motion = read_motion(saved(tmp_path / "a.pkl", fields), body=body)
    own = shaped(body, np.array([0.7, -0.4]))
    np.testing.assert_allclose(motion.read().root, MOVES + own.origin, atol=1e-12)
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
    refused(AssetError, rf"a\.pkl: {message}", read_motion, saved(tmp_path / "a.pkl", fields))
