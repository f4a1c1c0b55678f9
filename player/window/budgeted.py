"""The budget of the window: how avatars are drawn (player/budget/rung.py) follows what frames take (player/budget/)."""

from collections.abc import Sequence

from avatar.baked_avatar import Avatar
from avatar.camera import Camera
from command.settings import settings_of
from player.budget.controller import BudgetController
from player.budget.ladder import choice_words
from player.budget.measure import BudgetScene, effect_prices
from player.budget.table import rung_within
from player.draw.drawing import Pose
from player.effects.secondary_motion import is_loose
from player.scene.effects import Effects
from player.window.look import Appearance
from player.window.state import Messages

# frames that are timed: while the window plays they move, while it stands they do not
FRAMES = 4
# times that each is timed
ROUNDS = 4
# as --explain says it
NOT_LOOSE, NO_LIGHT = "nothing of it is loose", "not lit anew: its file has no light"


class Budgeted:
    """What the window draws within `budget`, ms of a frame's own work. A view mode or level chosen by hand ends it."""

    def __init__(self, look: Appearance, scene: BudgetScene, files: Sequence[str], budget: float, messages: Messages):
        """scene: what the look draws in some frames; files: those of the avatars."""
        self._look, self._messages, self.budget = look, messages, budget
        priced, chosen = rung_within(look.context, scene, files, budget=budget)
        print(choice_words(chosen, priced, budget))
        self.controller: BudgetController | None = BudgetController(priced, budget, chosen)
        look.show(chosen.rung)

    def frame(self, ms: float, *, filming: bool) -> None:
        """A frame took so long. A film keeps what it began with."""
        if self.controller is None or filming:
            return
        rung = self.controller.current.rung
        if self._look.effects.view != rung.view or self._look.rung != rung:
            self.controller = None
            self._messages.say("budget off: the view was changed by hand")
        elif changed := self.controller.frame(ms):
            self._look.show(changed.rung)

    @property
    def words(self) -> str:
        """Which rung is shown, and what the next better one would cost."""
        if self.controller is None:
            return "budget off"
        now, better = self.controller.current, self.controller.costlier
        words = f"budget {self.budget:.3g} ms: {now.rung.name}"
        if now.ms_median * self.controller.load > self.budget:
            words += f", missed: {now.ms_median * self.controller.load:.3g} ms"
        if better is None:
            return words
        return f"{words}; {better.rung.name} {(better.ms_median - now.ms_median) * self.controller.load:.1f} ms more"


class EffectPrices:
    """Milliseconds a frame of each effect, ticked or not, as long as what is asked for stays the same."""

    def __init__(self) -> None:
        self.wanted, self._of, self._ms = False, None, dict[str, float]()
        self._seen: list[tuple[list[Pose], Camera]] = []

    def ask(self) -> None:
        """Time the effects as soon as a few frames were drawn."""
        self.wanted, self._seen = True, []

    def drawn(self, look: Appearance, poses: Sequence[Pose], camera: Camera) -> None:
        """A frame of the window was drawn so."""
        if not self.wanted:
            return
        self._seen.append((list(poses), camera))
        if len(self._seen) == FRAMES:
            offered = [
                setting.name for setting in settings_of(Effects)
                if setting.table is not None and setting.value_in(look.effects) is None
                and not without_effect(setting.name, look.effects, look.avatars)
            ]  # fmt: skip
            scene = look.scene(self._seen, camera.size)
            self._ms = effect_prices(look.context, scene, look.rung, rounds=ROUNDS, offered=offered)
            self._of = look.effects
            self.wanted = False

    def words(self, name: str, effects: Effects) -> str:
        """What an effect costs, by the name of its setting; nothing where that is not known or no longer holds."""
        return f"{self._ms[name]:.1f} ms" if self._of == effects and name in self._ms else ""


def without_effect(name: str, effects: Effects, avatars: Sequence[Avatar]) -> str:
    """Why an effect changes nothing on these avatars, as `--explain` says it; empty where it does. Lamps and panoramas
    light any avatar; the light of its videos only one whose file holds it."""
    if name == "secondary_motion" and not any(is_loose(level) for avatar in avatars for level in avatar.levels):
        return NOT_LOOSE
    own = effects.light is None or effects.light.by in ("capture", "albedo")
    # without lamps it is even, and as the colors have it
    if name == "light" and own and not any(avatar.light is not None and avatar.light.lamps for avatar in avatars):
        return NO_LIGHT
    return ""
