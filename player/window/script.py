"""A script that drives the window: words, each a frame or a few, at a fixed 30 frames a second.

    space . right    keys by name, pressed and let go        click:X:Y[:BUTTON]    press and let go, window units
    wait             a frame goes by                         drag:X:Y:X2:Y2[:BUTTON]
    pose             wait for a live pose                    move:X:Y              the pointer alone
    scrub:SECONDS    show that moment                        press:NAME            click a widget by its name
    turn:DX:DY       turn the camera                         type:TEXT             letters into a field (_ is a space)
    near:CLICKS      the wheel, over the picture             wheel:CLICKS          the wheel, where the pointer is
    size:W:H         resize the window                       down:KEY up:KEY       hold a key

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
NUMBERS = {"click": (2, 3), "drag": (4, 5), "move": (2,), "scrub": (1,), "turn": (2,), "near": (1,), "wheel": (1,),
           "size": (2,)}  # fmt: skip
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
        rest = rest.replace("_", " ")
        return [lambda window: _aim(window, rest), lambda window: window.on_button(0, True),
                lambda window: window.on_button(0, False)]  # fmt: skip
    if name == "type" and rest:
        return [lambda window, letter=letter: window.on_text(ord(letter)) for letter in rest.replace("_", " ")]
    if name in ("down", "up") and rest in KEYS:
        return [lambda window: window.on_key(KEYS[rest], name == "down")]
    try:
        numbers = [float(value) for value in rest.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) not in NUMBERS.get(name, ()):
        known = "wait, pose, turn:DX:DY, near:N, size:W:H, click:X:Y, drag:X:Y:X2:Y2, scrub:SECONDS, press:NAME"
        raise ValueError(f"script: {word!r} is no key; there are {', '.join(KEYS)}, {known}")
    if name == "click":
        button = int(numbers[2]) if len(numbers) > 2 else 0
        return [lambda window: window.on_pointer(*numbers[:2]), lambda window: window.on_button(button, True),
                lambda window: window.on_button(button, False)]  # fmt: skip
    if name == "drag":
        return _drag(numbers)
    if name == "move":
        return [lambda window: window.on_pointer(*numbers)]
    if name == "scrub":
        return [lambda window: window.parts.state.timeline.scrub(numbers[0])]
    if name == "turn":
        return [lambda window: window.parts.viewpoint.cameras.turn(*numbers)]
    if name == "near":
        return [lambda window: window.parts.viewpoint.cameras.approach(numbers[0])]
    if name == "wheel":
        return [lambda window: window.on_wheel(numbers[0])]
    return [lambda window: glfw.set_window_size(window.screen.handle, int(numbers[0]), int(numbers[1]))]


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


def _drag(numbers: Sequence[float]) -> list[Step]:
    x0, y0, x1, y1 = numbers[:4]
    button = int(numbers[4]) if len(numbers) > 4 else 0
    out: list[Step] = [lambda window: window.on_pointer(x0, y0), lambda window: window.on_button(button, True)]
    for k in range(1, DRAG_FRAMES + 1):
        part = k / DRAG_FRAMES
        out.append(lambda window, part=part: window.on_pointer(x0 + part * (x1 - x0), y0 + part * (y1 - y0)))
    return [*out, lambda window: window.on_button(button, False)]
