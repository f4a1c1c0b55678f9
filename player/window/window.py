"""The window: its parts put together, one frame after the other.

What is shown is a `Show` (player/window/show.py). The parts that keys, mouse and panels change are
player/window/parts.py, each in a file of its own; what keys do is the table of player/window/actions.py. Text and
widgets are Dear ImGui's (player/window/panels/). The same code runs without a display: glfw's null platform with
OSMesa, driven by a script (player/window/script.py) that calls what glfw calls.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import glfw
import moderngl

from command.errors import AssetError
from command.interrupt import StopRequest, deferred_stop
from player.scene.opened import opened_avatars
from player.scene.scene_file import read_scene
from player.window.budgeted import Budgeted
from player.window.keyboard import Keyboard
from player.window.opening import kind_of, open_file, renew
from player.window.panels.panels import Panels
from player.window.parts import WindowParts
from player.window.pointer import Pointer
from player.window.recent import keep_recent
from player.window.recorder import save_picture
from player.window.screen import Screen
from player.window.script import RATE, steps
from player.window.show import Show, file_stamps, opened_show
from player.window.state import Messages
from player.window.timeline import LONGEST_STEP

Clock = Callable[[], float]
# seconds that a still window sleeps before it looks whether it was asked to stop, or a message has run out
STILL = 0.25
# frames drawn after an event: a panel answers one or two frames late
ANSWERS = 4
# seconds after an event in which a tooltip may still appear
LINGER = 1.0


class Window:
    """The window with everything in it. `run` returns when it is closed or the script has ended."""

    def __init__(
        self,
        show: Show,
        *,
        size: tuple[int, int],
        null: bool = False,
        panels: bool = True,
        clock: Clock = time.perf_counter,
        budget: float | None = None,
    ):
        """panels: whether they are shown at first. budget: milliseconds of a frame's own work."""
        self.clock, self.screen = clock, Screen(size, null=null)
        self._begin(WindowParts(show, self.screen, clock, Messages(clock)), panels=panels)
        show.fit_orbit(self.parts.state.layout.area[2:])
        # seconds that have passed for loose parts: also while the timeline stands
        self._moved = 0.0
        self._last_tick = clock()
        # when the last event came, and how many frames are to be drawn at once after it
        self._stirred, self._answers = clock(), ANSWERS
        if budget is not None:
            self.parts.budget = self._budgeted(budget)
        self._connect()

    def _begin(self, parts: WindowParts, *, panels: bool) -> None:
        self.parts = parts
        self.keyboard, self.pointer = Keyboard(parts), Pointer(parts)
        parts.state.layout.panels_on = panels
        self.panels = Panels(parts)

    def _budgeted(self, budget: float) -> Budgeted:
        """What this window draws within a budget: a few moments of its motion are timed as the orbit sees them.

        Timing takes long the first time, so the avatar is shown first, with a line that says what is being done."""
        parts, size = self.parts, self.screen.size
        camera = parts.viewpoint.cameras.orbit.camera(size)
        tracks = parts.state.playback.tracks
        moments = [share * max(track.end for track in tracks) for share in (0.1, 0.35, 0.6, 0.85)]
        frames = [([track.pose(seconds) for track in tracks], camera) for seconds in moments]
        parts.state.messages.say(f"timing what holds {budget:.3g} ms a frame; up to a minute the first time ...")
        self.draw()
        glfw.poll_events()
        files = [entry.path for entry in parts.opening.scene.avatars]
        return Budgeted(parts.look, parts.look.scene(frames, size), files, budget, parts.state.messages)

    def _connect(self) -> None:
        """glfw calls what a script calls."""
        handle = self.screen.handle
        glfw.set_key_callback(handle, lambda _w, key, _s, action, _m: self.on_key(key, bool(action)))
        glfw.set_char_callback(handle, lambda _w, letter: self.on_text(letter))
        glfw.set_scroll_callback(handle, lambda _w, _dx, dy: self.on_wheel(dy))
        glfw.set_cursor_pos_callback(handle, lambda _w, x, y: self.on_pointer(x, y))
        glfw.set_mouse_button_callback(handle, lambda _w, button, action, _m: self.on_button(button, bool(action)))
        # its types have the callback of C, with a count
        dropped: Any = lambda _w, paths: self.on_drop(paths)
        glfw.set_drop_callback(handle, dropped)
        glfw.set_window_refresh_callback(handle, lambda _w: self._stir())
        glfw.set_framebuffer_size_callback(handle, lambda _w, _wide, _high: self._stir())
        glfw.set_window_close_callback(
            handle, lambda handle: glfw.set_window_should_close(handle, self.parts.posing.may_leave())
        )

    def _stir(self) -> None:
        """Something happened that may change the picture."""
        self._stirred, self._answers = self.clock(), ANSWERS

    # -- events; a script calls the same

    def on_key(self, key: int, down: bool) -> None:
        self._stir()
        if not down:
            self.keyboard.release(key)
        taken = self.panels.on_key(key, down)
        if down and not taken:
            self.keyboard.press(key)

    def on_text(self, letter: int) -> None:
        self._stir()
        self.panels.on_text(letter)

    def on_wheel(self, clicks: float | int) -> None:
        self._stir()
        if not self.panels.on_wheel(clicks, self.pointer.over_picture):
            self.parts.viewpoint.cameras.approach(clicks, self.pointer.beside_middle)

    def on_pointer(self, x: float | int, y: float | int) -> None:
        """The pointer moved, window units."""
        self._stir()
        self.panels.on_pointer(x, y)
        self.pointer.move(x, y)

    def on_button(self, button: int, down: bool) -> None:
        """A mouse button went down or up where the pointer is. On a minimised window there is nothing to press."""
        self._stir()
        if down and 0 in self.screen.size:
            return
        taken = self.panels.on_button(button, down, self.pointer.over_picture)
        if not down:
            self.pointer.release(button)
        elif not taken:
            self.pointer.press(button)

    def on_drop(self, paths: Sequence[str]) -> None:
        self._stir()
        for path in paths:
            self.parts.opening.ask(path)

    # -- one frame

    def advance(self, dt: float) -> None:
        """Let time pass for everything. A stall counts as LONGEST_STEP; a clock going backwards stands still."""
        step = self.parts.recorder.step
        dt = min(max(dt if step is None else step, 0.0), LONGEST_STEP)
        self._moved += dt
        self.parts.state.playback.advance(dt)
        self.parts.viewpoint.cameras.advance(dt)

    def draw(self, *, keep: bool = False) -> None:
        """One frame; `keep` reads it back. A minimised window (0 x 0) is not drawn."""
        size = self.screen.size
        if not (size[0] and size[1]):
            return
        self._open_asked()
        parts, last = self.parts, self.parts.state.last
        renew(parts)
        screen = self.screen.begin()
        for track in parts.state.playback.tracks:
            track.foot_lock = parts.look.effects.foot_lock
        last.poses = parts.posing.poses()
        self._draw_picture(screen)
        if parts.recorder.wants_picture:
            parts.recorder.take(self.screen.read(parts.state.layout.area))
        screen.use()
        self.panels.draw(screen, self.clock())
        if keep:
            last.image = self.screen.read((0, 0, *size))
        glfw.swap_buffers(self.screen.handle)
        parts.state.playback.drawn()
        now = self.clock()
        last.times.append(max(now - self._last_tick, 0.0))
        self._last_tick = now

    def _open_asked(self) -> None:
        """Open what was dropped or chosen; what cannot be is said, and what was shown stays."""
        asked, self.parts.opening.asked = self.parts.opening.asked, []
        for path in asked:
            try:
                done = self._open_scene(path) if kind_of(path) == "scene" else open_file(self.parts, path)
                if done:
                    self.parts.state.messages.say(f"{Path(path).name} opened")
                    keep_recent(path)
            except (AssetError, ValueError) as error:
                self.parts.state.messages.say(str(error))

    def _open_scene(self, path: str) -> bool:
        """Show a scene instead of what is shown, once all of it is open. Whether it is shown."""
        scene, old = read_scene(path), self.parts
        if any(entry.live is not None for entry in scene.avatars):
            raise AssetError(f"{path}: has live poses: selfscan play --scene {path}")
        if not old.posing.may_leave():
            return False
        stamps = None if old.opening.stamps is None else file_stamps(scene)
        show, panels, layout = opened_show(scene, opened_avatars(scene), (), stamps), self.panels, old.state.layout
        show.fit_orbit(layout.area[2:])
        self._begin(WindowParts(show, self.screen, self.clock, old.state.messages), panels=layout.panels_on)
        self._end(old, panels)
        if old.budget is not None and old.budget.controller is not None:
            self.parts.budget = self._budgeted(old.budget.budget)
        return True

    def _draw_picture(self, screen: moderngl.Framebuffer) -> None:
        """The avatars, and the source video where there is one."""
        parts, size = self.parts, self.screen.size
        area, viewpoint, look = parts.state.layout.area, parts.viewpoint, parts.look
        camera = parts.state.last.camera = viewpoint.camera().cropped(-area[0], -area[1], size)
        parts.state.last.poses = parts.state.playback.faced(parts.state.last.poses, camera.eye)
        began = self.clock()
        look.renderer.move(parts.state.last.poses, self._moved)
        look.renderer.draw_into(screen, parts.state.last.poses, camera, seconds=parts.state.playback.film_seconds)
        if parts.budget is not None:
            # the work itself, whatever the screen waits for
            self.screen.context.gl.finish()
            parts.budget.frame(1e3 * (self.clock() - began), filming=parts.recorder.film is not None)
        parts.prices.drawn(look, parts.state.last.poses, camera)
        if parts.wipe is not None:
            screen.use()
            frame = viewpoint.video_frame if viewpoint.shows_video else None
            parts.wipe.draw(frame, look.background.color[:3])

    # -- the loop

    def run(self, script: Sequence[str] | None = None, *, keep: bool = False) -> None:
        """Until closed or Ctrl-C, or through the words of a script."""
        waiting = None if script is None else steps(script)
        last = self.clock()
        with deferred_stop(patience=0) as stop:
            while not self._ends:
                stop.check()
                if waiting is not None:
                    if not waiting:
                        break
                    after = waiting.pop(0)(self)
                    self.advance(1 / RATE)
                    if callable(after):
                        after()
                else:
                    now = self.clock()
                    self.advance(now - last)
                    last = now
                self.draw(keep=keep)
                if waiting is None:
                    self._take_events(stop)
                else:
                    glfw.poll_events()

    def _take_events(self, stop: StopRequest) -> None:
        """Take what has happened. A window in which nothing moves sleeps, and draws nothing, until something does."""
        if 0 not in self.screen.size:
            self._answers = ANSWERS if self._moves() else self._answers - 1
            if self._answers > 0:
                glfw.poll_events()
                return
        began, shown = self.clock(), self.parts.state.messages.shown
        while True:
            before = self._stirred
            glfw.wait_events_timeout(STILL)
            stop.check()
            changed = self._stirred != before or self.parts.state.messages.shown != shown
            changed |= bool(self.parts.opening.due())
            # a tooltip waits for the pointer to rest, a text field blinks
            if changed or self.clock() - self._stirred < LINGER or self.panels.typing or self._ends:
                break
        # frames are timed by their work, not by the sleep before them
        self._last_tick += self.clock() - began

    @property
    def _ends(self) -> bool:
        return self.parts.closing or bool(glfw.window_should_close(self.screen.handle))

    def _moves(self) -> bool:
        """Whether the next frame differs from the last one even if no one touches the window."""
        parts = self.parts
        playback, line = parts.state.playback, parts.state.timeline
        return (
            (line.playing and (line.frames > 1 or parts.look.background.kind == "video"))
            or bool(playback.live)
            or playback.lives
            or parts.recorder.wants_picture
            or parts.prices.wanted
            or parts.viewpoint.cameras.kind == "turntable"
            or parts.look.renderer.moves
        )

    def close(self) -> None:
        """Write what is being filmed, free everything and close the window."""
        try:
            self._end(self.parts, self.panels)
        finally:
            self.screen.close()

    def _end(self, parts: WindowParts, panels: Panels) -> None:
        """Write what is being filmed, and free what was shown."""
        try:
            parts.recorder.close()
        finally:
            parts.state.playback.close()
            for thing in (panels, parts.wipe, parts.look.renderer):
                if thing is not None:
                    thing.release()


def play(
    show: Show,
    *,
    size: tuple[int, int],
    null: bool,
    panels: bool,
    script: Sequence[str] | None,
    screenshot: str | None,
    budget: float | None = None,
) -> int:
    """Open the window and run it. A script closes it at its end; a screenshot keeps the last frame shown."""
    if script is not None:
        steps(script)
    try:
        with deferred_stop(patience=0) as stop:
            window = Window(show, size=size, null=null, panels=panels, budget=budget)
    except BaseException:
        show.playback.close()
        # with the window, where there is one already
        glfw.terminate()
        raise
    try:
        stop.check()
        print(window.screen.context.attempts[-1])
        glfw.swap_interval(0 if script is not None else 1)
        window.run(script, keep=screenshot is not None)
        image = window.parts.state.last.image
        if screenshot is not None and image is not None:
            save_picture(Path(screenshot), image)
            print(f"{screenshot} written")
    finally:
        window.close()
    return 0
