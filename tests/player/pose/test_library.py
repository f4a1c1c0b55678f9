"""The library: what ships stands on the ground inside the limits, what is kept comes back to the last bit."""

import dataclasses

import numpy as np
import pytest

from avatar.limits import within
from avatar.motion.read import read_motion
from avatar.skeleton import JOINTS, joint_transforms
from command.errors import AssetError
from player.draw.posing import grounded
from player.pose.history import Pose
from player.pose.library import BUILTIN, Library, builtin_pose, check_name, user_folder

ROOT = np.array([0.5, 0.0, -1.0])


def lowest(avatar, axis_angle):
    """Height of the lowest point above the pelvis."""
    return -grounded(avatar, axis_angle, np.zeros(3))[1]


@pytest.mark.parametrize("name", BUILTIN)
def test_built_in_poses_are_inside_the_limits_and_on_the_ground(name, avatar):
    pose = Library("/nowhere").read(name, root=ROOT, ground=lambda pose, root: grounded(avatar, pose, root))
    assert within(pose.axis_angle).all()
    assert pose.root[1] + lowest(avatar, pose.axis_angle) == pytest.approx(0, abs=1e-9)
    assert np.array_equal(pose.root[[0, 2]], ROOT[[0, 2]])


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


def test_a_kept_pose_comes_back_to_the_last_bit_and_plays(tmp_path):
    library = Library(tmp_path / "poses")
    assert library.names() == list(BUILTIN)  # an absent folder is an empty one
    rng = np.random.default_rng(0)
    pose = Pose(rng.normal(size=(52, 3)), rng.normal(size=3))
    path = library.write("My pose é 1", pose, pelvis_height=0.97)
    assert library.names() == [*BUILTIN, "My pose é 1"]
    back = library.read("My pose é 1", root=ROOT, pelvis_height=0.97)
    assert back.same(pose)
    assert np.array_equal(read_motion(path).read().axis_angle[0], pose.axis_angle)
    other = Pose(pose.axis_angle, pose.root + 1)
    library.write("My pose é 1", other, pelvis_height=0.97)
    assert library.read("My pose é 1", root=ROOT).same(other)
    assert [p.name for p in (tmp_path / "poses").iterdir()] == ["My pose é 1.npz"]  # nothing half-written beside
    library.write("a", pose)
    assert library.names()[-2:] == ["a", "My pose é 1"]
    library.delete("My pose é 1")
    assert library.names() == [*BUILTIN, "a"]


def test_what_cannot_be_kept_is_refused_and_what_was_there_stays(tmp_path):
    library = Library(tmp_path)
    pose = Pose(np.zeros((52, 3)), np.zeros(3))
    for name in ("", "  ", "a/b", "..", "a\\b", "x\n", "T-pose", "t-POSE", ".x", "x.", " x", "a" * 81, 'q"', "a:b"):
        with pytest.raises(ValueError, match="pose"):
            library.write(name, pose)
    assert not list(tmp_path.iterdir())
    library.write("good", pose)
    bad = Pose(np.full((52, 3), np.nan), np.zeros(3))
    with pytest.raises(ValueError, match="finite"):
        library.write("good", bad)
    assert library.read("good", root=ROOT).same(pose)
    for name in ("T-pose", "never"):
        with pytest.raises(ValueError, match="pose"):
            library.delete(name)
    with pytest.raises(AssetError, match="no pose 'never'"):
        library.read("never", root=ROOT)
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 not an archive")
    assert "broken" in library.names()
    with pytest.raises(AssetError, match=r"broken\.npz"):
        library.read("broken", root=ROOT)
    check_name("Ärm hoch (2)")


def test_the_user_s_folder_follows_the_desktop_s_rule(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert user_folder() == tmp_path / "selfscan" / "poses"
    monkeypatch.setenv("XDG_DATA_HOME", "relative")  # the rule says: ignored
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert user_folder() == tmp_path / "home" / ".local" / "share" / "selfscan" / "poses"
