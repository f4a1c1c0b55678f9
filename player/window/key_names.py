"""The names of keys, as the table of actions and scripts use them."""

import glfw

NAMED = {
    "space": glfw.KEY_SPACE, ",": glfw.KEY_COMMA, ".": glfw.KEY_PERIOD, "left": glfw.KEY_LEFT,
    "right": glfw.KEY_RIGHT, "up": glfw.KEY_UP, "down": glfw.KEY_DOWN, "home": glfw.KEY_HOME, "end": glfw.KEY_END,
    "[": glfw.KEY_LEFT_BRACKET, "]": glfw.KEY_RIGHT_BRACKET, "-": glfw.KEY_MINUS, "=": glfw.KEY_EQUAL,
    "tab": glfw.KEY_TAB, "enter": glfw.KEY_ENTER, "escape": glfw.KEY_ESCAPE, "backspace": glfw.KEY_BACKSPACE,
    "delete": glfw.KEY_DELETE, "ctrl": glfw.KEY_LEFT_CONTROL, "shift": glfw.KEY_LEFT_SHIFT, "f1": glfw.KEY_F1,
}  # fmt: skip
KEYS = NAMED | {letter: ord(letter.upper()) for letter in "abcdefghijklmnopqrstuvwxyz"}
KEYS |= {digit: ord(digit) for digit in "0123456789"}
NAMES = {code: name for name, code in KEYS.items()}
MODIFIERS = {
    glfw.KEY_LEFT_CONTROL: "ctrl", glfw.KEY_RIGHT_CONTROL: "ctrl", glfw.KEY_LEFT_SUPER: "ctrl",
    glfw.KEY_RIGHT_SUPER: "ctrl", glfw.KEY_LEFT_SHIFT: "shift", glfw.KEY_RIGHT_SHIFT: "shift",
}  # fmt: skip
