"""Posing in the whole window program, on glfw's null platform with OSMesa: mouse, keys and panels by script."""

import numpy as np
import pytest
from faced_avatar import faced

pytest.importorskip("imgui_bundle", reason="the extra gui is not installed")

import glfw

from avatar.camera import project
from avatar.face import SHAPES
from avatar.gltf.avatar_file import write_avatar
from avatar.limits import joint_angles, within
from avatar.motion.read import read_motion
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINTS, joint_transforms
from player.pose.fingers import PRESETS, hand_shape
from player.pose.ik import LIMBS
from player.pose.mirror import mirrored_in_place
from player.scene.framing import pelvis_height
from player.scene.motions import motion_for
from player.window.pose_tool import HANDLES
from tests.window_script import picture, run

J = {name: k for k, name in enumerate(JOINTS)}
SIZE = (900, 640)
# of the outer ring, window units
RADIUS = 90.0
CTRL_Z, CTRL_Y = "down:ctrl z up:ctrl", "down:ctrl down:shift z up:shift up:ctrl"


@pytest.fixture
def opened(open_window):
    """Opens a window in which the first frame of "counting" is being posed."""

    def posed(*more):
        window = open_window(*more, script="space home p wait")
        return window, window.parts.posing.edit, window.parts.posing.edit.session

    return posed


def at(window, world):
    """Where a world point is, window units."""
    pixel, _ = project(window.parts.state.last.camera, np.asarray(world, float)[None])
    scale = window.screen.pixel(1.0, 1.0)[0]
    return float(pixel[0, 0]) / scale, float(pixel[0, 1]) / scale


def drag(start, end):
    return "drag:{:.3f}:{:.3f}:{:.3f}:{:.3f}".format(*start, *end)


def pull(window, start, end):
    """A drag of which nothing is drawn until it is over."""
    window.pointer.move(*start)
    window.pointer.press(0)
    window.pointer.move(*(0.5 * (np.array(start) + end)))
    window.pointer.move(*end)
    window.pointer.release(0)


def press(window, *names):
    """Press widgets of the panel on the right, scrolled to where each can be seen."""
    for name in names:
        for _ in range(5):
            y = window.panels.places[name][1]
            if 20 < y < SIZE[1] - 100:
                break
            notches = (SIZE[1] / 2 - y) / 75  # a notch is five lines
            window.run([f"move:{SIZE[0] - 100}:300", f"wheel:{notches:.1f}", "wait"], keep=True)
        window.run([f"press:{name}", "wait"], keep=True)


def test_a_joint_is_picked_and_its_ring_turns_it_as_far_as_the_pointer_goes(opened):
    window, edit, session = opened()
    before, plain = session.pose, run(window, "wait")
    elbow = session.world()[J["left_elbow"], :3, 3]
    x, y = at(window, elbow)
    run(window, f"click:{x:.1f}:{y:.1f} wait")
    assert edit.tool.joint == J["left_elbow"] and session.pose is before
    rings = run(window, "move:5:5 wait wait")
    assert np.abs(rings - plain).max() > 100 and not edit.tool.on_ring

    def on_outer_ring(angle):
        return x + RADIUS * np.cos(angle), y - RADIUS * np.sin(angle)

    session.limited = False
    # a press that does not move is no step
    run(window, "move:{0}:{1} wait click:{0}:{1} wait wait".format(*on_outer_ring(2.4)))
    assert edit.tool.on_ring and session.pose is before and not session.history.past
    run(window, drag(on_outer_ring(2.4), on_outer_ring(3.4)) + " wait")
    turned = session.world()[J["left_elbow"], :3, :3]
    was = joint_transforms(before.axis_angle, session.joints, before.root)[J["left_elbow"], :3, :3]
    towards = -window.parts.state.last.camera.camera_from_world[2, :3]
    np.testing.assert_allclose(axis_angle_from_matrix(turned @ was.T), towards, atol=0.03)
    others = np.delete(np.arange(52), J["left_elbow"])
    assert np.array_equal(session.pose.axis_angle[others], before.axis_angle[others])
    assert [label for label, _ in session.history.past] == ["left_elbow"] and edit.tool.held is None
    # what is drawn is what is posed; undo brings the first picture back
    assert not np.array_equal(run(window, "move:5:5 wait"), rings)
    back = picture(window, run(window, f"{CTRL_Z} wait wait"))
    assert np.array_equal(back[60:], picture(window, rings)[60:])
    assert session.pose.same(before) and not session.history.dirty
    run(window, CTRL_Y)
    assert not session.pose.same(before)
    # escape gives the drag up while the button is still down
    here = session.pose
    run(window, "move:{}:{} wait".format(*on_outer_ring(2.4)))
    window.on_button(0, True)
    run(window, "wait move:{}:{} wait".format(*on_outer_ring(2.9)))
    assert not session.pose.same(here)
    run(window, "escape move:{}:{} wait".format(*on_outer_ring(3.4)))
    window.on_button(0, False)
    run(window, "wait wait")
    assert session.pose.same(here) and edit.tool.held is None and not window.parts.closing


