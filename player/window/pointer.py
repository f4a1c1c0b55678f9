"""The mouse over the picture: what a press takes hold of, what a drag moves, and what a click picks."""

from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from player.window.window import Window

# window units that a click may wander
CLICK = 4.0


class Tool(Protocol):
    """Something drawn over the picture that can be dragged. Places are pixels of the framebuffer."""

    def press(self, x: float, y: float) -> bool:
        """The left button went down; True takes the drag, and the camera stays."""
        ...

    def drag(self, x: float, y: float) -> None: ...

    def release(self, x: float, y: float) -> None: ...

    def hover(self, x: float, y: float) -> None:
        """The pointer moved with no button down."""
        ...

    def pick(self, x: float, y: float) -> bool:
        """A click that moved nothing; True where the tool selected something itself."""
        ...

    def key(self, key: int, down: bool) -> bool:
        """A key; True where the tool took it."""
        ...

    def follow_timeline(self) -> None:
        """A frame is about to be drawn; the window's timeline stands where it will be shown."""
        ...

    def may_leave(self) -> bool:
        """Whether the window may close; False, once, where something would be lost, which is said."""
        ...


class Pointer:
    """Where the pointer is, window units, and what it holds: nothing yet, the camera, the wipe's line or the tool."""

    def __init__(self, window: "Window"):
        self.window = window
        self.at: tuple[float, float] = (0.0, 0.0)
        # button and where it went down
        self.pressed: tuple[int, float, float] | None = None
        self.holds = ""

    def move(self, x: float | int, y: float | int) -> None:
        """The pointer moved."""
        window = self.window
        dx, dy = x - self.at[0], y - self.at[1]
        self.at = (float(x), float(y))
        if self.pressed is None:
            if window.tool is not None:
                window.tool.hover(*window.pixel(x, y))
            return
        button, x0, y0 = self.pressed
        if not self.holds and np.hypot(x - x0, y - y0) > CLICK:
            self.holds, dx, dy = "camera", x - x0, y - y0
        if self.holds == "wipe" and window.wipe is not None:
            window.wipe.move_to(window.pixel(x, y)[0], window.area())
        elif self.holds == "tool" and window.tool is not None:
            window.tool.drag(*window.pixel(x, y))
        elif self.holds == "camera" and button == 0:
            window.cameras.turn(dx, dy)
        elif self.holds == "camera":
            window.cameras.shift(dx, dy, window.size_in_units()[1])

    def press(self, button: int) -> None:
        """A button went down over the picture."""
        window = self.window
        self.pressed, self.holds = (button, self.at[0], self.at[1]), ""
        if button != 0:
            return
        x, y = window.pixel(*self.at)
        if window.tool is not None and window.tool.press(x, y):
            self.holds = "tool"
        elif window.shows_video and window.wipe is not None and window.wipe.near(x, window):
            self.holds = "wipe"

    def release(self, button: int) -> None:
        """A button was let go, wherever."""
        if self.pressed is None or self.pressed[0] != button:
            return
        window = self.window
        if self.holds == "tool" and window.tool is not None:
            window.tool.release(*window.pixel(*self.at))
        elif not self.holds and button == 0:
            window.pick_at(*window.pixel(*self.at))
        self.pressed, self.holds = None, ""
