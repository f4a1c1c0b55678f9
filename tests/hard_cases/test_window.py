"""Hard cases of the window: no size at all, odd clocks, month-long runs; with panels and without."""

from dataclasses import dataclass

import glfw
import numpy as np
import pytest
from tiny_avatar import tiny_avatar

from avatar.motion.clip import Motion
from player.scene.scene import Scene, SceneAvatar
from player.scene.track import Track
from player.window.show import opened_show
from player.window.timeline import LONGEST_STEP, Timeline
from player.window.window import Window

MONTH = 30 * 86400.0


@dataclass
class Clock:
    """A clock that is set by hand."""

    now: float

    def __call__(self):
        return self.now


@pytest.fixture(params=["panels", "plain"])
def window(osmesa, request):
    show = opened_show(Scene((SceneAvatar("tiny.glb", "counting"),)), [tiny_avatar()])
    window = Window(show, size=(700, 400), null=True, panels=request.param == "panels", clock=Clock(MONTH))
    try:
        window.run(["space", "home", "wait"], keep=True)
        yield window
        assert window.screen.context.gl.error == "GL_NO_ERROR"
    finally:
        window.close()


def same_picture(window, image):
    """Whether the last frame is `image`, but for the corner and the line that tell the frame rate."""
    left, top, width, height = window.parts.state.layout.area
    part = slice(top + 60, top + height - 30), slice(left, left + width)
    shown = window.parts.state.last.image
    return shown.shape == image.shape and np.array_equal(shown[part], image[part])


def test_a_window_minimised_to_nothing_draws_nothing_and_comes_back(window, monkeypatch):
    before, real = window.parts.state.last.image, glfw.get_framebuffer_size
    calls = dict(window.screen.context.counts.calls)
    for nothing in ((0, 0), (7, 0), (0, 5)):
        monkeypatch.setattr(glfw, "get_framebuffer_size", lambda handle, nothing=nothing: nothing)
        window.run("wait click:100:100 drag:300:100:320:120 near:1 c c r g g s o o v v wait".split(), keep=True)
        assert dict(window.screen.context.counts.calls) == calls
    window.parts.recorder.shoot(on=False)
    monkeypatch.setattr(glfw, "get_framebuffer_size", real)
    window.run(["r", "wait"], keep=True)
    assert same_picture(window, before)


def test_windows_of_a_pixel_and_of_a_long_line_are_drawn(window):
    before = window.parts.state.last.image
    for size in ((1, 1), (3000, 1), (1, 2000), (37, 51)):
        window.run([f"size:{size[0]}:{size[1]}", "wait", "click:0:0", "wait"], keep=True)
        assert window.parts.state.last.image.shape == (size[1], size[0], 4)
    window.run(["size:700:400", "r", "wait"], keep=True)
    assert same_picture(window, before)


def test_after_30_days_with_a_stall_and_a_clock_set_back_time_goes_on_evenly(window, within):
    clock, seconds, draw = window.clock, [], window.draw
    jumps = {10: 10.0, 20: -5.0, 30: -MONTH, 40: 3600.0}

    def drawn(**options):
        draw(**options)
        seconds.append(window.parts.state.timeline.seconds)
        clock.now += jumps.get(len(seconds), 1 / 60)
        window.parts.closing = len(seconds) == 50

    window.draw = drawn
    window.parts.state.timeline.playing = True
    window.run()
    assert len(seconds) == 50
    steps = np.diff(seconds)
    for frame, jump in jumps.items():
        assert steps[frame - 1] == pytest.approx(LONGEST_STEP if jump > 0 else 0.0, abs=1e-9)
    usual = np.delete(steps, [frame - 1 for frame in jumps])
    within(np.abs(usual - 1 / 60).max(), 1e-9, "s")
    assert np.isfinite(window.parts.state.last.rate)


def test_a_motion_of_30_days_is_stepped_and_scrubbed_frame_by_frame(window):
    """77,760,000 frames: every frame asked for is the frame shown, in the memory of two blocks."""

    def block(start, stop):
        root = np.zeros((stop - start, 3))
        root[:, 0] = np.arange(start, stop)
        return np.zeros((stop - start, 52, 3)), root

    frames = int(MONTH) * 30
    playback = window.parts.state.playback
    playback.close()
    playback.tracks.append(Track(Motion("", frames, 30.0, (), block)))
    playback.timeline = Timeline(frames, 30.0)
    playback.timeline.playing = False
    for second in (0.0, 12_345.6, MONTH / 2, MONTH - 1.0):
        window.run([f"scrub:{second}", ".", ".", ","])
        assert window.parts.state.last.poses[0][1][0] == int(second * 30 + 1e-6) + 1
    window.run(["end"])
    assert window.parts.state.last.poses[0][1][0] == frames - 1
    assert sum(len(block.root) for _, block in window.parts.state.playback.tracks[0]._blocks) <= 512