@pytest.mark.parametrize("joint", ["left_elbow", "right_elbow", "neck", "left_index2", "right_hip"])
def test_rings_turn_about_the_axes_of_the_joint_or_of_the_world(opened, joint):
    """The first ring of a hinge changes its flexion alone, the third of every joint its twist alone."""
    window, edit, session = opened()
    window.parts.state.selection.choose(0, J[joint])
    session.limited = False
    start, axes = joint_angles(session.pose.axis_angle)[J[joint]], edit.tool.ring_axes()
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    # ImGuizmo knows right-handed axes only
    assert np.linalg.det(axes) == pytest.approx(1)
    edit.tool.turn(matrix_from_axis_angle(axes[:, 2] * 0.2) @ axes)
    edit.tool.release()
    change = joint_angles(session.pose.axis_angle)[J[joint]] - start
    np.testing.assert_allclose(np.abs(change), [0, 0, 0.2], atol=1e-9)
    edit.tool.frame = "world"
    assert np.array_equal(edit.tool.ring_axes(), np.eye(3))


def test_hands_feet_body_and_elbows_are_pulled_and_pins_hold(opened):
    window, edit, session = opened()
    start = session.pose
    for handle in HANDLES:
        session.limited = False
        place = session.world()[handle.joint, :3, 3]
        x, y = at(window, place)
        pull(window, (x, y), (x - 14, y - 18))
        now = session.world()[handle.joint, :3, 3]
        if handle.kind != "middle":
            reached = np.array(at(window, now)) - (x, y)
            np.testing.assert_allclose(reached, [-14, -18], atol=0.5)
            assert np.linalg.norm(now - place) > 0.01
        else:
            end = LIMBS[handle.name].end
            assert np.linalg.norm(now - place) > 1e-3
            before = session.history.past[-1][1]
            kept = joint_transforms(before.axis_angle, session.joints, before.root)[end, :3, 3]
            np.testing.assert_allclose(session.world()[end, :3, 3], kept, atol=1e-9)
        edit.undo()
        assert session.pose is start
    press(window, "pin left foot")
    assert set(session.pinned) == {"left_foot"}
    foot = session.world()[J["left_ankle"]]
    x, y = at(window, session.pose.root)
    pull(window, (x, y), (x, y + 15))
    assert session.pose.root[1] < start.root[1] - 0.01
    np.testing.assert_allclose(session.world()[J["left_ankle"]], foot, atol=1e-6)
    assert joint_angles(session.pose.axis_angle)[J["left_knee"], 0] > 0.2
    here = session.pose
    # a press on a handle that does not move selects its joint; beside everything the camera turns
    x, y = at(window, session.world()[J["right_ankle"], :3, 3])
    run(window, f"move:{x:.1f}:{y:.1f} wait click:{x:.1f}:{y:.1f}")
    assert edit.tool.joint == J["right_ankle"]
    azimuth, (left, top, *_) = window.parts.viewpoint.cameras.orbit.azimuth, window.parts.state.layout.area
    run(window, drag((left + 20, top + 20), (left + 60, top + 20)))
    assert window.parts.viewpoint.cameras.orbit.azimuth != azimuth and session.pose.same(here)


