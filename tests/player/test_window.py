"""The window program itself, on glfw's null platform with OSMesa: no display, no GPU. Without panels."""

import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pictures import pixels
from refusals import refused

import player.window.window
from avatar.gltf.avatar_file import write_avatar
from command.errors import AssetError
from player.play_command import play_main
from player.scene.camera_path import CameraPath
from player.scene.cameras import Cameras, Orbit
from player.scene.opened import opened_avatars
from player.scene.scene import Scene, SceneAvatar
from player.scene.scene_file import write_scene
from player.window.script import GESTURES, steps
from player.window.window import Window
from tests.window_script import run

pytestmark = pytest.mark.usefixtures("osmesa")


def screenshot(avatar_path, path, script, *more, size="160x200"):
    avatars = [avatar_path] if isinstance(avatar_path, str) else avatar_path
    arguments = [*avatars, "--no-floor", "--platform", "null", "--no-gui", "--size", size, "--script", script]
    assert play_main([*arguments, "--screenshot", str(path), *more]) == 0
    return pixels(path)


@pytest.fixture
def shot(avatar_path, tmp_path, monkeypatch):
    """The last frame of a script, without the line of text."""
    monkeypatch.chdir(tmp_path)
    return lambda script, *more: screenshot(avatar_path, tmp_path / "a.png", script, *more)[:170]


def test_keys_play_pause_step_scrub_and_reset(shot):
    paused = shot("space home right right")
    assert paused.shape == (170, 160, 3)
    assert np.array_equal(paused, shot("space home right right . ,"))  # a step on and a step back
    assert np.array_equal(paused, shot("space scrub:2.0"))
    assert not np.array_equal(paused, shot("space home right right . . . . . ."))
    assert np.array_equal(paused, shot("space home right right turn:90:10 near:2 r"))
    assert np.array_equal(paused, shot("space home right right drag:80:80:120:90 r"))
    assert np.array_equal(shot("space home right right turn:40:10"), shot("space home right right drag:80:80:120:90"))
    assert not np.array_equal(paused, shot("space home right right turn:90:10"))
    walk = ("--motion", "walking")
    still, away, along = (shot(f"space home {keys}", *walk) for keys in ("wait", "right right", "f right right"))
    place = [np.argwhere((image != image[0, 0]).any(-1)).mean(0) for image in (still, away, along)]
    assert np.abs(place[0] - place[2]).max() < 6 < np.abs(place[0] - place[1]).max()  # f goes along with the avatar
    assert np.array_equal(shot("end"), shot("space home"))  # playing, the clip starts over


def test_view_dependence_switches(shot):
    full, paper, off = shot("space home"), shot("space home v"), shot("space home", "--view", "off")
    assert not np.array_equal(full, paper) and np.array_equal(paper, off)


def test_two_avatars_have_motions_and_places_of_their_own(avatar_path, tmp_path):
    """The second, farther and turned round, counts; the first stands in another motion."""
    motions, places = ["--motion", "walking", "--motion", "counting"], ["--at=-0.9,0,0", "--at=0.9,0,-1,180"]
    image = screenshot([avatar_path] * 2, tmp_path / "a.png", "space scrub:0", *motions, *places)[:170]
    figure = (image != image[0, 0]).any(-1)
    columns = figure.any(0).nonzero()[0]
    assert np.diff(columns).max() > 3  # two figures
    middle = columns[np.diff(columns).argmax()] + 2
    left, right = figure[:, :middle], figure[:, middle:]
    assert left.any(1).sum() > right.any(1).sum() > 20  # the farther one is smaller


def test_cameras_change_and_turn(shot):
    home = shot("space home")
    turned = shot("space home c wait wait wait")
    assert not np.array_equal(turned, home)
    assert np.array_equal(shot("space home c wait wait wait c r"), home)


