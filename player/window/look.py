"""How the avatars are drawn: the renderer, its effects, background and level of detail."""

from collections.abc import Sequence
from dataclasses import replace

from command.errors import AssetError
from player.budget.ladder import Frame
from player.budget.measure import BudgetScene
from player.budget.rung import Rung
from player.effects.background import Background
from player.scene.effects import Effects
from player.scene.renderer import Renderer
from player.window.show import Show
from player.window.state import WindowState


class Appearance:
    """The renderer of the window and what it was asked for. Over a video the background is drawn last, under all."""

    def __init__(self, state: WindowState, show: Show):
        self.context, self.avatars, self._messages = state.layout.screen.context, state.avatars, state.messages
        self.effects, self.background = show.scene.effects, show.scene.background
        # what it draws of the avatars: level of detail, textures, joints
        self.rung = Rung("as the file is", self.effects.view)
        self._over_video = show.capture is not None
        self.renderer = self._new_renderer(self.effects, self.background, self.rung)

    def scene(self, frames: Sequence[Frame], size: tuple[int, int]) -> BudgetScene:
        """What is drawn now in such frames, to be timed."""
        return BudgetScene(self.avatars, frames, size, self.effects, self.background, reads_back=False)

    def show(self, rung: Rung) -> None:
        """Draw as a rung says, but for its share of pixels; where that cannot be, it is said and nothing changes."""
        self.change(effects=replace(self.effects, view=rung.view), rung=rung)

    def change(
        self, *, effects: Effects | None = None, background: Background | None = None, rung: Rung | None = None,
        anew: bool = False,
    ) -> bool:  # fmt: skip
        """Other effects, background or detail; `anew` where avatars are others. Whether it is drawn; else this is said,
        and nothing changes."""
        effects, background, rung = effects or self.effects, background or self.background, rung or self.rung
        try:
            if anew or replace(rung, name=self.rung.name, view=self.rung.view) != self.rung:
                new = self._new_renderer(effects, background, rung)
                new.view_amount = self.renderer.view_amount
                self.renderer.release()
                self.renderer = new
            else:
                self.renderer.change(effects=effects, background=self._drawn_first(background))
        except (ValueError, AssetError) as error:
            self._messages.say(str(error))
            return False
        self.effects, self.background, self.rung = effects, background, rung
        return True

    def toggle_view(self) -> None:
        self.renderer.view_amount = 1.0 - self.renderer.view_amount

    @property
    def status(self) -> str:
        if not self.renderer.has_view:
            return "paper mode"
        return "view on" if self.renderer.view_amount else "view off"

    def _new_renderer(self, effects: Effects, background: Background, rung: Rung) -> Renderer:
        background, avatars = self._drawn_first(background), rung.prepared(self.avatars)
        return Renderer(self.context, avatars, None, effects=effects, background=background, level=rung.level)

    def _drawn_first(self, background: Background) -> Background:
        return Background("transparent") if self._over_video else background
