"""The panel of how it is drawn: screenshot and film; effects (effects_panel.py), level of detail, background."""

from dataclasses import replace

from imgui_bundle import imgui

from avatar.progress import counted
from player.gui.effects_panel import effects_panel
from player.gui.widgets import Widgets
from player.window.actions import FILM, SCREENSHOT
from player.window.parts import Parts


def view_panel(ui: Widgets, parts: Parts) -> None:
    """Choices that change the plan make a new renderer, so nothing that is not chosen is ever run."""
    look = parts.look
    # above the effects, of which there are more than a small window shows
    film = parts.recorder.film
    ui.action("Screenshot", SCREENSHOT, parts)
    ui.action("Stop film" if film else "Film", FILM, parts, name="film", beside=True)
    tip = "Milliseconds that each effect adds to a frame now, beside it; timing them takes a moment."
    if ui.button("Prices", tip, name="prices", beside=True):
        parts.prices.ask()
    if film is not None:
        imgui.same_line()
        imgui.text(counted(film.frames, "frame"))
    effects_panel(ui, parts)
    if look.renderer.has_view:
        tip = "How much of the view dependence is shown. 0 is the paper."
        amount = ui.slider("amount", look.renderer.view_amount, (0.0, 1.0), tip, form="%.2f")
        look.renderer.view_amount = look.renderer.view_amount if amount is None else amount
    levels = max(len(avatar.levels) for avatar in parts.state.avatars)
    if levels > 1:
        names = [f"{len(level.faces)} triangles" for level in parts.state.avatars[0].levels]
        names += [f"level {k}" for k in range(len(names), levels)]
        chosen = ui.choice("detail", min(look.level, levels - 1), names, "Level of detail: fewer triangles are faster.")
        if chosen is not None:
            look.change(level=chosen)
        tip = "Each avatar gets a coarser level where it is small on the screen; the level above is the finest."
        follows = ui.checkbox("by size", look.by_size, tip, name="detail by size", beside=True)
        if follows != look.by_size:
            look.follow_size(follows)
    if look.background.kind == "color":
        color = ui.color("background", look.background.color[:3], "Colour behind the avatars; click the patch.")
        if color is not None:
            red, green, blue = color
            look.change(background=replace(look.background, color=(red, green, blue, 1.0)))
