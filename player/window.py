"""The window: an avatar to orbit, play, pause, step and scrub.

The same code runs without a display: glfw's null platform with OSMesa. A script of keys then drives it, one key
a frame at a fixed 30 frames a second, so that what a test sees does not depend on the machine's speed.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import glfw
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from avatar.baked_avatar import Avatar
from avatar.camera import Camera, look_at, pinhole
from avatar.errors import AssetError
from avatar.files import whole_file
from avatar.motion import Clip, Motion
from player.context import Context, wrap_context
from player.framing import ELEVATION, FOV, extent, facing, fitted_camera
from player.live.playback import LivePlayback
from player.overlay import TextLine
from player.renderer import Pose, Renderer

KEYS = {
    "space": glfw.KEY_SPACE, ",": glfw.KEY_COMMA, ".": glfw.KEY_PERIOD, "left": glfw.KEY_LEFT,
    "right": glfw.KEY_RIGHT, "home": glfw.KEY_HOME, "end": glfw.KEY_END, "r": glfw.KEY_R, "v": glfw.KEY_V,
    "s": glfw.KEY_S, "t": glfw.KEY_T,
    "f": glfw.KEY_F, "h": glfw.KEY_H, "q": glfw.KEY_Q,
}  # fmt: skip
HELP = "space play/pause  , . step  arrows 1 s  home end  r camera  f follow  v view  s shot  q quit"
HELP_LIVE = "space pause  t T-pose in 3 s  r camera  f follow  v view  s shot  q quit"
SCRIPT_RATE = 30.0
BLOCK = 256
LONGEST_STEP = 0.25  # seconds; after a stall the clip goes on where it was


class Orbit:
    """A camera round a point, turned and brought nearer by hand."""

    def __init__(self, target: Float[np.ndarray, "3"], distance: float, azimuth: float):
        self.home = (np.array(target, np.float64), distance, azimuth, ELEVATION)
        self.reset()

    def reset(self) -> None:
        target, self.distance, self.azimuth, self.elevation = self.home
        self.target = target.copy()

    def turn(self, dx: float, dy: float) -> None:
        """Drag by pixels: half a degree each; never over the poles."""
        self.azimuth -= np.radians(0.5 * dx)
        self.elevation = float(np.clip(self.elevation + np.radians(0.5 * dy), -1.5, 1.5))

    def shift(self, dx: float, dy: float, height: int) -> None:
        """Move the target in the image plane, so that it follows the pointer."""
        right, down = self.camera((1, 1)).camera_from_world[:2, :3]
        metres = 2 * self.distance * np.tan(FOV / 2) / max(height, 1)
        self.target -= metres * (dx * right + dy * down)

    def approach(self, clicks: float) -> None:
        nearer = 0.9 ** float(np.clip(clicks, -100, 100))
        self.distance = float(np.clip(self.distance * nearer, 0.05, 1000.0))

    def camera(self, size: tuple[int, int], along: Float[np.ndarray, "3"] | None = None) -> Camera:
        """The camera, moved along with the avatar by `along`, metres."""
        flat = np.cos(self.elevation)
        away = np.array([np.sin(self.azimuth) * flat, np.sin(self.elevation), np.cos(self.azimuth) * flat])
        target = self.target if along is None else self.target + along
        return Camera(pinhole(size, FOV), look_at(target + self.distance * away, target), size)


class Playback:
    """Which frame of the motion is shown, and its poses, read in blocks."""

    def __init__(
        self, motion: Motion, clips: Sequence[Callable[[int, int], Clip]], beside: Sequence[np.ndarray]
    ):
        self.motion, self.clips, self.beside = motion, clips, beside
        self.seconds, self.playing = 0.0, True
        self.first, self.blocks = 0, [clip(0, min(BLOCK, motion.frames)) for clip in clips]

    @property
    def frame(self) -> int:
        return min(int(self.seconds * self.motion.rate + 1e-6), self.motion.frames - 1)

    def advance(self, dt: float) -> None:
        """Let time pass; the clip starts over at its end. A clock that goes backwards stands still."""
        if self.playing:
            self.seconds = (self.seconds + min(max(dt, 0.0), LONGEST_STEP)) % (
                self.motion.frames / self.motion.rate
            )

    def seek(self, frame: int) -> None:
        self.seconds = (min(max(frame, 0), self.motion.frames - 1) + 0.5) / self.motion.rate

    def poses(self) -> list[Pose]:
        frame = self.frame
        if not self.first <= frame < self.first + len(self.blocks[0].root):
            self.first = frame - frame % BLOCK
            self.blocks = [
                clip(self.first, min(self.first + BLOCK, self.motion.frames)) for clip in self.clips
            ]
        i = frame - self.first
        return [(b.axis_angle[i], b.root[i] + at) for b, at in zip(self.blocks, self.beside, strict=True)]

    def status(self) -> str:
        """Frame and time, in one line."""
        state = "" if self.playing else "  paused"
        return f"frame {self.frame}/{self.motion.frames}  {self.frame / self.motion.rate:.1f} s{state}"


class Window:
    """The window with everything in it. `run` returns when it is closed or the script has ended."""

    def __init__(
        self,
        avatars: Sequence[Avatar],
        playback: Playback | LivePlayback,
        orbit: Orbit,
        *,
        size: tuple[int, int],
        view: str,
        background: Sequence[float],
        null: bool,
    ):
        self.playback, self.orbit = playback, orbit
        self.start = playback.poses()[0][1]
        self.handle = open_window(size, null)
        self.context: Context = wrap_context(
            window_function,
            lambda: glfw.make_context_current(self.handle),
            "glfw null + OSMesa" if null else "window",
        )
        self.renderer = Renderer(self.context, avatars, None, view=view, background=background)
        self.text = TextLine(self.context)
        self.follow = False
        self.help, self.shoot, self.shots, self.closing = False, False, 0, False
        self.pointer: tuple[float, float] | None = None
        self.image: UInt8[np.ndarray, "height width 3"] | None = None
        self.shown_rate, self.rate_frames, self.rate_began = 0.0, 0, time.perf_counter()
        self.has_view = any(
            p.variant and dict(p.variant.defines)["VIEW_STAGE"] for p in self.renderer.plan.passes
        )
        glfw.set_key_callback(self.handle, lambda _w, key, _s, action, _m: self.key(key) if action else None)
        glfw.set_scroll_callback(self.handle, lambda _w, _dx, dy: self.orbit.approach(dy))
        glfw.set_cursor_pos_callback(self.handle, lambda _w, x, y: self.move(x, y))

    def key(self, key: int) -> None:
        """What a key does. Unknown keys do nothing."""
        playback = self.playback
        if key in (glfw.KEY_Q, glfw.KEY_ESCAPE):
            self.closing = True
        elif key == glfw.KEY_SPACE:
            playback.playing = not playback.playing
        elif key in (glfw.KEY_COMMA, glfw.KEY_PERIOD):
            playback.playing = False
            playback.seek(playback.frame + (1 if key == glfw.KEY_PERIOD else -1))
        elif key in (glfw.KEY_LEFT, glfw.KEY_RIGHT):
            second = round(playback.motion.rate)
            playback.seek(playback.frame + (second if key == glfw.KEY_RIGHT else -second))
        elif key == glfw.KEY_HOME:
            playback.seek(0)
        elif key == glfw.KEY_END:
            playback.seek(playback.motion.frames - 1)
        elif key == glfw.KEY_R:
            self.orbit.reset()
        elif key == glfw.KEY_F:
            self.follow = not self.follow
        elif key == glfw.KEY_V:
            self.renderer.view_amount = 1.0 - self.renderer.view_amount
        elif key == glfw.KEY_H:
            self.help = not self.help
        elif key == glfw.KEY_S:
            self.shoot = True
        elif key == glfw.KEY_T and isinstance(playback, LivePlayback):
            playback.ask_for_t_pose()

    def move(self, x: float, y: float) -> None:
        """Pointer moved: left button turns, right or middle shifts."""
        last, self.pointer = self.pointer, (x, y)
        if last is None:
            return
        dx, dy = x - last[0], y - last[1]
        buttons = [glfw.get_mouse_button(self.handle, button) == glfw.PRESS for button in range(3)]
        if buttons[0]:
            self.orbit.turn(dx, dy)
        elif buttons[1] or buttons[2]:
            self.orbit.shift(dx, dy, glfw.get_window_size(self.handle)[1])

    def draw(self, *, keep: bool) -> None:
        """One frame. A minimised window (0 x 0) is not drawn."""
        size = glfw.get_framebuffer_size(self.handle)
        if not (size[0] and size[1]):
            return
        screen = self.context.screen()
        poses = self.playback.poses()
        along = (poses[0][1] - self.start) * [1.0, 0.0, 1.0] if self.follow else np.zeros(3)
        self.renderer.draw_into(screen, poses, self.orbit.camera(size, along))
        self.text.draw(self.line(), size)
        if keep or self.shoot:
            raw = np.frombuffer(screen.read(viewport=(0, 0, *size), components=3, alignment=1), np.uint8)
            self.image = np.ascontiguousarray(raw.reshape(size[1], size[0], 3)[::-1])
            if self.shoot:
                name = Path(f"selfscan-{self.shots:03d}.png")
                save(name, self.image)
                print(f"{name} written")
                self.shoot, self.shots = False, self.shots + 1
        glfw.swap_buffers(self.handle)
        if isinstance(self.playback, LivePlayback):
            self.playback.drawn()
        self.rate_frames += 1
        now = time.perf_counter()
        if now - self.rate_began > 0.5:
            self.shown_rate = self.rate_frames / (now - self.rate_began)
            self.rate_frames, self.rate_began = 0, now

    def line(self) -> str:
        """The line of text: frames per second, where the playback is, view, or the keys."""
        if self.help:
            return HELP_LIVE if isinstance(self.playback, LivePlayback) else HELP
        view = f"  view {'on' if self.renderer.view_amount else 'off'}" if self.has_view else "  paper mode"
        return f"{self.shown_rate:.0f} fps  {self.playback.status()}{view}  h: keys"

    def run(self, script: Sequence[str] | None, *, keep: bool) -> None:
        """Until closed, or one key of the script a frame."""
        last = time.perf_counter()
        steps = list(script) if script is not None else None
        while not (self.closing or glfw.window_should_close(self.handle)):
            if steps is not None:
                if not steps:
                    break
                self.press(steps.pop(0))
                self.playback.advance(1 / SCRIPT_RATE)
            else:
                now = time.perf_counter()
                self.playback.advance(now - last)
                last = now
            self.draw(keep=keep)
            glfw.poll_events()
            if 0 in glfw.get_framebuffer_size(self.handle):
                glfw.wait_events_timeout(0.1)

    def press(self, word: str) -> None:
        """A word of a script: a key, `wait`, `turn:DX:DY`, `near:CLICKS`, `size:W:H`; `pose`: until a live one comes."""
        name, *values = word.split(":")
        numbers = [float(value) for value in values]
        if name == "turn":
            self.orbit.turn(*numbers)
        elif name == "near":
            self.orbit.approach(*numbers)
        elif name == "size":
            glfw.set_window_size(self.handle, int(numbers[0]), int(numbers[1]))
        elif word == "pose":
            if isinstance(self.playback, LivePlayback):
                self.playback.wait_for_pose()
        elif word != "wait":
            self.key(KEYS[word])

    def close(self) -> None:
        self.text.release()
        self.renderer.release()
        self.context.release()
        glfw.destroy_window(self.handle)
        glfw.terminate()


def open_window(size: tuple[int, int], null: bool):
    """A glfw window with an OpenGL 3.3 core context, current.

    Raises:
        AssetError: there is no display, or the driver has no OpenGL 3.3.
    """
    reasons: list[str] = []

    def note(_code: int, text: Any) -> None:
        reasons.append(text.decode("utf-8", "replace"))

    glfw.set_error_callback(note)
    glfw.init_hint(glfw.PLATFORM, glfw.PLATFORM_NULL if null else glfw.ANY_PLATFORM)
    if not glfw.init():
        raise AssetError(f"no window: {'; '.join(reasons) or 'no display'}; `selfscan render` needs none")
    glfw.default_window_hints()
    glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, 3)
    glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, 3)
    glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
    if null:
        glfw.window_hint(glfw.CONTEXT_CREATION_API, glfw.OSMESA_CONTEXT_API)
    else:
        glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)  # macOS asks for it; glfw's OSMesa refuses it
    window = glfw.create_window(*size, "selfscan", None, None)
    if not window:
        glfw.terminate()
        raise AssetError(f"no window: {'; '.join(reasons) or 'unknown reason'}; `selfscan doctor` tells more")
    glfw.make_context_current(window)
    return window


def window_function(name: str) -> int:
    """Address of a GL function in the current window's context."""
    address: Any = glfw.get_proc_address(name)
    return address or 0


