"""The keyboard: names of keys, which are down, and what a key does now."""

import glfw

from player.window.actions import found
from player.window.parts import WindowParts

# names of keys, as the table of actions and scripts use them
NAMED = {
    "space": glfw.KEY_SPACE, ",": glfw.KEY_COMMA, ".": glfw.KEY_PERIOD, "left": glfw.KEY_LEFT,
    "right": glfw.KEY_RIGHT, "up": glfw.KEY_UP, "down": glfw.KEY_DOWN, "home": glfw.KEY_HOME, "end": glfw.KEY_END,
    "[": glfw.KEY_LEFT_BRACKET, "]": glfw.KEY_RIGHT_BRACKET, "-": glfw.KEY_MINUS, "=": glfw.KEY_EQUAL,
    "tab": glfw.KEY_TAB, "enter": glfw.KEY_ENTER, "escape": glfw.KEY_ESCAPE, "backspace": glfw.KEY_BACKSPACE,
    "delete": glfw.KEY_DELETE, "ctrl": glfw.KEY_LEFT_CONTROL, "shift": glfw.KEY_LEFT_SHIFT, "f1": glfw.KEY_F1,
    "f11": glfw.KEY_F11,
}  # fmt: skip
KEYS = NAMED | {letter: ord(letter.upper()) for letter in "abcdefghijklmnopqrstuvwxyz"}
KEYS |= {digit: ord(digit) for digit in "0123456789"}
NAMES = {code: name for name, code in KEYS.items()}
MODIFIERS = {
    glfw.KEY_LEFT_CONTROL: "ctrl", glfw.KEY_RIGHT_CONTROL: "ctrl", glfw.KEY_LEFT_SUPER: "ctrl",
    glfw.KEY_RIGHT_SUPER: "ctrl", glfw.KEY_LEFT_SHIFT: "shift", glfw.KEY_RIGHT_SHIFT: "shift",
}  # fmt: skip


class Keyboard:
    """The modifiers that are held down, and what keys do."""

    def __init__(self, parts: WindowParts):
        self._parts = parts
        # codes
        self._modifiers: set[int] = set()

    def release(self, code: int) -> None:
        """A key went up, also over a text field."""
        self._modifiers.discard(code)

    def press(self, code: int) -> None:
        """A key went down, or repeats. Control makes another key of it; Shift does where that means something."""
        if code in MODIFIERS:
            self._modifiers.add(code)
            return
        name, held = NAMES.get(code, ""), {MODIFIERS[key] for key in self._modifiers}
        chord = "+".join([*(word for word in ("ctrl", "shift") if word in held), name])
        action = found(chord, self._parts)
        if action is None and held == {"shift"}:
            action = found(name, self._parts)
        if action is not None:
            action.do(self._parts)
