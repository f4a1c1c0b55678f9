"""The window: one frame after the other, and what its keys and panels ask for.

What is shown is a `Show` (player/window/show.py); time is player/window/timeline.py, cameras player/cameras.py,
keys
player/window/keys.py, the mouse player/window/pointer.py, panels player/gui/. The same code runs without a display:
glfw's null platform with OSMesa, driven by a script (player/window/script.py) that calls what glfw calls.
"""

import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import glfw
import numpy as np
from jaxtyping import UInt8

from avatar.camera import Camera
from avatar.errors import AssetError
from avatar.skeleton import JOINTS
from player.cameras import WALK, moved_into
from player.context import Context
from player.passes.background import Background
from player.renderer import Pose, Renderer
from player.scenes.effects import Effects
from player.stop import Stop
from player.window.glfw_window import ScreenReader, open_window, window_context
from player.window.keys import ACTIONS, HELP, HELP_LIVE, HELP_WALK, WALKING
from player.window.overlay import TextLine
from player.window.pick import Picked, pick
from player.window.picture import PictureLayer
from player.window.pointer import Pointer, Tool
from player.window.recorder import Recorder, free_name, save_picture
from player.window.script import RATE, steps
from player.window.show import Show
from player.window.timeline import LONGEST_STEP, Timeline
from player.window.wipe import Wipe

if TYPE_CHECKING:
    from player.gui.panels import Panels
    from player.pose.session import PoseSession

# left, top, width, height, pixels of the framebuffer
Area = tuple[int, int, int, int]
NOTED = 5.0  # seconds that a message stays


class Selection(NamedTuple):
    """The avatar that panels are about, and its joint that was clicked."""

    avatar: int = 0
    joint: int | None = None