def save(path: Path, image: UInt8[np.ndarray, "height width 3"]) -> None:
    with whole_file(path) as file:
        Image.fromarray(image).save(file, "PNG", compress_level=1)


def play(
    avatars: Sequence[Avatar],
    motion: Motion,
    clips: Sequence[Callable[[int, int], Clip]],
    *,
    size: tuple[int, int],
    view: str,
    background: Sequence[float],
    null: bool,
    beside: Sequence[np.ndarray],
    script: Sequence[str] | None,
    screenshot: str | None,
    live: LivePlayback | None = None,
) -> int:
    """Open the window and run it. A script closes it at its end; a screenshot keeps the last frame shown.

    With `live` the clips only say where the avatars stand until poses come.
    """
    if script is not None:
        check_script(script)
    points = [
        extent(avatar, clip(0, min(BLOCK, motion.frames))) + at
        for avatar, clip, at in zip(avatars, clips, beside, strict=True)
    ]
    everything = np.concatenate(points)
    azimuth = facing(clips[0](0, 1).axis_angle[0], avatars[0].joint_positions.astype(np.float64))
    camera = fitted_camera(everything, azimuth, size)
    target = 0.5 * (everything.min(0) + everything.max(0))
    orbit = Orbit(target, float(np.linalg.norm(camera.eye - target)), azimuth)
    window = Window(
        avatars,
        live or Playback(motion, clips, beside),
        orbit,
        size=size,
        view=view,
        background=background,
        null=null,
    )
    try:
        print(window.context.attempts[-1])
        glfw.swap_interval(0 if script is not None else 1)
        window.run(script, keep=screenshot is not None)
        if screenshot is not None and window.image is not None:
            save(Path(screenshot), window.image)
            print(f"{screenshot} written")
    finally:
        window.close()
    return 0


def check_script(script: Sequence[str]) -> None:
    """Refuse words that no key or gesture has.

    Raises:
        ValueError: an unknown word.
    """
    counts = {"turn": 2, "near": 1, "size": 2}
    for word in script:
        name, *values = word.split(":")
        if word in KEYS or word in ("wait", "pose"):
            continue
        try:
            known = counts.get(name) == len([float(value) for value in values])
        except ValueError:
            known = False
        if not known:
            raise ValueError(
                f"script: {word!r} is no key; there are wait, pose, {', '.join(KEYS)}, turn:DX:DY, near:N, size:W:H"
            )
