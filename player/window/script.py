"""A script that drives the window: words, each a frame or a few, at a fixed 30 frames a second.

    space . right    keys by name, pressed and let go        click:X:Y[:BUTTON]    press and let go, window units
    wait             a frame goes by                         drag:X:Y:X2:Y2[:BUTTON]
    pose             wait for a live pose                    move:X:Y              the pointer alone
    scrub:SECONDS    show that moment                        press:NAME            click a widget by its name
    turn:DX:DY       turn the camera                         type:TEXT             letters into a field (_ is a space)
    near:CLICKS      the wheel, over the picture             wheel:CLICKS          the wheel, where the pointer is
    size:W:H         resize the window                       down:KEY up:KEY       hold a key
    drop:FILE        a file is dropped on the window

So what a test sees does not depend on the machine's speed.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import glfw

from player.window.keyboard import KEYS

if TYPE_CHECKING:
    from player.window.window import Window

RATE = 30.0
DRAG_FRAMES = 4
# what it gives back, if it can be called, is done after the frame's time
Step = Callable[["Window"], object]


def steps(script: Sequence[str]) -> list[Step]:
    """What to do before each frame.

    Raises:
        ValueError: a word that is no key and no gesture.
    """
    return [step for word in script for step in _steps(word)]


def _steps(word: str) -> list[Step]:
    name, _, rest = word.partition(":")
    if word in KEYS:
        return [lambda window: _tap(window, KEYS[word])]
    if word == "wait":
        return [lambda _window: None]
    if word == "pose":
        return [lambda window: _wait_for_pose(window)]
    if name == "press" and rest:
        return [lambda window: _aim(window, rest.replace("_", " ")), *_pressed(0)]
    if name == "type" and rest:
        return [lambda window, letter=letter: window.on_text(ord(letter)) for letter in rest.replace("_", " ")]
    if name == "drop" and rest:
        return [lambda window: window.on_drop([rest])]
    if name in ("down", "up") and rest in KEYS:
        return [lambda window: window.on_key(KEYS[rest], name == "down")]
    try:
        numbers = [float(value) for value in rest.split(":")]
    except ValueError:
        numbers = []
    gesture, counts = GESTURES.get(name, (None, ()))
    if gesture is None or len(numbers) not in counts:
        known = "wait, pose, turn:DX:DY, near:N, size:W:H, click:X:Y, drag:X:Y:X2:Y2, scrub:SECONDS, press:NAME"
        raise ValueError(f"script: {word!r} is no key; there are {', '.join(KEYS)}, {known}")
    return gesture(*numbers)


def _wait_for_pose(window: "Window") -> None:
    for live, _ in window.parts.state.playback.live:
        live.wait_for_pose()


def _tap(window: "Window", key: int) -> Callable[[], None]:
    window.on_key(key, True)
    return lambda: window.on_key(key, False)


def _aim(window: "Window", name: str) -> None:
    """Move the pointer to the middle of a widget that was drawn in the last frame."""
    places = window.panels.places
    if name not in places:
        raise ValueError(f"script: no widget {name!r} is shown; there are {', '.join(places) or 'none'}")
    window.on_pointer(*places[name])


def _pressed(button: float | int) -> list[Step]:
    """A button of the mouse goes down in one frame and up in another."""
    return [lambda window: window.on_button(int(button), True), lambda window: window.on_button(int(button), False)]


def _drag(x0: float, y0: float, x1: float, y1: float, button: float | int = 0) -> list[Step]:
    down, up = _pressed(button)
    out: list[Step] = [lambda window: window.on_pointer(x0, y0), down]
    for k in range(1, DRAG_FRAMES + 1):
        part = k / DRAG_FRAMES
        out.append(lambda window, part=part: window.on_pointer(x0 + part * (x1 - x0), y0 + part * (y1 - y0)))
    return [*out, up]


# what is done by numbers, and how many of them there may be
GESTURES: dict[str, tuple[Callable[..., list[Step]], tuple[int, ...]]] = {
    "click": (lambda x, y, button=0: [lambda window: window.on_pointer(x, y), *_pressed(button)], (2, 3)),
    "drag": (_drag, (4, 5)),
    "move": (lambda x, y: [lambda window: window.on_pointer(x, y)], (2,)),
    "scrub": (lambda seconds: [lambda window: window.parts.state.timeline.scrub(seconds)], (1,)),
    "turn": (lambda dx, dy: [lambda window: window.parts.viewpoint.cameras.turn(dx, dy)], (2,)),
    "near": (lambda clicks: [lambda window: window.parts.viewpoint.cameras.approach(clicks)], (1,)),
    "wheel": (lambda clicks: [lambda window: window.on_wheel(clicks)], (1,)),
    "size": (lambda w, h: [lambda window: glfw.set_window_size(window.screen.handle, int(w), int(h))], (2,)),
}
