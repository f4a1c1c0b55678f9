"""Settings, written once: a frozen dataclass says what a setting is, its default, its limits and what it means.

    rate: Annotated[float, Above(0), "frames per second"] = 30.0

A file's values meet their fields in `value_of` and `record_of`: of a scene's TOML (player/scene/scene_file.py) and of
JSON as run.json holds it (`settings_json` writes it). Command lines (command_line.py) and the schema of a scene
(experiments/scene_docs.py) are read from the same fields and keep the same rules (`broken_rule`).
"""

import math
import re
import typing
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, cast, get_args, get_origin, get_type_hints

Record = TypeVar("Record")
Rule = TypeVar("Rule")
# ("avatar", 1, "motion") is `motion` of the second avatar
KeyPath = tuple[str | int, ...]
RGBA = tuple[float, float, float, float]

# no count, size or seed of ours needs more; NumPy and OpenGL take it as it is
LARGEST_INTEGER = 2**53
# beyond it nothing that a file says has a meaning, and squares still are numbers
LARGEST_NUMBER = 1e18
SCALARS = {str: "a string", float: "a number", int: "a whole number", bool: "true or false"}


class OneOf(NamedTuple):
    """The value, or each of several, is one of these words."""

    values: tuple[str, ...]


class Above(NamedTuple):
    """The value, or each of several, is more than this."""

    least: float


class AtLeast(NamedTuple):
    """The value, or each of several, is this or more."""

    least: float


class AtMost(NamedTuple):
    """The value, or each of several, is this or less."""

    most: float


class Color(NamedTuple):
    """#rrggbb or, where it may be transparent, #rrggbbaa in a file, premultiplied RGBA in [0,1] in memory."""

    opaque: bool = False


class FilePlace(NamedTuple):
    """A file or folder, in a file named relative to it; words in `names` are none."""

    names: tuple[str, ...] = ()


class Kinds(NamedTuple):
    """The field holds one of several dataclasses; a file says which by the word `kind` beside its settings."""

    of: Mapping[str, type]


class Rows(NamedTuple):
    """The field holds tables of one kind, named so in a file, [[name]], and so many of them."""

    name: str
    least: int
    most: int


class Setting(NamedTuple):
    """One field: its type without None, what holds for it, and what it means."""

    name: str
    type: Any
    # None is allowed: the key may be left out
    optional: bool
    # MISSING: it must be given
    default: Any
    rules: tuple[Any, ...]
    means: str

    @property
    def table(self) -> Any:
        """The dataclass that the field holds, if it holds one: a table in a file."""
        return self.type if isinstance(self.type, type) and is_dataclass(self.type) else None

    def value_in(self, record: object) -> Any:
        """What a record of the dataclass has in this field."""
        return getattr(record, self.name)

    @property
    def key(self) -> str:
        """The field's name in a file."""
        rows = rule_of(self, Rows)
        return rows.name if rows else self.name


def rule_of(setting: Setting, kind: type[Rule]) -> Rule | None:
    """The rule of this kind, if the field has one."""
    return next((rule for rule in setting.rules if isinstance(rule, kind)), None)


@cache
def settings_of(record: type) -> tuple[Setting, ...]:
    """The fields of a dataclass, in order."""
    hints, out = get_type_hints(record, include_extras=True), []
    for entry in fields(record):
        hint = hints[entry.name]
        kind, *notes = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        union = get_origin(kind) in (Union, UnionType)
        options = [one for one in get_args(kind) if one is not type(None)] if union else []
        optional = bool(options) and type(None) in get_args(kind)
        default = entry.default_factory() if entry.default_factory is not MISSING else entry.default
        rules = tuple(note for note in notes if not isinstance(note, str))
        means = next((note for note in reversed(notes) if isinstance(note, str)), "")
        out.append(Setting(entry.name, options[0] if optional else kind, optional, default, rules, means))
    return tuple(out)


def broken_rule(setting: Setting, value: Any) -> str | None:
    """What a value of the right type breaks, as "expected ..., found ...", or None."""
    color = rule_of(setting, Color)
    if color is not None and color.opaque and value[3] < 1:
        return "expected an opaque color, #rrggbb"
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, float) and not math.isfinite(number):
            return f"expected a finite number, found {value}"
        if isinstance(number, int) and abs(number) > LARGEST_INTEGER:
            return f"expected at most {LARGEST_INTEGER}, found a number of {len(str(abs(number)))} digits"
        for rule in setting.rules:
            if isinstance(rule, OneOf) and number not in rule.values:
                return f"expected one of {', '.join(rule.values)}, found {number!r}"
            if isinstance(rule, Above) and not number > rule.least:
                return f"expected more than {rule.least:g}, found {number:g}"
            if isinstance(rule, AtLeast) and not number >= rule.least:
                return f"expected at least {rule.least:g}, found {number:g}"
            if isinstance(rule, AtMost) and not number <= rule.most:
                return f"expected at most {rule.most:g}, found {number:g}"
    return None


