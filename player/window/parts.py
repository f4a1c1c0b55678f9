"""The parts of the window, each in a file of its own. Keys, mouse and panels act on them."""

from collections.abc import Callable
from pathlib import Path

from command.errors import unicode_text
from player.window.budgeted import Budgeted, EffectPrices
from player.window.look import Appearance
from player.window.opening import Opening
from player.window.posing import Posing
from player.window.recorder import Recorder
from player.window.screen import Screen
from player.window.show import Show
from player.window.state import AvatarSelection, LastFrame, Messages, WindowLayout, WindowState
from player.window.viewpoint import Viewpoint
from player.window.wipe import Wipe


class WindowParts:
    """What can be changed in the window, at first as a show was opened."""

    def __init__(self, show: Show, screen: Screen, clock: Callable[[], float], messages: Messages):
        self.state = WindowState(
            avatars=show.avatars,
            playback=show.playback,
            selection=AvatarSelection([unicode_text(Path(entry.path).stem) for entry in show.scene.avatars]),
            layout=WindowLayout(screen),
            last=LastFrame(show.playback.poses()),
            messages=messages,
        )
        self.viewpoint = Viewpoint(self.state, show)
        self.look = Appearance(self.state, show)
        self.posing = Posing(self.state)
        self.recorder = Recorder(self.state, clock)
        # over the source video, where there is one
        self.wipe = Wipe(show.capture, self.state.layout) if show.capture is not None else None
        self.opening = Opening(show)
        # where one was asked for
        self.budget: Budgeted | None = None
        self.prices = EffectPrices()
        # asked to close
        self.closing = False

    def close(self) -> None:
        """Ask the window to close; where a pose would be lost, the second time."""
        self.closing = self.posing.may_leave()
