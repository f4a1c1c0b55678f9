"""What is drawn beside the avatars' colors, as the scene's dataclass lists it: a list of words, or a box to tick
with the settings of what is ticked below it."""

from dataclasses import replace
from typing import Any

from avatar.settings import Color, Fact, OneOf, broken_rule, facts, rule_of
from player.gui.widgets import Widgets
from player.scenes.effects import Effects
from player.window.parts import Parts

# shorter than the field's own name
LABELS = {"antialiasing": "edges"}


def effects_panel(ui: Widgets, parts: Parts) -> None:
    """What is not chosen is in no plan: each change makes and frees just what it has to."""
    effects = parts.look.effects
    for fact in facts(Effects):
        value = getattr(effects, fact.name)
        if fact.table is None:
            chosen = _setting(ui, fact, value, fact.name)
        else:
            on = ui.checkbox(fact.name, value is not None, f"{fact.means}.", name=fact.name)
            chosen = None if on == (value is not None) else fact.table() if on else _OFF
            if on and value is not None:
                chosen = _changed(ui, fact, value)
        if chosen is not None:
            parts.look.change(effects=replace(effects, **{fact.name: None if chosen is _OFF else chosen}))


def _changed(ui: Widgets, effect: Fact, value: Any) -> Any | None:
    """The settings of an effect with what was changed in its rows."""
    for fact in facts(effect.table):
        chosen = _setting(ui, fact, getattr(value, fact.name), f"{effect.name} {fact.name}")
        if chosen is not None and broken_rule(fact, chosen) is None:
            return replace(value, **{fact.name: chosen})
    return None


def _setting(ui: Widgets, fact: Fact, value: Any, name: str) -> Any | None:
    """A row for a setting; its new value."""
    known, tip = rule_of(fact, OneOf), f"{fact.means}."
    label = LABELS.get(name, name)
    if known is not None:
        words = [word.replace("_", " ") for word in known.values]
        chosen = ui.choice(label, known.values.index(value), words, tip, name=name)
        return None if chosen is None else known.values[chosen]
    if rule_of(fact, Color) is not None:
        color = ui.color(label, value[:3], tip)
        return None if color is None else (*color, 1.0)
    assert fact.type in (int, float), f"no widget for {name}"
    number = ui.number(label, value, tip, name=name)
    return None if number is None else fact.type(number)


_OFF = object()