class Window:
    """The window with everything in it. `run` returns when it is closed or the script has ended."""

    def __init__(
        self,
        show: Show,
        *,
        size: tuple[int, int],
        null: bool = False,
        gui: bool = True,
        clock: Callable[[], float] = time.perf_counter,
    ):
        self.show, self.playback, self.cameras, self.clock = show, show.playback, show.cameras, clock
        self.handle = open_window(size, null)
        self.context: Context = window_context(self.handle, null)
        self.effects, self.background, self.level = show.effects, show.background, 0
        self.renderer = self.new_renderer(show.effects, show.background, 0)
        self.wipe = Wipe(self.context, show.capture) if show.capture else None
        self.text, self.screen_reader = TextLine(self.context), ScreenReader(self.context)
        self.backdrop = PictureLayer(self.context)
        # posing by hand: the avatar `posed` has the session's pose, in the world, instead of its motion's
        self.pose_session: PoseSession | None = None
        self.posed = 0
        self.panels: Panels | None = open_panels(self.context, self.handle) if gui else None
        self.show.fit_orbit(self.area()[2:])
        self.pointer, self.held = Pointer(self), set[int]()
        # what keys and panels change
        self.selection = Selection()
        self.follow, self.help, self.shoot, self.closing = show.follow, False, False, False
        self.film: Recorder | None = None
        # takes drags over the picture before the camera does
        self.tool: Tool | None = None
        self.message, self.message_until = "", 0.0
        # the last frame
        self.drawn_size = (0, 0)
        self.poses: list[Pose] = self.playback.poses()
        self.start = self.poses[0][1]
        self.camera: Camera | None = None
        self.image: UInt8[np.ndarray, "height width 4"] | None = None
        self.frame_times: deque[float] = deque(maxlen=120)  # seconds, of whole frames
        self.last_tick = clock()
        glfw.set_key_callback(self.handle, lambda _w, key, _s, action, _m: self.on_key(key, bool(action)))
        glfw.set_char_callback(self.handle, lambda _w, letter: self.on_text(letter))
        glfw.set_scroll_callback(self.handle, lambda _w, _dx, dy: self.on_wheel(dy))
        glfw.set_cursor_pos_callback(self.handle, lambda _w, x, y: self.on_pointer(x, y))
        glfw.set_mouse_button_callback(self.handle, lambda _w, button, action, _m: self.on_button(button, bool(action)))

    @property
    def timeline(self) -> Timeline:
        return self.playback.timeline

    # -- events; a script calls the same

    def on_key(self, key: int, down: bool) -> None:
        """A key went down (or repeats), or up."""
        if self.tool is not None and not down:
            # also when it was let go over a panel's text field
            self.tool.key(key, False)
        if self.panels is not None and self.panels.on_key(key, down):
            return
        if self.tool is not None and down and self.tool.key(key, True):
            return
        if not down:
            self.held.discard(key)
        elif self.cameras.kind == "walk" and key in WALKING:
            self.held.add(key)
        elif key in ACTIONS:
            ACTIONS[key](self)

    def on_text(self, letter: int) -> None:
        if self.panels is not None:
            self.panels.on_text(letter)

    def on_wheel(self, clicks: float | int) -> None:
        if self.panels is None or not self.panels.on_wheel(clicks, self.over_picture()):
            self.cameras.approach(clicks)

    def on_pointer(self, x: float | int, y: float | int) -> None:
        """The pointer moved, window units."""
        if self.panels is not None:
            self.panels.on_pointer(x, y)
        self.pointer.move(x, y)

    def on_button(self, button: int, down: bool) -> None:
        """A mouse button went down or up where the pointer is. On a minimised window there is nothing to press."""
        if down and 0 in glfw.get_framebuffer_size(self.handle):
            return
        taken = self.panels is not None and self.panels.on_button(button, down, self.over_picture())
        if not down:
            self.pointer.release(button)
        elif not taken:
            self.pointer.press(button)

    # -- what keys and panels ask for

    def say(self, message: str) -> None:
        """Print a message, and show it for some seconds."""
        print(message)
        self.message, self.message_until = message, self.clock() + NOTED

    def pick_at(self, x: float | int, y: float | int) -> Picked | None:
        """Select the avatar and joint under a pixel; beside them the joint is let go."""
        if self.camera is None or (self.tool is not None and self.tool.pick(x, y)):
            return None
        levels = [avatar.level(self.level) for avatar in self.show.avatars]
        found = pick(self.show.avatars, levels, self.poses, self.camera, (x, y))
        self.selection = Selection(found.avatar, found.joint) if found else self.selection._replace(joint=None)
        return found

    def select(self, avatar: int, joint: int | None = None) -> None:
        self.selection = Selection(avatar % len(self.show.avatars), joint)

    def add_key(self) -> None:
        """Record the camera of now as a key of the path."""
        self.cameras.add_key(self.timeline.seconds, self.area_camera())
        count = len(self.cameras.keys)
        self.say(f"camera key {count} at {self.timeline.seconds:.2f} s; j saves the path")

    def save_path(self) -> None:
        if not self.cameras.keys or self.cameras.path is None:
            self.say("no camera keys yet: k records one")
            return
        name = free_name("selfscan-path", ".json")
        self.cameras.path.write(name)
        self.say(f"{name} written: {len(self.cameras.keys)} keys")

    def toggle_film(self) -> None:
        """Start a film, or write the one that runs."""
        if self.film is not None:
            film, self.film = self.film, None
            self.say(film.close())
            return
        rate = 30.0 if self.playback.live else self.timeline.rate
        self.film = Recorder(free_name("selfscan", ".mp4"), rate, live=bool(self.playback.live))
        self.say(f"filming {self.film.path}; o ends it")

    def draw_otherwise(
        self,
        *,
        effects: Effects | None = None,
        background: Background | None = None,
        level: int | None = None,
    ) -> None:
        """Draw with other effects, background or level of detail; where that cannot be,
        it is said and nothing changes.
        """
        effects, background = effects or self.effects, background or self.background
        try:
            if level is not None and level != self.level:
                new = self.new_renderer(effects, background, level)
                new.view_amount = self.renderer.view_amount
                self.renderer.release()
                self.renderer, self.level = new, level
            else:
                self.renderer.change(effects=effects, background=self.behind(background))
        except (ValueError, AssetError) as error:
            self.say(str(error))
            return
        self.effects, self.background = effects, background

    def new_renderer(self, effects: Effects, background: Background, level: int) -> Renderer:
        return Renderer(
            self.context,
            self.show.avatars,
            None,
            effects=effects,
            background=self.behind(background),
            level=level,
        )

    def behind(self, background: Background) -> Background:
        """What the renderer draws first. Where a capture's video may lie behind, the background comes last,
        under all.
        """
        return background if self.show.capture is None else Background("transparent")

    # -- places

    def size_in_units(self) -> tuple[int, int]:
        """The window as the pointer counts it; on screens of high density a unit is several pixels."""
        return glfw.get_window_size(self.handle)

    def pixel(self, x: float | int, y: float | int) -> tuple[float, float]:
        """Window units as pixels of the framebuffer."""
        wide, high = self.size_in_units()
        across, down = glfw.get_framebuffer_size(self.handle)
        return x * across / max(wide, 1), y * down / max(high, 1)

    def area(self) -> Area:
        """Where the picture is free of panels."""
        size = glfw.get_framebuffer_size(self.handle)
        return (0, 0, *size) if self.panels is None else self.panels.area(self, size)

    def over_picture(self) -> bool:
        """Whether the pointer is where the picture is free of panels."""
        x, y = self.pixel(*self.pointer.at)
        left, top, width, height = self.area()
        return left <= x < left + width and top <= y < top + height

    def area_camera(self) -> Camera:
        """What is looked through now, for the free area."""
        _, _, width, height = self.area()
        along = (self.poses[0][1] - self.start) * [1.0, 0.0, 1.0] if self.follow else None
        size = (max(width, 1), max(height, 1))
        return self.cameras.camera(size, self.timeline.seconds, self.video_frame(), along)

    def video_frame(self) -> int:
        """The frame of the capture's video that belongs to now."""
        capture = self.show.capture
        if capture is None:
            return 0
        return min(int(self.timeline.seconds * capture.rate + 1e-6), len(capture.images) - 1)

    @property
    def shows_video(self) -> bool:
        return self.wipe is not None and self.cameras.kind == "capture"

    # -- one frame

    def advance(self, dt: float) -> None:
        """Let time pass for everything. A stall counts as LONGEST_STEP; a clock going backwards stands still."""
        if self.film is not None and self.film.step is not None:
            dt = self.film.step
        dt = min(max(dt, 0.0), LONGEST_STEP)
        self.playback.advance(dt)
        self.cameras.advance(dt)
        for key in self.held & WALKING.keys():
            self.cameras.walk.go(*(WALK * dt * way for way in WALKING[key]))

    def shown_poses(self) -> list[Pose]:
        """The poses of now; the avatar that is posed by hand has its hand-made one."""
        if self.tool is not None:
            self.tool.follow_timeline()
        poses = self.playback.poses()
        if self.pose_session is not None:
            pose = self.pose_session.pose
            poses[self.posed] = (pose.axis_angle, pose.root)
        return poses

    def draw(self, *, keep: bool = False) -> None:
        """One frame. A minimised window (0 x 0) is not drawn."""
        size = glfw.get_framebuffer_size(self.handle)
        if not (size[0] and size[1]):
            return
        # OSMesa takes the window's memory when it is made current
        if size != self.drawn_size:
            glfw.make_context_current(self.handle)
            self.drawn_size = size
        screen = self.context.screen()
        self.poses = self.shown_poses()
        area = self.area()
        self.camera = moved_into(self.area_camera(), area, size)
        self.renderer.draw_into(screen, self.poses, self.camera, seconds=self.timeline.seconds)
        if self.wipe is not None:
            screen.use()
            if self.shows_video:
                self.wipe.draw(self.video_frame(), area, size, self.background.color[:3])
            self.backdrop.fill(self.background.color[:3], (0, 0, *size), size, under=True)
        if self.shoot or self.film is not None:
            self.take(self.screen_reader.read(area, size))
        screen.use()
        if self.panels is not None:
            self.panels.draw(self, screen, size)
        if self.panels is None or not self.panels.drawn:
            self.text.draw(self.line(), size)
        if keep:
            self.image = self.screen_reader.read((0, 0, *size), size)
        glfw.swap_buffers(self.handle)
        self.playback.drawn()
        now = self.clock()
        self.frame_times.append(max(now - self.last_tick, 0.0))
        self.last_tick = now

    def take(self, image: UInt8[np.ndarray, "height width 4"]) -> None:
        """A screenshot and the film, of what is drawn so far."""
        if self.film is not None and not self.film.add(image, self.clock()):
            self.toggle_film()
            self.say("the picture has another size now: the film ends here")
        if self.shoot:
            self.shoot = False
            name = free_name("selfscan", ".png")
            save_picture(name, image)
            self.say(f"{name} written")

    @property
    def frames_per_second(self) -> float:
        spent = sum(self.frame_times)
        return len(self.frame_times) / spent if spent > 0 else 0.0

    def line(self) -> str:
        """The line of text: a message, the keys, or frames per second, where the playback is, view and selection."""
        if self.clock() < self.message_until:
            return self.message
        if self.help:
            return HELP_WALK if self.cameras.kind == "walk" else HELP_LIVE if self.playback.live else HELP
        view = f"view {'on' if self.renderer.view_amount else 'off'}" if self.renderer.has_view else "paper mode"
        parts = [f"{self.frames_per_second:.0f} fps", self.playback.status(), view]
        if self.cameras.kind != "orbit":
            parts.append(self.cameras.kind)
        if self.film is not None:
            parts.append(f"filming {self.film.frames}")
        if self.selection != Selection():
            parts.append(self.selected())
        return "  ".join([*parts, "h: keys"])

    def selected(self) -> str:
        """The name of what is selected."""
        avatar, joint = self.selection
        name = self.show.names[avatar]
        return name if joint is None else f"{name}: {JOINTS[joint]}"

    # -- the loop

    def run(self, script: Sequence[str] | None = None, *, keep: bool = False) -> None:
        """Until closed or Ctrl-C, or through the words of a script."""
        waiting = None if script is None else steps(script)
        last = self.clock()
        with Stop() as stop:
            while not (self.closing or glfw.window_should_close(self.handle)):
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
                glfw.poll_events()
                if waiting is None and 0 in glfw.get_framebuffer_size(self.handle):
                    glfw.wait_events_timeout(0.1)

    def close(self) -> None:
        """Write what is being filmed, free everything and close the window."""
        try:
            if self.film is not None:
                self.toggle_film()
        finally:
            self.playback.close()
            for thing in (self.panels, self.wipe, self.backdrop, self.text, self.renderer, self.context):
                if thing is not None:
                    thing.release()
            glfw.destroy_window(self.handle)
            glfw.terminate()


def open_panels(context: Context, handle: Any) -> "Panels | None":
    """The panels, or None where imgui-bundle is not installed: then there are the keys and the line of text."""
    try:
        from player.gui.panels import Panels
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "imgui_bundle":
            raise
        return None
    return Panels(context, handle)


def play(
    show: Show,
    *,
    size: tuple[int, int],
    null: bool,
    gui: bool,
    script: Sequence[str] | None,
    screenshot: str | None,
) -> int:
    """Open the window and run it. A script closes it at its end; a screenshot keeps the last frame shown."""
    if script is not None:
        steps(script)
    try:
        window = Window(show, size=size, null=null, gui=gui)
    except BaseException:
        show.playback.close()
        # with the window, where there is one already
        glfw.terminate()
        raise
    try:
        print(window.context.attempts[-1])
        glfw.swap_interval(0 if script is not None else 1)
        window.run(script, keep=screenshot is not None)
        if screenshot is not None and window.image is not None:
            save_picture(Path(screenshot), window.image)
            print(f"{screenshot} written")
    finally:
        window.close()
    return 0
