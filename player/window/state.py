"""What all parts of the window refer to: the avatars and their playback, what is selected, the last frame, the layout
of the window, and messages. Each owns its state; `WindowState` only holds them together."""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import UInt8

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from avatar.skeleton import JOINTS
from command.errors import AssetError, unicode_text
from player.scene.renderer import Pose
from player.window.playback import Playback
from player.window.screen import Screen
from player.window.timeline import Timeline

# left, top, width, height, pixels of the framebuffer
Area = tuple[int, int, int, int]
MESSAGE_SECONDS = 5.0


@dataclass
class AvatarSelection:
    """The avatar that panels are about, and its joint that was clicked."""

    names: list[str]
    avatar: int = 0
    joint: int | None = None

    def choose(self, avatar: int, joint: int | None = None) -> None:
        self.avatar, self.joint = avatar % len(self.names), joint

    @property
    def name(self) -> str:
        name = self.names[self.avatar]
        return name if self.joint is None else f"{name}: {joint_name(self.joint)}"


class Messages:
    """The last message: printed, and shown for some seconds."""

    def __init__(self, clock: Callable[[], float]):
        self._clock = clock
        self.last, self._until = "", 0.0

    def say(self, text: str) -> None:
        print(text)
        self.last, self._until = unicode_text(text), self._clock() + MESSAGE_SECONDS

    @contextmanager
    def saying_errors(self) -> Iterator[None]:
        """A block that ends where a file cannot be read or written, which is said."""
        try:
            yield
        except AssetError as error:
            self.say(str(error))

    @property
    def shown(self) -> str:
        """The message while it is shown, else nothing."""
        return self.last if self._clock() < self._until else ""


class WindowLayout:
    """Which part of the window the picture has, and what lies over it."""

    def __init__(self, screen: Screen):
        self.screen = screen
        # whether panels and the help are switched on
        self.panels_on, self.help_on = True, False
        # whether panels were drawn in the last frame
        self.panels_drawn = False
        # what panels take at the left, right and bottom, pixels
        self.borders: Callable[[], tuple[int, int, int]] = lambda: (0, 0, 0)

    @property
    def area(self) -> Area:
        """Where the picture is free of panels."""
        (width, height), (left, right, bottom) = self.screen.size, self.borders()
        return left, 0, width - left - right, height - bottom


@dataclass
class LastFrame:
    """What was drawn last, and how long frames took."""

    poses: list[Pose]
    # pixels of the framebuffer; None before the first frame
    camera: Camera | None = None
    # what was read back, if that was asked for
    image: UInt8[np.ndarray, "height width 4"] | None = None
    # seconds of the last frames, each whole
    times: deque[float] = field(default_factory=lambda: deque(maxlen=120))

    @property
    def rate(self) -> float:
        """Frames a second."""
        spent = sum(self.times)
        return len(self.times) / spent if spent > 0 else 0.0


@dataclass(frozen=True)
class WindowState:
    """The parts that every other part may need."""

    avatars: list[Avatar]
    playback: Playback
    selection: AvatarSelection
    layout: WindowLayout
    last: LastFrame
    messages: Messages

    @property
    def timeline(self) -> Timeline:
        return self.playback.timeline


def joint_name(joint: int) -> str:
    """A joint's name as people say it: "left elbow", "right little finger 2"."""
    name = JOINTS[joint].replace("_", " ").replace("pinky", "little finger")
    if name[-1].isdigit():
        return f"{name[:-1]} {name[-1]}"
    parts = {"foot": "toes", "collar": "collar bone"}
    words = name.split()
    return " ".join([*words[:-1], parts.get(words[-1], words[-1])])
