"""The window program itself, on glfw's null platform with OSMesa: no display, no GPU."""

import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from avatar.avatar_file import write_avatar
from avatar.errors import AssetError
from player.context import open_context
from player.framing import extent, facing, fitted_camera
from player.motions import opened_motion, retargeted
from player.play_command import play_main
from player.renderer import Renderer
from player.window import Orbit, Playback, check_script


@pytest.fixture(scope="module")
def avatar_path(avatar, tmp_path_factory):
    path = tmp_path_factory.mktemp("avatar") / "a.glb"
    write_avatar(path, avatar)
    return str(path)


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image).astype(int)


def screenshot(avatar_path, path, script, *more):
    arguments = [
        avatar_path,
        "--platform",
        "null",
        "--size",
        "160x200",
        "--script",
        script,
        "--screenshot",
        str(path),
    ]
    assert play_main([*arguments, *more]) == 0
    return pixels(path)


@pytest.mark.usefixtures("osmesa")
def test_keys_play_pause_step_scrub_and_reset(avatar_path, tmp_path):
    def shot(script, *more):
        return screenshot(avatar_path, tmp_path / "a.png", script, *more)[:170]  # without the line of text

    paused = shot("space home right right")
    assert paused.shape == (170, 160, 3)
    assert np.array_equal(paused, shot("space home right right . ,"))  # a step on and a step back
    assert not np.array_equal(paused, shot("space home right right . . . . . ."))
    assert np.array_equal(paused, shot("space home right right turn:90:10 near:2 r"))
    assert not np.array_equal(paused, shot("space home right right turn:90:10"))
    walk = ("--motion", "walking")
    still, away, along = (
        shot(f"space home {keys}", *walk) for keys in ("wait", "right right", "f right right")
    )
    place = [np.argwhere((image != image[0, 0]).any(-1)).mean(0) for image in (still, away, along)]
    assert (
        np.abs(place[0] - place[2]).max() < 6 < np.abs(place[0] - place[1]).max()
    )  # f goes along with the avatar
    assert np.array_equal(shot("end"), shot("space home"))  # playing, the clip starts over


@pytest.mark.usefixtures("osmesa")
def test_view_dependence_switches_and_the_window_resizes(avatar_path, tmp_path):
    full = screenshot(avatar_path, tmp_path / "a.png", "space home")
    paper = screenshot(avatar_path, tmp_path / "b.png", "space home v")
    off = screenshot(avatar_path, tmp_path / "c.png", "space home", "--view", "off")
    assert not np.array_equal(full[:170], paper[:170]) and np.array_equal(paper[:170], off[:170])
    small = screenshot(avatar_path, tmp_path / "d.png", "space home size:90:60 wait")
    assert small.shape == (60, 90, 3) and len(np.unique(small.reshape(-1, 3), axis=0)) > 20


@pytest.mark.usefixtures("osmesa")
def test_a_window_minimised_to_nothing_comes_back(avatar_path, tmp_path):
    code = (
        "import glfw, sys; import player.window as w; real = glfw.get_framebuffer_size; n = [0]\n"
        "def size(handle):\n    n[0] += 1\n    return (0, 0) if 4 < n[0] < 12 else real(handle)\n"
        "glfw.get_framebuffer_size = size\nfrom player.play_command import play_main\nsys.exit(play_main(sys.argv[1:]))"
    )
    out = str(tmp_path / "a.png")
    arguments = [
        avatar_path,
        "--platform",
        "null",
        "--size",
        "64x64",
        "--script",
        "wait " * 8,
        "--screenshot",
        out,
    ]
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert pixels(out).shape == (64, 64, 3)


@pytest.mark.usefixtures("osmesa")
def test_the_window_shows_the_frame_that_render_writes(avatar, avatar_path, tmp_path):
    """Within 1/255 outside the contours, on the same camera."""
    shown = screenshot(avatar_path, tmp_path / "a.png", "space home", "--background", "#000000")
    motion = opened_motion("counting", None)
    clip = retargeted(motion, avatar)
    points = extent(avatar, clip(0, min(256, motion.frames)))
    frame = clip(0, 1)
    camera = fitted_camera(points, facing(frame.axis_angle[0], avatar.joint_positions), (160, 200))
    context = open_context()
    renderer = Renderer(context, [avatar], (160, 200))
    image = renderer.draw([(frame.axis_angle[0], frame.root[0])], camera)
    context.release()
    other = np.abs(image[:170, :, :3].astype(int) - shown[:170]).max(-1) > 1
    assert other.sum() < 0.01 * (image[..., 3] > 0).sum()


def test_an_unknown_word_in_a_script_is_refused(avatar_path):
    with pytest.raises(AssetError, match="'fly' is no key"):
        play_main([avatar_path, "--script", "space fly"])
    check_script(["turn:1:-2", "near:-1", "size:3:4", "wait", "q"])
    with pytest.raises(ValueError, match="turn:x:1"):
        check_script(["turn:x:1"])


def test_without_a_display_one_line_says_so(avatar_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(AssetError, match=r"no window: .*selfscan render"):
        play_main([avatar_path])


def motion_of(frames, rate=30.0):
    from avatar.motion import Clip, Motion

    def block(start, stop):
        axis_angle = np.zeros((stop - start, 52, 3))
        axis_angle[:, 0, 0] = np.arange(start, stop)
        return axis_angle, np.zeros((stop - start, 3))

    motion = Motion("test", frames, rate, (), block)
    return motion, lambda a, b: Clip(*block(a, b), rate)


def test_time_plays_the_right_frames_and_survives_odd_clocks():
    motion, clip = motion_of(1000)
    playback = Playback(motion, [clip], [np.zeros(3)])
    for _ in range(60):
        playback.advance(1 / 60)
    assert playback.frame == 30 and playback.poses()[0][0][0, 0] == 30
    playback.advance(-5.0)  # a clock that goes backwards
    assert playback.frame == 30
    playback.advance(10.0)  # a stall: the clip goes on where it was
    assert playback.frame <= 38
    playback.seconds = 1000 / 30 - 0.01
    playback.advance(0.02)
    assert playback.frame == 0
    playback.seek(999)
    assert playback.poses()[0][0][0, 0] == 999
    playback.seek(-7)
    assert playback.poses()[0][0][0, 0] == 0
    month = Playback(*[motion_of(1)[0], [motion_of(1)[1]], [np.zeros(3)]])
    for _ in range(1000):
        month.advance(0.2)
    assert month.frame == 0 and month.seconds < 0.2


def test_the_orbit_never_passes_a_pole_and_stays_finite():
    orbit = Orbit(np.zeros(3), 2.0, 0.0)
    orbit.turn(1e6, 1e6)
    orbit.approach(1e4)
    assert np.isfinite(orbit.camera((10, 10)).camera_from_world).all() and orbit.distance >= 0.05
    orbit.approach(-1e4)
    orbit.shift(10.0, 10.0, 100)
    assert np.isfinite(orbit.target).all()
