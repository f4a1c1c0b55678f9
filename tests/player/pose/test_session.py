"""The session: undo and redo in any order, drags as one step; the library keeps poses to the last bit."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from avatar.body import builtin_body
from avatar.face import SHAPES
from avatar.limits import joint_angles, within
from avatar.motion.amass import write_amass
from avatar.motion.clip import Clip
from avatar.motion.read import read_motion
from avatar.skeleton import JOINTS, joint_transforms
from command.errors import AssetError
from player.draw.posing import grounded
from player.pose.fingers import PRESETS
from player.pose.history import KeptPose
from player.pose.library import BUILTIN, Library, builtin_pose, check_name, user_folder
from player.pose.mirror import limb_of
from player.pose.session import PoseSession

SOME = settings(max_examples=12, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
J = {name: k for k, name in enumerate(JOINTS)}


def session(**more):
    return PoseSession(builtin_body("male").joints.astype(float), pelvis_height=0.95, **more)


def act(s, rng):
    """One change of any kind."""
    kind, joint, side = rng.integers(0, 8), int(rng.integers(0, 52)), ("left", "right")[rng.integers(0, 2)]

    def turn():
        mark, start = object(), s.pose
        for k in range(4):
            s.turn(start, joint, np.array([0.0, 1, 0]), 0.1 * k, drag=mark)
        s.history.end_drag()

    changes = (
        lambda: s.set_angle(joint, int(rng.integers(0, 3)), float(rng.normal())),
        lambda: s.set_hand(side, PRESETS[list(PRESETS)[rng.integers(0, len(PRESETS))]]),
        lambda: s.set_finger(side, int(rng.integers(0, 5)), curl=float(rng.uniform(0, 1))),
        turn,
        lambda: s.reach(s.pose, f"{side}_hand", s.world()[J[f"{side}_wrist"], :3, 3] + rng.normal(size=3) * 0.1),
        s.mirror,
        lambda: s.to_other_side(limb_of(joint)),
        lambda: s.move(s.pose, s.pose.root + rng.normal(size=3) * 0.05),
    )
    changes[kind]()


@SOME
@given(seeds)
def test_undo_walks_back_through_every_pose_and_redo_forth(seed):
    s, rng = session(), np.random.default_rng(seed)
    for _ in range(15):
        act(s, rng)
    assert within(s.pose.axis_angle, 1e-6).all()
    poses = [pose for _, pose in s.history.past]
    last = s.pose
    walked = []
    while s.undo() is not None:
        walked.append(s.pose)
    assert walked == poses[::-1] and s.undo() is None
    walked = []
    while s.redo() is not None:
        walked.append(s.pose)
    assert walked == [*poses[1:], last] and s.redo() is None


def test_a_drag_is_one_step_and_one_that_led_nowhere_is_none():
    s = session()
    start, mark = s.pose, object()
    for k in range(50):
        s.turn(start, J["left_elbow"], np.array([0.0, -1, 0]), 0.01 * k, drag=mark)
    s.history.end_drag()
    assert [label for label, _ in s.history.past] == ["left_elbow"]
    s.set_angle(J["left_elbow"], 0, 1.0, drag=mark)  # the same mark after the end is another drag
    s.history.end_drag()
    assert len(s.history.past) == 2
    here, mark = s.pose, object()
    s.turn(here, J["head"], np.array([0.0, 1, 0]), 0.3, drag=mark)
    s.turn(here, J["head"], np.array([0.0, 1, 0]), 0.0, drag=mark)
    s.history.end_drag()
    assert len(s.history.past) == 2 and s.pose is here
    s.set_angle(3, 0, 0.0)  # nothing changed
    assert len(s.history.past) == 2
    s.undo()
    s.undo()
    assert s.pose is start and not s.history.dirty


def test_a_drag_that_comes_back_leaves_a_joint_beyond_its_limits_as_it_was():
    bent = np.zeros((52, 3))
    bent[J["left_elbow"]] = (0, 0.35, 0)  # the wrong way, as trackers have it
    s = session(axis_angle=bent)
    start, place, mark = s.pose, s.world()[J["left_wrist"], :3, 3], object()
    for away in ([0, 0.2, 0.1], [0, 0, 0]):
        s.reach(start, "left_hand", place + away, drag=mark)
    s.history.end_drag()
    assert s.pose is start and not s.history.past


def test_a_change_after_undo_forgets_what_could_be_redone_and_old_steps_are_dropped(monkeypatch):
    monkeypatch.setattr("player.pose.history.STEPS", 20)
    s = session()
    for k in range(35):
        s.set_angle(J["head"], 2, 0.001 * (k + 1))
    assert len(s.history.past) == 20
    s.undo()
    assert len(s.history.future) == 1
    s.set_angle(J["head"], 2, -0.2)
    assert not s.history.future and s.redo() is None


def test_limits_touch_only_what_a_change_touches_and_can_be_turned_off():
    wild = np.random.default_rng(0).normal(size=(52, 3)) * 2
    s = session(axis_angle=wild)
    s.set_angle(J["left_knee"], 0, 9.0)
    assert within(s.pose.axis_angle)[J["left_knee"]]
    assert np.array_equal(np.delete(s.pose.axis_angle, J["left_knee"], 0), np.delete(wild, J["left_knee"], 0))
    s.limited = False
    s.set_angle(J["left_knee"], 0, -1.0)
    assert joint_angles(s.pose.axis_angle)[J["left_knee"], 0] == pytest.approx(-1.0)
    refused(ValueError, "not finite", s.put, "x", np.full((52, 3), np.nan))


def test_limbs_divide_the_body():
    limbs = {limb_of(k) for k in range(1, 52)}
    assert sorted(k for limb in limbs for k in limb) == list(range(1, 52)) and len(limbs) == 5
    assert J["left_thumb3"] in limb_of(J["left_collar"]) and J["left_foot"] in limb_of(J["left_hip"])
    mine = np.zeros((52, 3))
    pose = KeptPose(mine, np.zeros(3))
    mine[0] = 1
    assert not pose.axis_angle.any()
    with pytest.raises(ValueError, match="read-only"):
        pose.axis_angle[0] = 1


@SOME
@given(seeds)
def test_pinned_feet_stay_where_they_are_and_as_they_are_turned(seed):
    rng = np.random.default_rng(seed)
    s = session()
    s.limited = False
    for leg in ("left", "right"):
        s.set_angle(J[f"{leg}_hip"], 0, 0.5)
        s.set_angle(J[f"{leg}_knee"], 0, 1.0)
        s.pin(f"{leg}_foot", True)
    feet = [J["left_ankle"], J["right_ankle"]]
    before = s.world()[feet]
    s.move(s.pose, s.pose.root + rng.uniform(-0.05, 0.05, 3))
    s.turn(s.pose, 0, np.array([0.0, 1, 0]), float(rng.uniform(-0.2, 0.2)))
    s.set_angle(J["left_hip"], 1, float(rng.uniform(-0.2, 0.2)))
    np.testing.assert_allclose(s.world()[feet], before, atol=1e-6)
    # a pinned foot itself may be turned, and stays so
    s.turn(s.pose, feet[0], np.array([1.0, 0, 0]), 0.2)
    turned = s.world()[feet[0]]
    np.testing.assert_allclose(turned[:3, 3], before[0, :3, 3], atol=1e-6)
    assert np.abs(turned[:3, :3] - before[0, :3, :3]).max() > 0.1
    s.move(s.pose, s.pose.root + [0.02, 0, 0])
    np.testing.assert_allclose(s.world()[feet[0]], turned, atol=1e-6)
    # pulled, it goes and is held at the new place
    s.reach(s.pose, "left_foot", turned[:3, 3] + [0, 0.1, 0])
    s.move(s.pose, s.pose.root - [0.02, 0, 0])
    np.testing.assert_allclose(s.world()[feet[0], :3, 3], turned[:3, 3] + [0, 0.1, 0], atol=1e-6)
    s.undo()
    s.undo()
    s.pin("left_foot", False)
    s.move(s.pose, s.pose.root + [0, 0.2, 0])
    assert s.world()[feet[0], 1, 3] > turned[1, 3] + 0.15


def test_a_saved_pose_is_a_motion_of_one_frame_fitted_to_whoever_takes_it(tmp_path):
    s = session()
    s.set_angle(J["right_hip"], 0, 0.7)
    s.move(s.pose, np.array([0.1, 0.95, -0.3]))
    assert s.history.dirty
    assert s.save(tmp_path / "pose.npz").endswith("one pose")
    assert not s.history.dirty
    s.set_angle(J["right_hip"], 0, 0.2)
    assert s.history.dirty
    s.undo()
    assert not s.history.dirty  # back at what was saved
    assert read_motion(tmp_path / "pose.npz").frames == 1
    taller = PoseSession(builtin_body("male").joints.astype(float), pelvis_height=1.9)
    taller.load(tmp_path / "pose.npz")
    np.testing.assert_allclose(taller.pose.root, 2 * np.array([0.1, 0.95, -0.3]), atol=1e-12)
    np.testing.assert_allclose(taller.pose.axis_angle, s.pose.axis_angle, atol=1e-12)


def test_the_first_pose_of_any_motion_is_taken_and_a_broken_file_changes_nothing(tmp_path):
    rng = np.random.default_rng(5)
    clip = Clip(rng.normal(size=(7, 52, 3)) * 0.3, rng.normal(size=(7, 3)), 24.0)
    write_amass(tmp_path / "a.npz", clip, up="y")
    s = session()
    s.load(tmp_path / "a.npz")
    assert np.array_equal(s.pose.axis_angle, clip.axis_angle[0]) and not s.history.dirty
    before = s.pose
    (tmp_path / "b.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:300])
    refused(AssetError, r"b\.npz", s.load, tmp_path / "b.npz")
    assert s.pose is before


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


def test_the_ground_is_of_the_third_level_and_the_folder_the_desktops(avatar, monkeypatch, tmp_path):
    fine = avatar.levels[0]
    sunk = dataclasses.replace(fine, positions=fine.positions - np.float32([0, 0.01, 0]))
    high = dataclasses.replace(fine, positions=fine.positions + np.float32([0, 0.5, 0]))
    still = np.zeros((52, 3))
    four, two, one = (
        lowest(avatar, still) - lowest(dataclasses.replace(avatar, levels=levels), still)
        for levels in ((fine, fine, sunk, high), (fine, sunk), (fine,))
    )
    assert four == two > 0.005 and one == 0  # legs are spread in the canonical pose: less than the centimetre
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert user_folder() == tmp_path / "selfscan" / "poses"
    monkeypatch.setenv("XDG_DATA_HOME", "relative")  # the rule says: ignored
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert user_folder() == tmp_path / "home" / ".local" / "share" / "selfscan" / "poses"


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
    refused(ValueError, "no built-in pose 'dab'", builtin_pose, "dab")


def test_a_kept_pose_comes_back_to_the_last_bit_and_plays(tmp_path):
    library = Library(tmp_path / "poses")
    assert library.names() == list(BUILTIN)  # an absent folder is an empty one
    rng = np.random.default_rng(0)
    pose = KeptPose(rng.normal(size=(52, 3)), rng.normal(size=3))
    path = library.write("My pose é 1", pose, pelvis_height=0.97)
    assert library.names() == [*BUILTIN, "My pose é 1"]
    back = library.read("My pose é 1", root=ROOT, pelvis_height=0.97)
    assert back.same(pose)
    assert np.array_equal(read_motion(path).read().axis_angle[0], pose.axis_angle)
    other = KeptPose(pose.axis_angle, pose.root + 1)
    library.write("My pose é 1", other, pelvis_height=0.97)
    assert library.read("My pose é 1", root=ROOT).same(other)
    assert [p.name for p in (tmp_path / "poses").iterdir()] == ["My pose é 1.npz"]  # nothing half-written beside
    library.write("a", pose)
    assert library.names()[-2:] == ["a", "My pose é 1"]
    library.delete("My pose é 1")
    assert library.names() == [*BUILTIN, "a"]


def test_a_face_is_a_step_of_undo_is_mirrored_kept_and_left_by_poses_without_one(tmp_path):
    session = PoseSession(builtin_body("male").joints)
    weights, gaze = np.zeros(52), np.array([[0.3, 0.1], [0.2, 0.1]])
    weights[SHAPES.index("mouthSmileLeft")] = 0.7
    for share in (0.5, 1.0):
        session.set_face(share * weights, share * gaze, drag="smile")
    session.history.end_drag()
    smiling = session.pose
    session.set_angle(18, 0, 1.0)
    assert session.pose.face is not None and [label for label, _ in session.history.past] == ["face", "left_elbow"]
    session.mirror()
    assert session.pose.weights[SHAPES.index("mouthSmileRight")] == 0.7
    assert np.array_equal(session.pose.gaze, [[-0.2, 0.1], [-0.3, 0.1]])
    session.undo(), session.undo()
    assert session.pose is smiling
    library = Library(tmp_path)
    library.write("smiling", smiling)
    assert library.read("smiling", root=np.zeros(3)).same(smiling)
    assert library.read("T-pose", root=np.zeros(3)).face is None
    refused(ValueError, "not finite", session.set_face, weights * np.nan, gaze)
    session.undo()
    assert session.pose.face is None


def test_what_cannot_be_kept_is_refused_and_what_was_there_stays(tmp_path):
    library = Library(tmp_path)
    pose = KeptPose(np.zeros((52, 3)), np.zeros(3))
    for name in ("", "  ", "a/b", "..", "a\\b", "x\n", "T-pose", "t-POSE", ".x", "x.", " x", "a" * 81, 'q"', "a:b"):
        refused(ValueError, "pose", library.write, name, pose)
    assert not list(tmp_path.iterdir())
    library.write("good", pose)
    bad = KeptPose(np.full((52, 3), np.nan), np.zeros(3))
    refused(ValueError, "finite", library.write, "good", bad)
    assert library.read("good", root=ROOT).same(pose)
    for name in ("T-pose", "never"):
        refused(ValueError, "pose", library.delete, name)
    refused(AssetError, "no pose 'never'", library.read, "never", root=ROOT)
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 not an archive")
    assert "broken" in library.names()
    refused(AssetError, r"broken\.npz", library.read, "broken", root=ROOT)
    check_name("Ärm hoch (2)")
