"""What each key does in the window."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import glfw

from player.window.pose_tool import toggle_posing

if TYPE_CHECKING:
    from player.window.window import Window

NAMED = {
    "space": glfw.KEY_SPACE, ",": glfw.KEY_COMMA, ".": glfw.KEY_PERIOD, "left": glfw.KEY_LEFT,
    "right": glfw.KEY_RIGHT, "up": glfw.KEY_UP, "down": glfw.KEY_DOWN, "home": glfw.KEY_HOME, "end": glfw.KEY_END,
    "[": glfw.KEY_LEFT_BRACKET, "]": glfw.KEY_RIGHT_BRACKET, "-": glfw.KEY_MINUS, "=": glfw.KEY_EQUAL,
    "tab": glfw.KEY_TAB, "enter": glfw.KEY_ENTER, "escape": glfw.KEY_ESCAPE, "backspace": glfw.KEY_BACKSPACE,
    "delete": glfw.KEY_DELETE, "ctrl": glfw.KEY_LEFT_CONTROL, "shift": glfw.KEY_LEFT_SHIFT,
}  # fmt: skip
KEYS = NAMED | {letter: ord(letter.upper()) for letter in "abcdefghijklmnopqrstuvwxyz"}
KEYS |= {digit: ord(digit) for digit in "0123456789"}
HELP = (
    "space play/pause  , . step  arrows 1 s  [ ] speed  l loop  a b x range  c camera  r reset  f follow  "
    "v view  s shot  o film  p pose  g panels  q quit"
)
HELP_LIVE = "space pause  t T-pose in 3 s  c camera  r reset  f follow  v view  s shot  o film  g panels  q quit"
HELP_WALK = "first person: w a s d go  e q up down  drag looks  c next camera"
WALKING = {  # right, up, ahead
    glfw.KEY_W: (0, 0, 1), glfw.KEY_S: (0, 0, -1), glfw.KEY_A: (-1, 0, 0), glfw.KEY_D: (1, 0, 0),
    glfw.KEY_E: (0, 1, 0), glfw.KEY_Q: (0, -1, 0),
}  # fmt: skip


def quit_(window: "Window") -> None:
    window.closing = window.tool is None or window.tool.may_leave()


def toggle_follow(window: "Window") -> None:
    window.follow = not window.follow


def toggle_view(window: "Window") -> None:
    window.renderer.view_amount = 1.0 - window.renderer.view_amount


def toggle_help(window: "Window") -> None:
    window.help = not window.help


def toggle_panels(window: "Window") -> None:
    if window.panels is not None:
        window.panels.visible = not window.panels.visible


def shoot(window: "Window") -> None:
    window.shoot = True


def clear_range(window: "Window") -> None:
    window.timeline.set_a(None)
    window.timeline.set_b(None)


def ask_for_t_pose(window: "Window") -> None:
    for live, _ in window.playback.live:
        live.ask_for_t_pose()


def step(frames: int) -> Callable[["Window"], None]:
    return lambda window: window.timeline.step(frames)


def jump(seconds: float) -> Callable[["Window"], None]:
    def go(window: "Window") -> None:
        line = window.timeline
        line.seek(line.frame + round(seconds * line.rate))

    return go


def wipe(part: float) -> Callable[["Window"], None]:
    def move(window: "Window") -> None:
        if window.wipe is not None:
            window.wipe.move(window.wipe.part + part)

    return move


ACTIONS: dict[int, Callable[["Window"], None]] = {
    glfw.KEY_ESCAPE: quit_,
    glfw.KEY_Q: quit_,
    glfw.KEY_SPACE: lambda window: window.timeline.toggle(),
    glfw.KEY_COMMA: step(-1),
    glfw.KEY_PERIOD: step(1),
    glfw.KEY_LEFT: jump(-1.0),
    glfw.KEY_RIGHT: jump(1.0),
    glfw.KEY_HOME: lambda window: window.timeline.seek(0),
    glfw.KEY_END: lambda window: window.timeline.seek(window.timeline.frames - 1),
    glfw.KEY_LEFT_BRACKET: lambda window: window.timeline.faster(-1),
    glfw.KEY_RIGHT_BRACKET: lambda window: window.timeline.faster(1),
    glfw.KEY_L: lambda window: window.timeline.next_loop(),
    glfw.KEY_A: lambda window: window.timeline.set_a(window.timeline.frame),
    glfw.KEY_B: lambda window: window.timeline.set_b(window.timeline.frame),
    glfw.KEY_X: clear_range,
    glfw.KEY_C: lambda window: window.cameras.next(window.area_camera()),
    glfw.KEY_R: lambda window: window.cameras.orbit.reset(),
    glfw.KEY_F: toggle_follow,
    glfw.KEY_K: lambda window: window.add_key(),
    glfw.KEY_J: lambda window: window.save_path(),
    glfw.KEY_MINUS: wipe(-0.05),
    glfw.KEY_EQUAL: wipe(0.05),
    glfw.KEY_TAB: lambda window: window.select(window.selection.avatar + 1),
    glfw.KEY_V: toggle_view,
    glfw.KEY_H: toggle_help,
    glfw.KEY_G: toggle_panels,
    glfw.KEY_S: shoot,
    glfw.KEY_O: lambda window: window.toggle_film(),
    glfw.KEY_P: toggle_posing,
    glfw.KEY_T: ask_for_t_pose,
}