def test_panels_set_angles_hands_mirror_and_take_poses(opened):
    window, edit, session = opened()
    window.parts.state.selection.choose(0, J["left_elbow"])
    run(window, "wait wait")
    press(window, "angle 0")  # somewhere right of its middle
    assert 0.9 < joint_angles(session.pose.axis_angle)[J["left_elbow"], 0] < 2.2
    x, y = window.panels.places["angle 0"]
    run(window, drag((x, y), (x + 3000, y)))  # far beyond the end: the limit holds
    assert 149 < np.degrees(joint_angles(session.pose.axis_angle)[J["left_elbow"], 0]) <= 150.001
    assert within(session.pose.axis_angle)[J["left_elbow"]]
    assert len(session.history.past) == 2  # each drag of a slider is one step
    press(window, "left fist", "right peace")
    for side, name in (("left", "fist"), ("right", "peace")):
        np.testing.assert_allclose(hand_shape(session.pose.axis_angle, side).curl, PRESETS[name].curl, atol=1e-6)
    pose = session.pose.axis_angle
    press(window, "mirror")
    np.testing.assert_allclose(session.pose.axis_angle, mirrored_in_place(pose), atol=1e-9)
    press(window, "undo")
    press(window, "library", "take T-pose")
    assert np.abs(session.pose.axis_angle).max() == 0
    assert session.pose.root[1] == pytest.approx(pelvis_height(window.parts.state.avatars[0]), abs=1e-6)
    press(window, "undo", "undo", "redo", "redo")
    assert np.abs(session.pose.axis_angle).max() == 0
    press(window, "limits")
    assert not session.limited


def test_a_pose_is_asked_for_before_it_is_lost_and_plays_as_a_motion(opened, avatar):
    window, edit, session = opened()
    session.set_angle(J["right_elbow"], 0, 1.5)
    shown = window.parts.posing.poses()[0][0]
    assert np.array_equal(shown, session.pose.axis_angle)
    run(window, "q")
    assert not window.parts.closing and "not saved" in window.parts.state.messages.last
    press(window, "file")
    window.run(["type:mine.npz"])
    press(window, "save")
    assert not session.history.dirty
    run(window, "wait")
    assert read_motion("mine.npz").frames == 1
    clip = motion_for(window.parts.state.avatars[0], "mine.npz").read(0, 1)
    np.testing.assert_allclose(clip.axis_angle[0], session.pose.axis_angle, atol=1e-9)
    np.testing.assert_allclose(clip.root[0], session.pose.root, atol=1e-9)
    # leaving gives the avatar its motion back
    run(window, "p")
    assert window.parts.posing.edit is None
    assert np.array_equal(window.parts.posing.poses()[0][0], window.parts.state.playback.poses()[0][0])


def test_a_pose_is_kept_in_the_library_and_taken_from_it(opened, tmp_path):
    window, edit, session = opened()
    session.set_angle(J["left_shoulder"], 0, 0.6)
    session.move(session.pose, session.pose.root + [0.05, 0, 0])
    wanted = session.pose
    press(window, "name")
    window.run(["type:Arm_up"])
    press(window, "keep")
    kept = tmp_path / "data" / "selfscan" / "poses" / "Arm up.npz"
    assert kept.is_file() and edit.library.names()[-1] == "Arm up"
    edit.take("T-pose")
    assert not session.pose.same(wanted)
    edit.take("Arm up")
    assert session.pose.same(wanted)