def check(record: object) -> None:
    """Refuse a dataclass whose values break their rules.

    Raises:
        ValueError: naming the field, what is expected and what was found.
    """
    for setting in settings_of(type(record)):
        value = getattr(record, setting.name)
        problem = None if value is None else broken_rule(setting, value)
        if problem:
            raise ValueError(f"{setting.name}: {problem}")


@typing.dataclass_transform(frozen_default=True, field_specifiers=(field,))
def settings(record: type[Record]) -> type[Record]:
    """Makes a class a frozen dataclass that is refused where its values break their rules.

    Raises:
        ValueError: when a record is made, as `check`; then as the class's own __post_init__.
    """
    more = vars(record).get("__post_init__", lambda self: None)

    def __post_init__(self: object) -> None:
        check(self)
        more(self)

    type.__setattr__(record, "__post_init__", __post_init__)
    return dataclass(frozen=True)(record)


# -- files


class Refused(ValueError):
    """A value that its field does not take: where it stands, what is expected and what was found."""

    def __init__(self, at: KeyPath, problem: str):
        words: list[str] = []
        for part in at:
            words.append(f"{words.pop()} {part + 1}" if isinstance(part, int) else part)
        super().__init__(f"{'.'.join(words)}: {problem}" if words else problem)
        self.at = at


class SettingsSource(NamedTuple):
    """What settings are read from: the folder that its paths count from; whether all were written, so that none may be
    absent, whatever its default."""

    folder: Path | None = None
    whole: bool = False


def record_of(record: type[Record], found: object, source: SettingsSource, at: KeyPath = (), shown: str = "") -> Record:
    """The dataclass that a table of TOML or an object of JSON fills; `shown` is what messages call it.

    Raises:
        Refused: an unknown key, one that is absent, or a value that its field does not take.
    """
    shown = shown or (f"[[{at[-2]}]]" if isinstance(at[-1], int) else f"[{'.'.join(map(str, at))}]")
    if not isinstance(found, dict):
        raise Refused(at, f"expected a table, {shown}, found {described(found)}")
    known = {setting.key: setting for setting in settings_of(record)}
    for key in found:
        if key not in known:
            near = get_close_matches(key.lower(), known, 1, 0.5)
            hint = f"did you mean {near[0]}?" if near else f"{shown} has {', '.join(known)}"
            raise Refused((*at, key), f"unknown key in {shown}; {hint}")
    values = {s.name: value_of(s, found[key], source, (*at, key)) for key, s in known.items() if key in found}
    for key, setting in known.items():
        if key not in found and (source.whole or setting.default is MISSING):
            needs = f"{shown} needs the key {key}{': ' * bool(setting.means)}{setting.means}"
            raise Refused(at, f"expected at least one [[{key}]], found none" if rule_of(setting, Rows) else needs)
    try:
        return record(**values)
    # rules between keys
    except ValueError as error:
        name = next((key for key in known if key in found and key in str(error).split(":")[0]), None)
        raise Refused((*at, name) if name else at, str(error).removeprefix(f"{name}: ")) from None


def value_of(setting: Setting, found: object, source: SettingsSource, at: KeyPath) -> Any:
    """A value of a file as its field holds it, of the right type and within the rules.

    Raises:
        Refused: it is not, or a file that it names is not there.
    """
    if found is None and setting.optional:
        return None
    kinds, rows, place = rule_of(setting, Kinds), rule_of(setting, Rows), rule_of(setting, FilePlace)
    if kinds is not None:
        word = found.get("kind") if isinstance(found, dict) else found
        if not isinstance(found, dict) or not isinstance(word, str) or word not in kinds.of:
            raise Refused((*at, "kind"), f"expected one of {', '.join(kinds.of)}, found {described(word)}")
        own = {key: value for key, value in found.items() if key != "kind"}
        return record_of(kinds.of[word], own, source, at)
    if rows is not None:
        if not isinstance(found, list) or not all(isinstance(row, dict) for row in found):
            raise Refused(at, f"expected [[{rows.name}]], found {described(found)}")
        if not rows.least <= len(found) <= rows.most:
            limit = f"at most {rows.most}" if len(found) > rows.most else f"at least {rows.least}"
            raise Refused(at, f"expected {limit} [[{rows.name}]], found {len(found) or 'none'}")
    if rule_of(setting, Color) is not None:
        color = color_of(found) if isinstance(found, str) else None
        if color is None:
            raise Refused(at, f"expected #rrggbb or #rrggbbaa, found {described(found)}")
        return color
    value = _typed(setting.type, found, source, at)
    problem = broken_rule(setting, value)
    if problem:
        raise Refused(at, problem)
    if place is None or source.folder is None or value in place.names:
        return value
    return _place(value, source.folder, place.names, at)


