"""The panel of how it is drawn: view dependence, skinning, edges, level of detail, background; screenshot and film."""

from dataclasses import replace
from typing import TYPE_CHECKING

from imgui_bundle import imgui

from player.passes.view import VIEWS
from player.scenes.effects import ANTIALIASINGS, SKINNINGS

if TYPE_CHECKING:
    from player.window.window import Window


def view_panel(window: "Window") -> None:
    """Choices that change the plan make a new renderer, so nothing that is not chosen is ever run."""
    panels, effects = window.panels, window.effects
    assert panels is not None
    for name, label, known in (
        ("view", "view", ("auto", *VIEWS)), ("skinning", "skinning", SKINNINGS),
        ("antialiasing", "edges", ANTIALIASINGS),
    ):  # fmt: skip
        shown = [value.replace("_", " ") for value in known]
        changed, chosen = imgui.combo(label, known.index(getattr(effects, name)), shown)
        panels.mark(name)
        if changed:
            window.draw_otherwise(effects=replace(effects, **{name: known[chosen]}))
    if window.renderer.has_view:
        _, window.renderer.view_amount = imgui.slider_float("amount", window.renderer.view_amount, 0.0, 1.0, "%.2f")
        panels.mark("amount")
    levels = max(len(avatar.levels) for avatar in window.show.avatars)
    if levels > 1:
        names = [f"{len(level.faces)} triangles" for level in window.show.avatars[0].levels]
        names += [f"level {k}" for k in range(len(names), levels)]
        changed, chosen = imgui.combo("detail", min(window.level, levels - 1), names)
        panels.mark("detail")
        if changed:
            window.draw_otherwise(level=chosen)
    background = window.background
    if background.kind == "color":
        changed, color = imgui.color_edit3("background", list(background.color[:3]))
        panels.mark("background")
        if changed:
            window.draw_otherwise(background=replace(background, color=(*color, 1.0)))
    if imgui.button("Screenshot"):
        window.shoot = True
    panels.mark("screenshot")
    imgui.same_line()
    if imgui.button("Stop film" if window.film else "Film"):
        window.toggle_film()
    panels.mark("film")
    if window.film is not None:
        imgui.same_line()
        imgui.text(f"{window.film.frames} frames")
