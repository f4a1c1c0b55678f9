"""What is drawn beside the avatars' colors, in plain words: looks that set many effects at once, and a list of choices
for each effect. Its numbers unfold below it, as the scene's dataclass lists them."""

from dataclasses import replace
from typing import Any, get_origin

from imgui_bundle import imgui

from command.settings import Color, OneOf, Setting, broken_rule, rule_of, settings_of
from player.effects.background import Background
from player.scene.effects import Effects
from player.window.budgeted import without_effect
from player.window.looks import LOOKS, choices_of, label_of
from player.window.panels.widgets import Widgets
from player.window.parts import WindowParts

# those that a small window shows without more ado
FIRST = ("light", "ground", "contact", "antialiasing", "outline")
IN_FILMS = "shows in films of `selfscan render`, not here"
# settings of a background that the window changes, by its kind
BEHIND = {"color": ("color",), "image": ("fit", "color"), "video": ("fit", "color"), "hdr": ("exposure", "turn_deg")}


def looks_panel(ui: Widgets, parts: WindowParts) -> None:
    look = parts.look
    for number, (name, one) in enumerate(LOOKS.items()):
        effects, background = one.of(look.effects, look.background)
        on = (effects, background) == (look.effects, look.background)
        if ui.button(name, one.means, beside=number > 0, on=on):
            look.change(effects=effects, background=background)


def effects_panel(ui: Widgets, parts: WindowParts, *, first: bool) -> None:
    """The effects that are chosen first, or all others. What is not chosen is in no plan: each change makes and frees
    just what it has to."""
    known = {setting.name: setting for setting in settings_of(Effects)}
    for name in FIRST if first else [name for name in known if name not in FIRST]:
        _effect(ui, parts, known[name])


def background_panel(ui: Widgets, parts: WindowParts) -> None:
    """What is behind everyone."""
    background = parts.look.background
    unfolded = False
    if background.kind != "color":
        unfolded = ui.triangle("background numbers", "How the background lies and how bright it is.")
        ui.path("behind: ", background.path or background.kind)
    for setting in settings_of(Background):
        if setting.name in BEHIND.get(background.kind, ()) and (unfolded or background.kind == "color"):
            label = "background" if background.kind == "color" else label_of(setting)
            chosen = _number(ui, setting, setting.value_in(background), label, f"background {setting.name}")
            if chosen is not None:
                parts.look.change(background=replace(background, **{setting.name: chosen}))


def _effect(ui: Widgets, parts: WindowParts, setting: Setting) -> None:
    """A list of choices; below it, unfolded, numbers, then why it cannot show, and what it costs."""
    effects, name = parts.look.effects, setting.name
    value = setting.value_in(effects)
    why = reason(parts, name, value)
    words, values, chosen = choices_of(setting, value)
    unfolded = False
    if setting.table is not None and value is not None:
        unfolded = ui.triangle(f"{name} numbers", f"The numbers of {label_of(setting)}.")
    else:
        ui.no_triangle()
    # one that is on can always be taken off
    imgui.begin_disabled(bool(why) and value is None)
    picked = ui.choice(label_of(setting), chosen, words, f"{setting.means[0].upper()}{setting.means[1:]}.", name=name)
    imgui.end_disabled()
    changed = value if picked is None else values[picked]
    if unfolded:
        imgui.indent()
        changed = _changed(ui, setting, value) or changed
        imgui.unindent()
    ui.caption("; ".join(text for text in (why, parts.prices.words(name, effects)) if text))
    if changed != value:
        parts.look.change(effects=replace(effects, **{name: changed}))


def reason(parts: WindowParts, name: str, on: object) -> str:
    """Why an effect that is on does not show, or one that is off (None) would not; empty where it does."""
    playback, why = parts.state.playback, without_effect(name, parts.look.effects, parts.state.avatars)
    if why and name != "light":
        return why
    if why and on is not None:
        return f"{why} (even light leaves none)"
    if name in ("motion_blur", "depth_of_field") and on is not None:
        return IN_FILMS
    if name == "foot_lock" and on is not None and all(track.motion.frames < 2 for track in playback.tracks):
        return "no motion has more than one frame"
    if name == "view" and on != "off" and not parts.look.renderer.has_view:
        return "matte: the file has no shine"
    return ""


def _changed(ui: Widgets, effect: Setting, value: Any) -> Any | None:
    for setting in settings_of(effect.table):
        chosen = _number(ui, setting, setting.value_in(value), label_of(setting), f"{effect.name} {setting.name}")
        if chosen is not None and broken_rule(setting, chosen) is None:
            try:
                return replace(value, **{setting.name: chosen})
            # rules between settings, while a number is dragged past them
            except ValueError:
                return None
    return None


def _number(ui: Widgets, setting: Setting, value: Any, label: str, name: str) -> Any | None:
    """A row for a setting; its new value."""
    known, tip = rule_of(setting, OneOf), f"{setting.means}."
    if known is not None:
        words = [word.replace("_", " ") for word in known.values]
        chosen = ui.choice(label, known.values.index(value), words, tip, name=name)
        return None if chosen is None else known.values[chosen]
    if rule_of(setting, Color) is not None:
        color = ui.color(label, value[:3], tip, name=name)
        return None if color is None else (*color, 1.0)
    if setting.type is str:
        # files are dropped on the window, or named in the scene
        if value:
            ui.path(f"{label}: ", value)
        return None
    if get_origin(setting.type) is tuple:
        numbers = ui.numbers(label, value, tip, name=name)
        return None if numbers is None else tuple(numbers)
    assert setting.type in (int, float), f"no widget for {name}"
    number = ui.number(label, float(value), tip, name=name)
    return None if number is None else setting.type(number)
