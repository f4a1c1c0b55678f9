"""What is opened while the window runs, its views, and its scene as `selfscan render` films it."""

import json
from ctypes import c_char_p
from dataclasses import replace
from pathlib import Path
from typing import Any

import glfw
import numpy as np
import pytest
from pictures import pixels
from PIL import Image

from avatar.camera import project
from avatar.gltf.avatar_file import write_avatar
from avatar.motion.read import MOTIONS_FOLDER
from avatar.skeleton import JOINTS, joint_transforms
from command.errors import AssetError
from experiments.scene_docs import DOCS
from player.effects.light import Light
from player.film.command import render_main
from player.live.inbox import Inbox
from player.live.playback import LivePlayback
from player.scene.address import Address
from player.scene.effects import STUDIO
from player.scene.framing import pelvis_height
from player.scene.scene_file import read_scene, write_scene
from player.window.looks import LOOKS
from player.window.opening import kind_of
from player.window.recent import MOST, keep_recent, read_recent
from tests.window_script import run

SKY = str(DOCS / "scenes" / "sky.hdr")


def picture(window, script="wait"):
    """The picture without what is written in its corner."""
    image = run(window, f"{script} move:600:300 wait")
    left, _, width, height = window.parts.state.layout.area
    return image[80:height, left : left + width]


def test_a_motion_moves_the_selected_avatar_from_its_beginning(window):
    run(window, "right right")
    parts = window.parts
    parts.state.playback.tracks[0].at = np.array([0.5, 0.0, 0.0])
    run(window, f"drop:{MOTIONS_FOLDER / 'walking.npz'} wait")
    track, line = parts.state.playback.tracks[0], parts.state.timeline
    assert Path(track.name).name == "walking.npz" and track.at[0] == 0.5
    assert (line.frames, line.frame, line.playing) == (track.motion.frames, 0, False)
    assert parts.state.messages.last == "walking.npz opened"
    assert read_recent() == [str(MOTIONS_FOLDER / "walking.npz")]
    # everyone is in sight again, also where the walk ends
    for words in ("home", "end"):
        run(window, f"{words} wait")
        seen, _ = project(parts.state.last.camera, parts.state.last.poses[0][1][None])
        left, top, width, height = parts.state.layout.area
        assert left < seen[0, 0] < left + width and top < seen[0, 1] < top + height


def test_an_avatar_takes_the_place_of_the_selected_one_and_the_camera_stays(window, avatar, tmp_path):
    levels = tuple(replace(level, base_color=255 - level.base_color) for level in avatar.levels)
    write_avatar(tmp_path / "other.glb", replace(avatar, levels=levels))
    before = picture(window, "turn:40:0 right wait")
    azimuth, frame = window.parts.viewpoint.cameras.orbit.azimuth, window.parts.state.timeline.frame
    assert (picture(window, "drop:other.glb wait") != before).any(-1).mean() > 0.02
    assert window.parts.viewpoint.cameras.orbit.azimuth == azimuth and window.parts.state.timeline.frame == frame
    assert window.parts.state.selection.names == ["other"]


def test_a_sender_poses_the_avatar_that_was_opened_by_its_own_size(open_window, avatar):
    live = LivePlayback(Inbox("udp"), Address("udp", "127.0.0.1", 1), [avatar])
    window = open_window(live=[(live, [0])])
    levels = tuple(replace(level, positions=np.float32(0.6) * level.positions) for level in avatar.levels)
    write_avatar("child.glb", replace(avatar, levels=levels))
    run(window, "drop:child.glb wait")
    assert live.heights == [pelvis_height(window.parts.state.avatars[0])] != [pelvis_height(avatar)]


def test_films_pictures_and_panoramas_go_behind_and_leave_the_shadow_of_the_floor(window, tmp_path):
    Image.new("RGB", (64, 48), (0, 200, 0)).save(tmp_path / "green.png")
    run(window, "press:evening")
    floor = window.parts.look.effects.ground
    green = picture(window, "drop:green.png wait")
    assert (green[0, 0] == [0, 200, 0]).all() and window.parts.look.effects.ground == replace(floor, kind="shadow")
    run(window, f"drop:{DOCS / 'pictures' / 'effects.mp4'} wait")
    assert window.parts.look.background.kind == "video"
    run(window, f"drop:{SKY} wait")
    assert window.parts.look.effects.light == Light(by="panorama") and window.parts.look.background.path == SKY
    run(window, "press:studio")
    assert window.parts.look.background == STUDIO


