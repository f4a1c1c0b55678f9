"""What is drawn beside the avatars' colors, as the scene's dataclass lists it: a list of words, or a box to tick
with the settings of what is ticked below it."""

from dataclasses import replace
from typing import Any, get_origin

from imgui_bundle import imgui

from command.settings import Color, OneOf, Setting, broken_rule, rule_of, settings_of
from player.scene.effects import Effects
from player.window.budgeted import NO_LIGHT, without_effect
from player.window.panels.widgets import Widgets
from player.window.parts import WindowParts

# shorter than the field's own name
LABELS = {"antialiasing": "edges"}


def effects_panel(ui: Widgets, parts: WindowParts) -> None:
    """What is not chosen is in no plan: each change makes and frees just what it has to."""
    effects = parts.look.effects
    for setting in settings_of(Effects):
        value = setting.value_in(effects)
        price = parts.prices.words(setting.name, effects)
        if setting.table is None:
            chosen = _setting(ui, setting, value, setting.name)
            ui.note(price)
        else:
            why = without_effect(setting.name, effects, parts.state.avatars)
            # one that is on can always be taken off
            imgui.begin_disabled(bool(why) and value is None and setting.name != "light")
            on = ui.checkbox(setting.name, value is not None, f"{setting.means}.", name=setting.name, grey=bool(why))
            imgui.end_disabled()
            ui.note(why or price)
            # a light that would change nothing begins with lamps
            begins = {"by": "lamps"} if why == NO_LIGHT else {}
            chosen = None if on == (value is not None) else setting.table(**begins) if on else _OFF
            if on and value is not None:
                chosen = _changed(ui, setting, value)
        if chosen is not None:
            parts.look.change(effects=replace(effects, **{setting.name: None if chosen is _OFF else chosen}))


def _changed(ui: Widgets, effect: Setting, value: Any) -> Any | None:
    """The settings of an effect with what was changed in its rows."""
    for setting in settings_of(effect.table):
        chosen = _setting(ui, setting, setting.value_in(value), f"{effect.name} {setting.name}")
        if chosen is not None and broken_rule(setting, chosen) is None:
            try:
                return replace(value, **{setting.name: chosen})
            # rules between settings, while a number is dragged past them
            except ValueError:
                return None
    return None


def _setting(ui: Widgets, setting: Setting, value: Any, name: str) -> Any | None:
    """A row for a setting; its new value."""
    known, tip = rule_of(setting, OneOf), f"{setting.means}."
    label = LABELS.get(name, name)
    if known is not None:
        words = [word.replace("_", " ") for word in known.values]
        chosen = ui.choice(label, known.values.index(value), words, tip, name=name)
        return None if chosen is None else known.values[chosen]
    if rule_of(setting, Color) is not None:
        color = ui.color(label, value[:3], tip)
        return None if color is None else (*color, 1.0)
    if setting.type is str:
        # files are named in the scene
        ui.path(label, value or "")
        return None
    if get_origin(setting.type) is tuple:
        numbers = ui.numbers(label, value, tip, name=name)
        return None if numbers is None else tuple(numbers)
    assert setting.type in (int, float), f"no widget for {name}"
    number = ui.number(label, float(value), tip, name=name)
    return None if number is None else setting.type(number)


_OFF = object()
