"""The keyboard: which keys are down, and what a key does now."""

from player.cameras import WALK
from player.window.actions import found
from player.window.key_names import MODIFIERS, NAMES
from player.window.parts import Parts


class Keyboard:
    """Keys that are held down: modifiers, and those that carry the camera."""

    def __init__(self, parts: Parts):
        self._parts = parts
        # codes of modifiers, names of walking keys
        self._modifiers: set[int] = set()
        self._walking: set[str] = set()

    def release(self, code: int) -> None:
        """A key went up, also over a text field."""
        self._modifiers.discard(code)
        self._walking.discard(NAMES.get(code, ""))

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
        if action is None:
            return
        if action.walk is not None:
            self._walking.add(name)
        action.do(self._parts)

    def advance(self, dt: float) -> None:
        """Carry the camera while its keys are held."""
        for name in self._walking:
            action = found(name, self._parts)
            if action is not None and action.walk is not None:
                self._parts.viewpoint.cameras.walk.go(*(WALK * dt * way for way in action.walk))