def _typed(kind: Any, found: Any, source: SettingsSource, at: KeyPath) -> Any:
    """A value of this type; whole numbers are numbers too, true is none."""
    if is_dataclass(kind):
        return record_of(cast(type, kind), found, source, at)
    if get_origin(kind) is tuple:
        each = get_args(kind)
        if each[-1] is ...:
            each = each[:1] * (len(found) if isinstance(found, list) else 0)
        if not isinstance(found, list) or len(found) != len(each):
            number = f"{len(each)} {SCALARS.get(each[0], 'a table').removeprefix('a ')}s" if each else "values"
            length = f"{len(found)} of them" if isinstance(found, list) else described(found)
            raise Refused(at, f"expected {number} in brackets, found {length}")
        tables = is_dataclass(each[0]) if each else False
        return tuple(
            _typed(one, item, source, (*at, i) if tables else at) for i, (one, item) in enumerate(zip(each, found))
        )
    if get_origin(kind) is Literal:
        if found not in get_args(kind):
            raise Refused(at, f"expected one of {', '.join(get_args(kind))}, found {described(found)}")
        return found
    if not (type(found) is kind or (kind is float and type(found) is int)):
        raise Refused(at, f"expected {SCALARS[kind]}, found {described(found)}")
    if kind in (int, float) and LARGEST_NUMBER <= abs(found) != math.inf:
        raise Refused(at, f"expected a number below {LARGEST_NUMBER:g}, found {described(found)}")
    return kind(found)


def _place(value: str, folder: Path, names: tuple[str, ...], at: KeyPath) -> str:
    """A path as it counts from a folder. It has to be there."""
    try:
        place = folder / Path(value).expanduser()
        there = place.exists()
    # a NUL, a name too long, ~ of a user who is not there
    except (ValueError, OSError, RuntimeError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise Refused(at, f"{described(value)} is no path: {why}") from None
    if not there:
        or_name = f" (and it is none of {', '.join(names)})" if names else ""
        raise Refused(at, f"no such file: {place}{or_name}")
    return str(place)


def with_files(record: Record, change: Callable[[str], str]) -> Record:
    """The record with every file that it names, itself or in the records that it holds, as `change` has it."""

    def changed(value: object, setting: Setting) -> object:
        place = rule_of(setting, FilePlace)
        if isinstance(value, str) and place is not None and value not in place.names:
            return change(value)
        if isinstance(value, tuple):
            return tuple(changed(one, setting) for one in value)
        return with_files(value, change) if is_dataclass(value) else value

    values = {setting.name: changed(setting.value_in(record), setting) for setting in settings_of(type(record))}
    return type(record)(**values)


def color_of(text: str) -> RGBA | None:
    """#rrggbb or #rrggbbaa as premultiplied RGBA; None: it is neither."""
    match = re.fullmatch(r"#([0-9a-fA-F]{6})([0-9a-fA-F]{2})?", text)
    if match is None:
        return None
    alpha = int(match[2] or "ff", 16) / 255
    red, green, blue = (int(match[1][i : i + 2], 16) / 255 * alpha for i in (0, 2, 4))
    return red, green, blue, alpha


def described(found: object) -> str:
    """A value of a file in a few words."""
    if isinstance(found, bool):
        return "true" if found else "false"
    if isinstance(found, str):
        return f"the string {found!r}" if len(found) < 60 else f"a string of {len(found)} characters"
    if isinstance(found, int) and abs(found) >= 1 << 64:
        return f"a whole number of {found.bit_length()} bits"
    if isinstance(found, int | float):
        return f"the number {found}"
    return {list: "an array", dict: "a table", type(None): "nothing"}.get(type(found), f"a {type(found).__name__}")


def settings_json(record: object) -> dict[str, Any]:
    """The fields of a settings record as JSON holds them, for run.json and provenance."""
    out = {}
    for setting in settings_of(type(record)):
        value, kinds = getattr(record, setting.name), rule_of(setting, Kinds)
        name = next(({"kind": word} for word, kind in kinds.of.items() if type(value) is kind), {}) if kinds else {}
        out[setting.name] = {**name, **settings_json(value)} if is_dataclass(value) else _json(value)
    return out


def _json(value: object) -> object:
    if isinstance(value, tuple):
        return [settings_json(one) if is_dataclass(one) else _json(one) for one in value]
    return str(value) if isinstance(value, Path) else value
