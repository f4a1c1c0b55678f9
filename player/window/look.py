"""How the avatars are drawn: the renderer, its effects, background and level of detail."""

from collections.abc import Sequence

from avatar.baked_avatar import Avatar
from avatar.errors import AssetError
from player.context import Context
from player.passes.background import Background
from player.renderer import Renderer
from player.scenes.effects import Effects
from player.window.state import Messages


class Look:
    """The renderer of the window and what it was asked for. Over a video the background is drawn last, under all."""

    def __init__(
        self,
        context: Context,
        avatars: Sequence[Avatar],
        effects: Effects,
        background: Background,
        *,
        over_video: bool,
        messages: Messages,
    ):
        self._context, self.avatars, self._messages = context, avatars, messages
        self.effects, self.background, self.level = effects, background, 0
        self._over_video = over_video
        self.renderer = self._new_renderer(effects, background, 0)

    def change(
        self, *, effects: Effects | None = None, background: Background | None = None, level: int | None = None
    ) -> None:
        """Other effects, background or level of detail; where that cannot be, it is said and nothing changes."""
        effects, background = effects or self.effects, background or self.background
        try:
            if level is not None and level != self.level:
                new = self._new_renderer(effects, background, level)
                new.view_amount = self.renderer.view_amount
                self.renderer.release()
                self.renderer, self.level = new, level
            else:
                self.renderer.change(effects=effects, background=self._drawn_first(background))
        except (ValueError, AssetError) as error:
            self._messages.say(str(error))
            return
        self.effects, self.background = effects, background

    def toggle_view(self) -> None:
        """View dependence on or off."""
        self.renderer.view_amount = 1.0 - self.renderer.view_amount

    @property
    def status(self) -> str:
        if not self.renderer.has_view:
            return "paper mode"
        return "view on" if self.renderer.view_amount else "view off"

    def _new_renderer(self, effects: Effects, background: Background, level: int) -> Renderer:
        background = self._drawn_first(background)
        return Renderer(self._context, self.avatars, None, effects=effects, background=background, level=level)

    def _drawn_first(self, background: Background) -> Background:
        return Background("transparent") if self._over_video else background
