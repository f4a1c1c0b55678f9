"""AMASS pose files: layouts, frames, and reading back what was written."""

from dataclasses import replace

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.motion.amass import USUAL_PELVIS, read_amass, write_amass
from avatar.motion.clip import Clip
from avatar.motion.read import builtin_motion, read_motion
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import joint_transforms

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


def test_z_up_becomes_y_up_about_the_pelvis(tmp_path):
    motion = read_motion(save(tmp_path / "a.npz"))
    clip = motion.read()
    assert motion.frames == 7 and motion.rate == 120.0
    z_world = TRANS + USUAL_PELVIS
    np.testing.assert_allclose(clip.root, z_world @ Z_FROM_Y, atol=1e-14)  # x_y = Z_FROM_Y^T x_z
    expected = Z_FROM_Y.T @ matrix_from_axis_angle(POSES[:, :3])
    np.testing.assert_allclose(matrix_from_axis_angle(clip.axis_angle[:, 0]), expected, atol=1e-13)
    np.testing.assert_array_equal(clip.axis_angle[:, 1:].reshape(7, -1), POSES[:, 3:])
    assert any("up: z" in n for n in clip.notes) and any("J0" in n for n in clip.notes)


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


def test_the_capture_folders_y_up_file_puts_the_pelvis_at_trans(tmp_path):
    clip = read_motion(save(tmp_path / "a.npz", up_axis=np.array("y"))).read()
    np.testing.assert_array_equal(clip.root, TRANS)
    np.testing.assert_array_equal(clip.axis_angle.reshape(7, 156), POSES)


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


def test_betas_of_the_file_are_ignored_with_a_note_or_used_with_the_files_body(tmp_path):
    path = save(tmp_path / "a.npz", betas=np.arange(16) / 10)
    assert any("betas ignored" in n for n in read_motion(path).notes)
    body = replace(builtin_body("male"), name="mine", origin=np.array([0.1, 0.2, 0.3]))
    motion = read_amass(path, body=body)
    J0 = np.array([0.1, 0.2, 0.3]) + body.joint_directions[0] @ (np.arange(10) / 10)
    np.testing.assert_allclose(motion.read().root, (TRANS + J0) @ Z_FROM_Y, atol=1e-12)
    assert motion.pelvis_height > 0.5 and any("10 of the file's 16 betas" in n for n in motion.notes)


def test_an_unusual_rate_is_kept_and_an_absent_one_is_assumed_aloud(tmp_path):
    path = save(tmp_path / "a.npz", mocap_framerate=np.array(120.00004577636719))
    assert read_motion(path).rate == 120.00004577636719
    motion = read_motion(save(tmp_path / "b.npz", mocap_framerate=None))
    assert motion.rate == 30 and any("30 frames per second assumed" in n for n in motion.notes)


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


def test_writing_refuses_what_could_not_be_read_back(tmp_path):
    clip = builtin_motion("counting").read(0, 2)
    with pytest.raises(ValueError, match="up should be"):
        write_amass(tmp_path / "a.npz", clip, up="x")
    with pytest.raises(ValueError, match="0 frames"):
        write_amass(tmp_path / "a.npz", replace(clip, axis_angle=clip.axis_angle[:0], root=clip.root[:0]))
    with pytest.raises(ValueError, match="finite"):
        write_amass(tmp_path / "a.npz", replace(clip, root=clip.root * np.nan))
    assert not list(tmp_path.iterdir())


def test_a_root_near_half_a_turn_survives_the_change_of_axes(tmp_path):
    v = axis_angle_from_matrix(matrix_from_axis_angle(np.array([np.pi - 1e-9, 0, 0])))
    pose = np.zeros((1, 52, 3))
    pose[0, 0] = v
    clip = Clip(pose, np.zeros((1, 3)), 30.0)
    write_amass(tmp_path / "a.npz", clip)
    rotations_agree(read_motion(tmp_path / "a.npz").read().axis_angle, pose, 1e-12)
