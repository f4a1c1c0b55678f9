"""Facts about the fields of scene dataclasses, as annotations: what is allowed, and a sentence on what it means.

    kind: Annotated[str, OneOf(("front", "orbit")), "how the camera stands"] = "front"

player/scenes/scene_file.py checks files against them, player/scenes/scene_schema.py writes them as JSON schema and
table.
"""

import math
from collections.abc import Iterator
from dataclasses import MISSING, fields
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints


class OneOf(NamedTuple):
    values: tuple[str, ...]


class Above(NamedTuple):
    least: float  # itself not allowed


class AtLeast(NamedTuple):
    least: float


class Color(NamedTuple):
    """#rrggbb or #rrggbbaa in a file, premultiplied RGBA in [0,1] in memory."""


class Place(NamedTuple):
    """A file or folder, in a file named relative to it; words in `names` are none."""

    names: tuple[str, ...] = ()


class Fact(NamedTuple):
    """One field: its type without None, what holds for it, and what it means."""

    name: str
    type: Any
    # None is allowed: the key may be left out
    optional: bool
    # MISSING: it must be given
    default: Any
    rules: tuple[Any, ...]
    means: str


def facts(record: type) -> Iterator[Fact]:
    """The fields of a dataclass, in order."""
    hints = get_type_hints(record, include_extras=True)
    for entry in fields(record):
        kind, *notes = get_args(hints[entry.name])
        options = [one for one in get_args(kind) if one is not type(None)] if get_origin(kind) is not tuple else []
        optional = bool(options) and type(None) in get_args(kind)
        default = entry.default_factory() if entry.default_factory is not MISSING else entry.default
        rules = tuple(note for note in notes if not isinstance(note, str))
        yield Fact(entry.name, options[0] if optional else kind, optional, default, rules, notes[-1])


def broken_rule(fact: Fact, value: Any) -> str | None:
    """What a value of the right type breaks, as "expected ..., found ...", or None."""
    for rule in fact.rules:
        if isinstance(rule, OneOf) and value not in rule.values:
            return f"expected one of {', '.join(rule.values)}, found {value!r}"
        low = min(value) if isinstance(value, tuple) else value
        if isinstance(rule, Above) and not low > rule.least:
            return f"expected more than {rule.least:g}, found {low:g}"
        if isinstance(rule, AtLeast) and not low >= rule.least:
            return f"expected at least {rule.least:g}, found {low:g}"
    numbers = value if isinstance(value, tuple) else (value,)
    if any(isinstance(number, float) and not math.isfinite(number) for number in numbers):
        return f"expected a finite number, found {value}"
    return None


def check(record: Any) -> None:
    """Refuse a dataclass whose values break their rules.

    Raises:
        ValueError: naming the field, what is expected and what was found.
    """
    for fact in facts(type(record)):
        value = getattr(record, fact.name)
        problem = None if value is None else broken_rule(fact, value)
        if problem:
            raise ValueError(f"{fact.name}: {problem}")
