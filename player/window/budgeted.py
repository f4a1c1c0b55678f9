"""The budget of the window: how avatars are drawn (player/rung.py) follows what frames take (player/budget/)."""

from collections.abc import Sequence

from avatar.camera import Camera
from player.budget.controller import BudgetController
from player.budget.measure import BudgetScene
from player.budget.rungs import choice_words
from player.budget.table import bought_rung
from player.context import Context
from player.drawing import Pose
from player.window.look import Look
from player.window.state import Messages


class Budgeted:
    """What the window draws within `budget`, ms of a frame's own work. A view mode or level chosen by hand ends it."""

    def __init__(
        self,
        context: Context,
        look: Look,
        files: Sequence[str],
        frames: Sequence[tuple[Sequence[Pose], Camera]],
        size: tuple[int, int],
        budget: float,
        messages: Messages,
    ):
        self._look, self._messages, self.budget = look, messages, budget
        scene = BudgetScene(look.avatars, frames, size, look.effects, look.background, reads_back=False)
        priced, chosen = bought_rung(context, scene, files, budget=budget)
        print(choice_words(chosen, priced, budget))
        self.controller: BudgetController | None = BudgetController(priced, budget, chosen)
        self._show()

    def frame(self, ms: float, *, filming: bool) -> None:
        """A frame took so long. A film keeps what it began with."""
        if self.controller is None or filming:
            return
        rung = self.controller.current.rung
        if self._look.effects.view != rung.view or self._look.rung != rung:
            self.controller = None
            self._messages.say("budget off: the view was changed by hand")
        elif self.controller.frame(ms) is not None:
            self._show()

    @property
    def words(self) -> str:
        """Which rung is shown, and what the next better one would cost."""
        if self.controller is None:
            return "budget off"
        now, dearer = self.controller.current, self.controller.dearer
        words = f"budget {self.budget:.3g} ms: {now.rung.name}"
        if dearer is None:
            return words
        return f"{words}; {dearer.rung.name} {(dearer.ms_median - now.ms_median) * self.controller.load:.1f} ms more"

    def _show(self) -> None:
        assert self.controller is not None
        self._look.show(self.controller.current.rung)
