"""The parts of the window, each in a file of its own. Keys, mouse and panels act on them."""

from collections.abc import Callable
from dataclasses import dataclass, field

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


@dataclass
class WindowParts:
    """What can be changed in the window. `wipe` is there with a source video, `budget` where one was asked for."""

    state: WindowState
    viewpoint: Viewpoint
    look: Appearance
    posing: Posing
    recorder: Recorder
    wipe: Wipe | None
    opening: Opening
    budget: Budgeted | None = None
    prices: EffectPrices = field(default_factory=EffectPrices)
    # asked to close
    closing: bool = False

    def close(self) -> None:
        """Ask the window to close; where a pose would be lost, the second time."""
        self.closing = self.posing.may_leave()


def opened_parts(show: Show, screen: Screen, clock: Callable[[], float], messages: Messages) -> WindowParts:
    """The parts for a show, as it was opened."""
    capture = show.capture
    state = WindowState(
        avatars=show.avatars,
        playback=show.playback,
        selection=AvatarSelection(show.names),
        layout=WindowLayout(screen),
        last=LastFrame(show.playback.poses()),
        messages=messages,
    )
    return WindowParts(
        state=state,
        viewpoint=Viewpoint(state, show.cameras, capture=capture, follow=show.follow),
        look=Appearance(screen.context, show, messages),
        posing=Posing(state),
        recorder=Recorder(state, clock),
        wipe=Wipe(screen.context, capture) if capture is not None else None,
        opening=Opening(show),
    )
