"""Clips, resampling, the built-in motions, and hands that are replaced or left."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from smplh_model import model_body
from tiny_avatar import tiny_avatar

from avatar.body import builtin_body
from avatar.gltf.avatar_file import write_avatar
from avatar.motion.clip import Clip, fitted, resample
from avatar.motion.fingers import hand_pose, relaxed_hands
from avatar.motion.hands import HANDS, with_hands
from avatar.motion.read import BUILTIN_MOTIONS, builtin_motion, read_motion
from avatar.rotation import matrix_from_axis_angle, quaternion_from_axis_angle
from avatar.skeleton import JOINT_NUMBERS as J
from avatar.skeleton import PARENTS, joint_transforms, skin_transforms
from avatar.skinning import skin_points
from command.errors import AssetError
from experiments.builtin_motions import AUTHORED
from player.film.command import render_main
from player.scene.mannequin import mannequin
from player.scene.motions import motion_for


def spin(frames: int, rate: float, speed: float) -> Clip:
    """Everything turns about z at `speed` rad/s while the root moves at 1 m/s."""
    t = np.arange(frames) / rate
    pose = np.zeros((frames, 52, 3))
    pose[:, :, 2] = (speed * t)[:, None]
    return Clip(pose, np.stack([t, 0 * t, 0 * t], -1), rate)


def world(clip: Clip, body=None):
    return joint_transforms(clip.axis_angle, (body or builtin_body("male")).joints, clip.root)


@pytest.mark.parametrize("rate", [24, 30, 59.94, 120.00004577636719, 240])
def test_resampling_a_constant_spin_is_exact(rate):
    clip = spin(31, 30.0, 5.0)  # passes pi: the axis-angle of the input wraps in effect
    out = resample(clip, rate)
    t = np.arange(len(out.root)) / rate
    assert len(out.root) == int(np.floor(1.0 * rate + 1e-9)) + 1 and out.rate == rate
    np.testing.assert_allclose(out.root[:, 0], t, atol=1e-12)
    expected = quaternion_from_axis_angle(np.stack([0 * t, 0 * t, 5 * t], -1))
    dots = np.abs(np.sum(quaternion_from_axis_angle(out.axis_angle[:, 7]) * expected, -1))
    np.testing.assert_allclose(dots, 1, atol=1e-12)


def test_resampling_at_the_same_rate_changes_nothing_and_fitting_scales_the_root():
    clip = spin(5, 30.0, 1.0)
    np.testing.assert_array_equal(resample(clip, 30.0).axis_angle, clip.axis_angle)
    assert len(resample(spin(1, 30.0, 1.0), 120.0).root) == 1
    motion = builtin_motion("walking")
    clip, out = motion.read(0, 4), fitted(motion, motion.pelvis_height * 0.9).read(0, 4)
    np.testing.assert_allclose(out.root, 0.9 * clip.root)
    assert "0.900" in out.notes[-1]
    unknown = fitted(replace(motion, pelvis_height=None), 0.8).read(0, 4)
    np.testing.assert_array_equal(unknown.root, clip.root)
    assert "not scaled" in unknown.notes[-1]


@pytest.mark.parametrize("rate", [0, -1, np.nan, np.inf])
def test_a_rate_that_is_not_positive_is_refused(rate):
    refused(ValueError, "rate should be positive", lambda: resample(spin(3, 30.0, 1.0), rate))


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILTIN_MOTIONS)
def test_the_committed_motion_is_what_its_script_makes(name):
    clip, made = read_motion(name).read(), AUTHORED[name]()
    np.testing.assert_allclose(clip.axis_angle, made.axis_angle, atol=1e-6)
    np.testing.assert_allclose(clip.root, made.root, atol=1e-6)
    assert clip.rate == 30 and 8 <= len(clip.root) / clip.rate <= 10


@pytest.mark.parametrize("name", BUILTIN_MOTIONS)
def test_feet_stay_on_the_ground_and_joints_move_like_joints(name):
    body, clip = builtin_body("male"), builtin_motion(name).read()
    B = skin_transforms(clip.axis_angle[::15], body.joints, clip.root[::15], rest=np.zeros((52, 3)))
    lowest = np.array([skin_points(body.vertices, body.skin, b)[:, 1].min() for b in B])
    assert np.abs(lowest).max() < 0.02  # metres
    assert clip.axis_angle[:, [J["left_knee"], J["right_knee"]], 0].min() > 0  # calf behind thigh
    turn = np.swapaxes(matrix_from_axis_angle(clip.axis_angle[:-1]), -1, -2) @ matrix_from_axis_angle(
        clip.axis_angle[1:]
    )
    angle = np.arccos(np.clip((np.trace(turn, axis1=-2, axis2=-1) - 1) / 2, -1, 1))
    assert np.degrees(angle.max()) < 25  # per frame of 1/30 s
    assert not np.allclose(
        clip.axis_angle[0, [J["left_shoulder"], J["right_shoulder"]], 2], 0, atol=1.0
    )  # not a T-pose


def test_every_finger_moves_and_elbows_of_waving_and_counting_arms_bend_forward():
    for name in BUILTIN_MOTIONS:
        hands = builtin_motion(name).read().axis_angle[:, 22:]
        assert np.ptp(hands, axis=0).max(-1).min() > 0.1
    clip = builtin_motion("counting").read()
    G = world(clip)
    for side in ("left", "right"):
        arm = [G[130, J[f"{side}_{n}"], :3, 3] for n in ("shoulder", "elbow", "wrist")]
        middle = (arm[0] + arm[2]) / 2
        assert arm[1][1] < middle[1] and arm[2][2] > arm[0][2]  # elbow below, hand before the shoulder


@pytest.mark.parametrize("count", range(1, 11))
def test_as_many_fingers_are_straight_as_have_been_counted(count):
    frame = int(round((3.4 + (count - 1) * 0.52 + 0.40) * 30))
    G = world(builtin_motion("counting").read(frame, frame + 1))[0]

    def straight(side: str, finger: str) -> bool:
        first, last = G[J[f"{side}_{finger}1"]], G[J[f"{side}_{finger}3"]]
        wrist = G[J[f"{side}_wrist"]]
        if finger == "thumb":  # beside the hand, not over the palm
            sideways = wrist[:3, :3].T @ (last[:3, 3] - wrist[:3, 3])
            return bool(sideways[2] > 0.055)
        return float(first[:3, 0] @ wrist[:3, 0]) > 0.8

    fingers = [straight(s, f) for s in ("left", "right") for f in ("index", "middle", "ring", "pinky", "thumb")]
    assert sum(fingers) == count


def test_curling_brings_every_fingertip_towards_the_palm_on_both_sides():
    body = builtin_body("male")
    for curl in (0.3, 0.7):
        left = hand_pose(np.array([curl] * 5 + [0.0]))
        pose = np.zeros((52, 3))
        pose[22:37], pose[37:] = left, left * [1, -1, -1]
        G = joint_transforms(pose, body.joints)
        for side in ("left", "right"):
            for finger in ("index", "middle", "ring", "pinky"):
                tip = J[f"{side}_{finger}3"]
                assert G[tip, 1, 3] < body.joints[tip, 1] - 0.004  # the palm faces down in pose 0
    assert relaxed_hands().shape == (30, 3)


def test_walking_ends_where_it_began_faces_where_it_goes_and_planted_feet_do_not_slide():
    clip = builtin_motion("walking").read()
    G = world(clip)
    step = np.linalg.norm(np.diff(clip.root, axis=0), axis=-1)
    assert np.linalg.norm(clip.root[-1] - clip.root[0]) < 1.5 * step.max()
    for side, first in (("left", 5), ("right", 20)):  # flat between 0.12 and 0.36 of each stride of 30 frames
        ankle = G[:, J[f"{side}_ankle"], :3, 3]
        for start in range(first, 210, 30):
            assert np.ptp(ankle[start : start + 5], axis=0).max() < 1e-4
    assert PARENTS[J["left_ankle"]] == J["left_knee"]
    forward = matrix_from_axis_angle(clip.axis_angle[:, 0])[:, :, 2]
    velocity = np.gradient(clip.root, axis=0)
    velocity /= np.linalg.norm(velocity, axis=-1, keepdims=True)
    assert (forward * velocity).sum(-1).min() > 0.85


@pytest.mark.parametrize("start, stop", [(-1, 2), (3, 2), (0, 301)])
def test_a_stretch_outside_the_motion_is_refused(start, stop):
    refused(ValueError, "not inside", lambda: builtin_motion("counting").read(start, stop))


def test_unknown_motions_are_refused_by_name(tmp_path):
    refused(ValueError, "counting, walking", builtin_motion, "dancing")
    refused(AssetError, "no such file", read_motion, tmp_path / "absent.npz")
    (tmp_path / "song.mp3").write_bytes(b"x")
    with pytest.raises(AssetError, match=r"expected a motion \(\.npz AMASS or SAM 3D Body, .* found '\.mp3'"):
        read_motion(tmp_path / "song.mp3")


def test_hands_of_the_file_are_left_and_the_command_says_what_it_did_with_them(tmp_path, capsys):
    motion = builtin_motion("counting")
    assert with_hands(motion, "file") is motion
    for body in (None, builtin_body("male"), model_body(tmp_path, hands=False)):
        refused(AssetError, "hands_meanl and hands_meanr, given with --body", with_hands, motion, "mean", body)
    refused(ValueError, "file, flat, relaxed, mean, is 'fist'", lambda: with_hands(builtin_motion("counting"), "fist"))
    write_avatar(tmp_path / "a.glb", dataclasses.replace(tiny_avatar(), name="a"))
    frame = ["--frame", "3", "--size", "32x32", "-o", str(tmp_path / "a.png")]
    assert render_main([str(tmp_path / "a.glb"), "--motion", "counting", "--hands", "relaxed", *frame]) == 0
    assert "hands: relaxed, in place of the file's" in capsys.readouterr().out


@pytest.mark.parametrize("choice", ["flat", "relaxed", "mean"])
def test_hands_are_replaced_in_every_frame_and_nothing_else(tmp_path, choice):
    body = model_body(tmp_path)
    motion = builtin_motion("counting")
    new, old = with_hands(motion, choice, body).read(120, 140), motion.read(120, 140)
    expected = {"flat": np.zeros((30, 3)), "relaxed": relaxed_hands(), "mean": body.hands.mean.reshape(30, 3)}[choice]
    np.testing.assert_array_equal(new.axis_angle[:, 22:], np.broadcast_to(expected, (20, 30, 3)))
    np.testing.assert_array_equal(new.axis_angle[:, :22], old.axis_angle[:, :22])
    np.testing.assert_array_equal(new.root, old.root)
    assert np.ptp(old.axis_angle[:, 22:], axis=0).max() > 0.1  # the file's hands do move
    said = [note for note in new.notes if note.startswith("hands:")]
    assert len(said) == 1 and "in place of the file's" in said[0]


@pytest.mark.parametrize("choice", HANDS)
def test_the_command_opens_the_motion_with_the_hands_asked_for(tmp_path, choice):
    body = model_body(tmp_path)
    avatar, model = mannequin(), str(tmp_path / "model.npz")
    motion = motion_for(avatar, "walking", body=model, hands=choice)
    same = with_hands(builtin_motion("walking"), choice, body)
    np.testing.assert_array_equal(motion.read(5, 6).axis_angle, same.read(5, 6).axis_angle)
    assert set(same.notes) < set(motion.notes)
    still = motion_for(avatar, None, body=model, hands=choice).read()
    assert bool(still.axis_angle[0, 22:].any()) == (choice in ("relaxed", "mean"))
