"""The parts of the window, each in a file of its own. Keys, mouse and panels act on them."""

from dataclasses import dataclass, field

from player.window.budgeted import Budgeted
from player.window.look import Look
from player.window.posing import Posing
from player.window.prices import EffectPrices
from player.window.recorder import Recorder
from player.window.state import WindowState
from player.window.viewpoint import Viewpoint
from player.window.wipe import Wipe


@dataclass
class Parts:
    """What can be changed in the window. `wipe` is there with a source video, `budget` where one was asked for."""

    state: WindowState
    viewpoint: Viewpoint
    look: Look
    posing: Posing
    recorder: Recorder
    wipe: Wipe | None
    budget: Budgeted | None = None
    prices: EffectPrices = field(default_factory=EffectPrices)
    # asked to close
    closing: bool = False

    def close(self) -> None:
        """Ask the window to close; where a pose would be lost, the second time."""
        self.closing = self.posing.may_leave()