def test_camera_keys_are_recorded_saved_and_looked_along(shot, tmp_path, avatar_path):
    shot("space home k turn:60:0 end k j")
    path = CameraPath.read(tmp_path / "selfscan-path-000.json")
    assert len(path.seconds) == 2 and path.seconds[0] < 0.1 and abs(path.duration - 10) < 0.1
    start = shot("space home")
    assert not np.array_equal(shot("space home turn:60:0"), start)
    arguments = ("--camera-path", "selfscan-path-000.json")
    assert (np.abs(shot("space home", *arguments) - start).max(-1) > 1).mean() < 0.005
    along, turned = shot("space end", *arguments), shot("space end turn:60:0")
    assert (np.abs(along - turned).max(-1) > 1).mean() < 0.005


def test_screenshots_and_films_hold_the_picture_without_the_text(shot, tmp_path, capsys):
    import av

    shown = shot("space scrub:1 s wait s wait")
    taken = pixels(tmp_path / "selfscan-000.png")
    assert np.array_equal(taken[:170], shown) and np.array_equal(taken, pixels(tmp_path / "selfscan-001.png"))
    assert (taken[170:] == taken[0, 0]).mean() > 0.5 and taken.shape == (200, 160, 3)
    shot("space home space o wait wait wait o")
    with av.open(str(tmp_path / "selfscan-000.mp4")) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(frames) == 4 and frames[0].shape == (200, 160, 3)
    # colours are stored at half the size: brightness tells
    assert np.abs(frames[0][:170].mean(-1) - shot("space home").mean(-1)).mean() < 2.5
    shot("space o wait size:100:80 wait wait")  # another size ends it
    assert "another size" in capsys.readouterr().out and (tmp_path / "selfscan-001.mp4").exists()
    shot("space o wait")  # closing writes it
    assert (tmp_path / "selfscan-002.mp4").exists()


def test_ctrl_c_closes_the_window_once_the_frame_is_drawn(avatar_path, tmp_path, monkeypatch):
    """OpenGL calls back into Python, where an exception would be dropped, and the call with it."""
    draw, drawn, before = Window.draw, [], signal.getsignal(signal.SIGINT)

    def drawing(self, **options):
        if len(drawn) == 2:
            signal.raise_signal(signal.SIGINT)
        draw(self, **options)
        drawn.append(self.parts.state.last.image.copy())

    monkeypatch.setattr(Window, "draw", drawing)
    with pytest.raises(KeyboardInterrupt):
        screenshot(avatar_path, tmp_path / "s.png", ". . . . .")
    assert len(drawn) == 3 and drawn[2].any()
    assert signal.getsignal(signal.SIGINT) is before


def test_a_window_that_cannot_be_made_says_so_and_the_next_one_opens(avatar, avatar_path, tmp_path):
    plain = tmp_path / "plain.glb"
    write_avatar(plain, replace(avatar, linear=None))
    refused(AssetError, "linear", play_main, [str(plain), "--platform", "null", "--view", "linear", "--script", "wait"])
    assert screenshot(avatar_path, tmp_path / "a.png", "wait").shape == (200, 160, 3)


@pytest.mark.parametrize("size", ["1280x800", "640x480", "200x160"])
def test_the_list_of_keys_is_shown_in_windows_of_every_size(avatar_path, tmp_path, size):
    image = screenshot(avatar_path, tmp_path / "a.png", "space h wait wait", size=size)
    keys = (np.abs(image - [255, 204, 51]).max(-1) < 60).nonzero()
    assert len(keys[0]) > 50 and np.ptp(keys[0]) > 0.35 * image.shape[0]


def test_a_script_has_known_words_and_the_docs_name_all(avatar_path):
    refused(AssetError, "'fly' is no key", play_main, [avatar_path, "--platform", "null", "--script", "space fly"])
    words = ["turn:1:-2", "near:-1", "size:3:4", "wait", "q", "click:3:4", "drag:1:2:3:4", "scrub:1.5", "type:a_b"]
    assert len(steps(words)) == 5 + 3 + 7 + 1 + 3
    for wrong in ("turn:x:1", "click:1", "scrub:", "drag:1:2:3", "type:", "down:fly", "press:"):
        refused(ValueError, "is no key", steps, [wrong])
    words = (Path(__file__).parents[2] / "docs" / "play.md").read_text("utf-8").split("## Scripts")[1]
    for word in (*GESTURES, "wait", "pose", "press", "type", "down", "up"):
        assert re.search(rf"`(?:[^`]*, )?{word}[:`]", words), word