@pytest.mark.parametrize("name", ["absent.glb", "bad.glb", "bad.npz", "bad.toml", "bad.hdr", "bad.mp4", "bad.xyz", "."])
def test_a_bad_file_is_one_line_and_nothing_is_lost(window, tmp_path, name):
    if name.startswith("bad"):
        (tmp_path / name).write_bytes(b"nothing = [")
    before, parts = picture(window), window.parts
    assert np.array_equal(picture(window, f"drop:{name} wait"), before)
    said = window.parts.state.messages.last
    assert "\n" not in said and name in said and not said.endswith("opened")
    assert window.parts is parts and read_recent() == []


def test_a_place_that_the_system_will_not_look_at_is_an_error_with_its_name():
    with pytest.raises(AssetError, match="longlong"):
        kind_of("long" * 100)


def test_a_scene_replaces_all_once_it_is_open_and_a_pose_is_not_lost(window, tmp_path):
    scene = (DOCS / "scenes" / "evening.toml").read_text("utf-8").replace("sky.hdr", SKY)
    (tmp_path / "evening.toml").write_text(scene, "utf-8")
    (tmp_path / "live.toml").write_text('[[avatar]]\npath = "mannequin"\nlive = "udp:1"\n', "utf-8")
    run(window, "o wait wait drop:live.toml wait")
    assert "selfscan play --scene live.toml" in window.parts.state.messages.last
    (tmp_path / "bad.glb").write_bytes(b"nothing")
    run(window, "o p m")
    pose = window.parts.posing.poses()[0]
    for name, said in (("evening.toml", "not saved"), ("bad.glb", "bad.glb: expected"), (SKY, "sky.hdr opened")):
        run(window, f"drop:{name} wait")
        assert said in window.parts.state.messages.last and np.array_equal(window.parts.posing.poses()[0][0], pose[0])
    run(window, "drop:evening.toml wait wait")
    parts = window.parts
    assert len(parts.state.avatars) == 2 and parts.look.effects.contact is not None and parts.posing.edit is None
    assert parts.viewpoint.cameras.kind == "turntable" and parts.state.messages.last == "evening.toml opened"
    assert {"studio", "avatar 1"} <= window.panels.places.keys()
    # keys act on what is shown now
    run(window, "tab space wait")
    assert parts.state.selection.avatar == 1 and not parts.state.timeline.playing


def test_the_list_shows_what_was_opened_before_and_what_is_in_the_folder(window, tmp_path):
    (tmp_path / "inner").mkdir()
    # a byte of another encoding, as old disks and archives have them
    walk = "wal\udcea.npz"
    (tmp_path / "inner" / walk).write_bytes((MOTIONS_FOLDER / "walking.npz").read_bytes())
    (tmp_path / "scan.tif").touch()
    keep_recent(SKY)
    run(window, "down:ctrl o up:ctrl wait wait")
    assert "file scan.tif" not in window.panels.places, "no background can be read from it"
    assert {"recent 0", "own counting", "file inner", "folder around"} <= window.panels.places.keys()
    run(window, "press:file_inner wait wait")
    run(window, f"press:file_{walk} wait wait")
    assert "close list" not in window.panels.places
    assert Path(window.parts.state.playback.tracks[0].name).name == walk
    run(window, "press:open wait press:recent_1 wait wait")
    assert window.parts.look.background.path == SKY
    run(window, "press:open wait escape wait")
    assert "close list" not in window.panels.places and not window.parts.closing


