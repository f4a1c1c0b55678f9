"""What each effect costs in this window, on request: the next few frames are noted, then timed with and without it."""

from collections.abc import Sequence

from avatar.camera import Camera
from player.budget.effect_prices import effect_prices
from player.budget.measure import BudgetScene
from player.context import Context
from player.drawing import Pose
from player.scenes.effects import Effects
from player.window.look import Look

# of the window that are timed: while it plays they move, while it stands they do not
FRAMES = 4


class EffectPrices:
    """Milliseconds a frame of each effect, as long as what is asked for stays the same."""

    def __init__(self) -> None:
        self._wanted, self._of, self._ms = False, None, dict[str, float]()
        self._seen: list[tuple[list[Pose], Camera]] = []

    def ask(self) -> None:
        """Time the effects as soon as a few frames were drawn."""
        self._wanted, self._seen = True, []

    def drawn(self, context: Context, look: Look, poses: Sequence[Pose], camera: Camera) -> None:
        """A frame of the window was drawn so."""
        if not self._wanted:
            return
        self._seen.append((list(poses), camera))
        if len(self._seen) == FRAMES:
            scene = BudgetScene(
                look.avatars, self._seen, camera.size, look.effects, look.background, reads_back=False
            )  # fmt: skip
            self._ms, self._of = effect_prices(context, scene, look.rung), look.effects
            self._wanted = False

    def words(self, name: str, effects: Effects) -> str:
        """What an effect costs, by the name of its setting; nothing where that is not known or no longer holds."""
        return f"{self._ms[name]:.1f} ms" if self._of == effects and name in self._ms else ""