def test_without_a_display_or_imgui_bundle_one_line_says_what_to_do(avatar_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    refused(AssetError, r"no window: .*selfscan render", play_main, [avatar_path])
    # before an hour of looking
    refused(AssetError, "there is no folder", play_main, [avatar_path, "--screenshot", "nowhere/a.png"])
    refused(SystemExit, "2", play_main, [avatar_path, "--screenshot", "a.jpg"])
    code = (
        "import sys; sys.modules['imgui_bundle'] = None\n"
        "from selfscan.__main__ import main\nsys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run([sys.executable, "-c", code, "play", avatar_path], capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert "selfscan play needs the package 'imgui-bundle'" in done.stderr and ".[gui]" in done.stderr


def test_files_of_a_scene_that_was_opened_are_followed_from_before_they_are_read(
    open_window, avatar, tmp_path, monkeypatch, capsys
):
    file = tmp_path / "me.glb"
    write_avatar(file, avatar)
    write_scene(tmp_path / "me.toml", Scene((SceneAvatar(str(file)),)))
    window = open_window(str(file), "--follow", "--no-gui")

    def then_replaced(scene):
        read = opened_avatars(scene)
        write_avatar(file, avatar)
        return read

    monkeypatch.setattr(player.window.window, "opened_avatars", then_replaced)
    run(window, "drop:me.toml wait")
    said = capsys.readouterr().out
    assert "me.toml opened" in said and said.count("a new one is shown") == 1


def test_orbit_and_turntable_stay_finite_and_choose_what_is_there():
    orbit = Orbit(np.zeros(3), 2.0, 0.0)
    orbit.turn(1e6, 1e6)
    orbit.approach(1e4)
    assert np.isfinite(orbit.camera((10, 10)).camera_from_world).all() and orbit.distance >= 0.05
    orbit.approach(-1e4)
    orbit.shift(10.0, 10.0, 100)
    assert np.isfinite(orbit.target).all()
    cameras = Cameras(Orbit(np.zeros(3), 2.0, 0.3), kind="turntable")
    before = cameras.camera((10, 10), 0.0, 0).camera_from_world
    for _ in range(120):
        cameras.advance(0.1)
    assert np.allclose(cameras.camera((10, 10), 0.0, 0).camera_from_world, before, atol=1e-9)
    assert cameras.kinds == ["orbit", "turntable"]


def test_a_replaced_file_is_shown_where_the_old_one_stood_and_a_broken_one_is_named(
    open_window, avatar, tmp_path, capsys
):
    file = tmp_path / "me.glb"
    write_avatar(file, avatar)
    window = open_window(str(file), "--follow", "--no-gui", script="space home wait")
    parts = window.parts

    def shown(words="wait"):
        left, top, width, height = parts.state.layout.area
        return run(window, words)[top + height // 2 : top + height - 60, left : left + width]  # no text

    before = shown("right right wait")
    camera, frame = parts.state.last.camera, parts.state.timeline.frame
    parts.state.playback.tracks[1].at = np.array([0.3, 0, -0.4])
    moved = shown()
    assert (moved != before).any()

    levels = tuple(replace(level, base_color=255 - level.base_color) for level in avatar.levels)
    write_avatar(file, replace(avatar, levels=levels))
    other = shown()
    assert "a new one is shown" in capsys.readouterr().out
    assert (other != moved).any(-1).mean() > 0.005
    assert (parts.state.playback.tracks[1].at == [0.3, 0, -0.4]).all() and parts.state.timeline.frame == frame
    assert np.array_equal(parts.state.last.camera.camera_from_world, camera.camera_from_world)
    assert np.array_equal(shown(), other)

    file.write_bytes(b"nothing")
    assert np.array_equal(shown(), other) and "me.glb" in capsys.readouterr().out
    file.unlink()
    assert np.array_equal(shown(), other)