def test_recent_files_are_a_few_newest_first_and_a_damaged_list_begins_anew(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    names = [str(tmp_path / f"{number}.npz") for number in range(MOST + 2)]
    for name in [*names, names[5]]:
        Path(name).touch()
        keep_recent(name)
    keep_recent("builtin")
    assert read_recent() == [names[5], *(name for name in names[:1:-1] if name != names[5])][:MOST]
    Path(names[5]).unlink()
    assert names[5] not in read_recent()
    # a place that the system will not look at, as one in a locked folder
    (tmp_path / "selfscan" / "recent.json").write_text(json.dumps(["long" * 2000, "nul\0", names[4]]), "utf-8")
    assert read_recent() == [names[4]]
    (tmp_path / "selfscan" / "recent.json").write_text(json.dumps({"a": 1}), "utf-8")
    assert read_recent() == []


@pytest.mark.parametrize(("key", "joint"), [("2", "head"), ("3", "left_middle1"), ("4", "right_middle1")])
def test_views_of_face_and_hands_fill_the_picture_and_go_along(window, key, joint):
    parts = window.parts
    whole = picture(window)
    run(window, f"{key} right right right wait")
    middle = project(parts.state.last.camera, _place(parts, joint)[None])[0][0] - parts.state.layout.area[:2]
    assert (np.abs(middle / parts.state.layout.area[2:] - 0.5) < 0.3).all()
    assert parts.viewpoint.cameras.orbit.distance < 0.4 * parts.viewpoint.cameras.orbit.home.distance
    assert np.array_equal(picture(window, "home 1 wait"), whole)


def _place(parts, joint):
    (axis_angle, root, _), bones = parts.state.last.poses[0], parts.state.avatars[0].joint_positions
    return joint_transforms(axis_angle, bones.astype(float), root)[JOINTS.index(joint), :3, 3]


def test_the_wheel_comes_nearer_to_what_is_under_the_pointer(window):
    parts = window.parts
    run(window, "wait")
    orbit, head = parts.viewpoint.cameras.orbit, _place(parts, "head")
    # as far away as the target, where it stays
    forward = parts.state.last.camera.camera_from_world[2, :3]
    point = head - forward * (forward @ (head - orbit.target))
    before = project(parts.state.last.camera, point[None])[0][0]
    run(window, f"move:{before[0]}:{before[1]} wheel:8 wait")
    assert np.allclose(project(parts.state.last.camera, point[None])[0][0], before, atol=1e-3)
    assert orbit.distance == pytest.approx(orbit.home.distance * 0.9**8)


def test_the_whole_screen_and_back(window):
    size = window.screen.size
    run(window, "f11 wait wait")
    assert window.screen.full and window.screen.size == tuple(glfw.get_video_mode(glfw.get_primary_monitor()).size)
    run(window, "escape wait wait")
    assert not window.screen.full and window.screen.size == size and not window.parts.closing


@pytest.mark.parametrize("script", ["press:stage turn:50:8 near:3 wait", "press:evening 2 wait", f"drop:{SKY} f wait"])
def test_a_saved_scene_is_filmed_as_the_window_shows_it(window, tmp_path, script):
    """Another program of OpenGL draws it: within 2/255 but for a few pixels of outlines."""
    shown = picture(window, script)
    run(window, "down:ctrl s up:ctrl wait")
    assert window.parts.state.messages.last == "selfscan-scene-000.toml written"
    assert render_main(["--scene", "selfscan-scene-000.toml", "--frame", "0", "-o", "film.png"]) == 0
    filmed = pixels(tmp_path / "film.png")[80:, :, :3].astype(int)
    assert filmed.shape == shown.shape
    assert (np.abs(filmed - shown).max(-1) > 2).mean() < 0.002
    # and the window opens it as it was
    run(window, "home r press:studio wait drop:selfscan-scene-000.toml wait wait")
    window.parts.state.timeline.playing = False
    assert (np.abs(picture(window, "home wait") - shown).max(-1) > 2).mean() < 0.002


def test_a_saved_scene_keeps_places_a_hand_made_pose_and_a_camera_path(window, tmp_path):
    run(window, "k turn:60:0 right k c c wait")
    track = window.parts.state.playback.tracks[0]
    track.at, track.turn = np.array([0.25, 0.0, -0.5]), 0.5
    opening = window.parts.opening
    opening.scene = opening.with_avatar(0, replace(opening.scene.avatars[0], hands="flat"))
    run(window, "p m")
    pose = window.parts.posing.poses()[0]
    run(window, "down:ctrl s up:ctrl wait")
    assert window.parts.posing.may_leave()
    scene = read_scene("selfscan-scene-000.toml")
    assert [camera.kind for camera in scene.cameras] == ["path"]
    run(window, "drop:selfscan-scene-000.toml wait wait")
    again = window.parts.state.last.poses[0]
    assert all(np.allclose(new, old, atol=1e-6) for new, old in zip(again[:2], pose[:2], strict=True))
    run(window, "drop:selfscan-scene-000-path.json wait")
    assert "opened" not in window.parts.state.messages.last


def test_every_look_can_be_written_and_read(tmp_path, window):
    for look in LOOKS.values():
        effects, background = look.of(window.parts.look.effects, STUDIO)
        write_scene("look.toml", replace(window.parts.opening.scene, effects=effects, background=background))
        again = read_scene("look.toml")
        assert again.effects.light == effects.light and again.effects.ground is not None
        assert np.allclose(again.effects.ground.color, look.ground.color)


def test_a_dropped_file_reaches_the_window_through_glfw(window):
    """The callback that was set, as glfw calls it."""
    no_callback: Any = None
    dropped: Any = glfw.set_drop_callback(window.screen.handle, no_callback)
    dropped(window.screen.handle, 2, (c_char_p * 2)(b"me.glb", b"walk.npz"))
    assert window.parts.opening.asked == ["me.glb", "walk.npz"]