def test_a_face_is_posed_by_sliders_on_both_sides_or_one(open_window, tmp_path):
    write_avatar(tmp_path / "faced.glb", faced())
    window = open_window(str(tmp_path / "faced.glb"), size=SIZE, script="space home tab p wait wait")
    session = window.parts.posing.edit.session
    blink = [SHAPES.index(f"eyeBlink{side}") for side in ("Left", "Right")]
    press(window, "Eyes", "eyeBlinkLeft")
    assert session.pose.weights[blink[0]] == session.pose.weights[blink[1]] > 0.1 and len(session.history.past) == 1
    assert "eyeBlinkRight" not in window.panels.places
    shown = window.parts.posing.poses()
    assert shown[0].face is None and np.array_equal(shown[1].face.weights, session.pose.weights)
    press(window, "both sides", "eyeBlinkRight", "look up")
    assert session.pose.gaze[0, 1] == session.pose.gaze[1, 1] != 0 and len(session.history.past) <= 3
    press(window, "reset face")
    assert session.pose.face is None
    press(window, "undo")
    assert session.pose.weights[blink[0]] > 0.1


def test_without_panels_the_keys_pose_one_of_two(opened, avatar_path):
    window, edit, session = opened(avatar_path)
    pose = session.pose.axis_angle
    run(window, "m")
    np.testing.assert_allclose(session.pose.axis_angle, mirrored_in_place(pose), atol=1e-9)
    run(window, CTRL_Z)
    assert np.array_equal(session.pose.axis_angle, pose)
    window.parts.state.selection.choose(0, J["right_wrist"])
    run(window, "down:ctrl c up:ctrl down:ctrl down:shift v up:shift up:ctrl")
    left, right = ([J[f"{side}_{p}"] for p in ("collar", "shoulder", "elbow", "wrist")] for side in ("left", "right"))
    np.testing.assert_allclose(session.pose.axis_angle[left], pose[right] * [1, -1, -1], atol=1e-9)
    session.move(session.pose, session.pose.root + [0, 1.0, 0])
    run(window, "n")
    assert session.pose.root[1] < 1.2
    run(window, "p")
    assert window.parts.posing.edit is edit and "not saved" in window.parts.state.messages.last
    run(window, "p")
    assert window.parts.posing.edit is None
    # the other avatar, from where it stands; the first has its motion again
    run(window, "tab p")
    assert window.parts.posing.edit.index == 1 and window.parts.posing.edit is not edit
    place = window.parts.state.playback.poses()[1][1]
    assert np.array_equal(window.parts.posing.edit.session.pose.root, place) and abs(place[0]) > 0.3
    run(window, ". . . m wait")
    assert np.array_equal(window.parts.state.last.poses[0][0], window.parts.state.playback.poses()[0][0])
    np.testing.assert_allclose(window.parts.state.last.poses[1][0], mirrored_in_place(pose), atol=1e-9)
    before = window.parts.state.timeline.frame
    run(window, CTRL_Z)  # without keys time stays where it is
    assert window.parts.state.timeline.frame == before


def test_posing_leaves_no_objects_behind(opened):
    window, edit, session = opened()
    window.parts.state.selection.choose(0, J["head"])
    run(window, "wait wait wait")
    counts = window.screen.context.counts.objects()
    start = session.pose
    for k in range(20):
        session.turn(start, J["head"], np.array([0.0, 1, 0]), 0.02 * k, drag="nod")
        run(window, "wait")
    assert window.screen.context.counts.objects() == counts
    assert len(session.history.past) == 1
    # with the panels hidden nothing is drawn over the avatar, and nothing there can be seized
    pixel = window.screen.pixel(*at(window, session.world()[J["left_wrist"], :3, 3]))
    assert edit.tool.under(*pixel) is HANDLES[0]
    run(window, "g wait")
    pixel = window.screen.pixel(*at(window, session.world()[J["left_wrist"], :3, 3]))
    assert edit.tool.under(*pixel) is None
    assert glfw.get_window_size(window.screen.handle) == SIZE
