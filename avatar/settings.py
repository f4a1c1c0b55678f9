"""Settings, written once: a frozen dataclass says what a setting is, its default, its limits and what it means.

    rate: Annotated[float, Above(0), "frames per second"] = 30.0

Command lines (`parse`), scene files (player/scenes/scene_file.py), their schema and tables (scene_schema.py) and what a
run records are all read from the same fields.
"""

import argparse
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from types import UnionType
from typing import Any, Literal, NamedTuple, NoReturn, TypeVar, Union, cast, get_args, get_origin, get_type_hints

Record = TypeVar("Record")
Rule = TypeVar("Rule")

# no count, size or seed of ours needs more; NumPy and OpenGL take it as it is
LARGEST_INTEGER = 2**53


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
    """#rrggbb or #rrggbbaa in a file, premultiplied RGBA in [0,1] in memory."""


class Place(NamedTuple):
    """A file or folder, in a file named relative to it; words in `names` are none."""

    names: tuple[str, ...] = ()


class Option(NamedTuple):
    """How a field stands on the command line; without it the field is `--its-name`.

    names: as written, `-o`; for a switch that turns a True field off, its name. Empty: the field's own.
    metavar: what stands for the value in the help.
    parse: text to value, raising argparse.ArgumentTypeError; none: by the field's type.
    positional: given by its place. several: any number of values, as a tuple. repeated: the option may be given often.
    const: the value where the option stands without one. group: at most one option of a group is given.
    """

    names: tuple[str, ...] = ()
    metavar: str | None = None
    parse: Callable[[str], Any] | None = None
    positional: bool = False
    several: bool = False
    repeated: bool = False
    const: Any = None
    group: str = ""


class Hidden(NamedTuple):
    """The field is no option of the command line."""


class Several(NamedTuple):
    """The field is made of several options: `add` puts them on a parser, `read` makes the value of what was given."""

    add: Callable[[argparse.ArgumentParser], None]
    read: Callable[[Mapping[str, Any]], Any]


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


def rule_of(setting: Setting, kind: type[Rule]) -> Rule | None:
    """The rule of this kind, if the field has one."""
    return next((rule for rule in setting.rules if isinstance(rule, kind)), None)


def settings_of(record: type) -> Iterator[Setting]:
    """The fields of a dataclass, in order."""
    hints = get_type_hints(record, include_extras=True)
    for entry in fields(record):
        kind, *notes = get_args(hints[entry.name])
        union = get_origin(kind) in (Union, UnionType)
        options = [one for one in get_args(kind) if one is not type(None)] if union else []
        optional = bool(options) and type(None) in get_args(kind)
        default = entry.default_factory() if entry.default_factory is not MISSING else entry.default
        rules = tuple(note for note in notes if not isinstance(note, str))
        yield Setting(entry.name, options[0] if optional else kind, optional, default, rules, notes[-1])


def broken_rule(setting: Setting, value: Any) -> str | None:
    """What a value of the right type breaks, as "expected ..., found ...", or None."""
    numbers = value if isinstance(value, tuple) else (value,)
    for number in numbers:
        if isinstance(number, float) and not math.isfinite(number):
            return f"expected a finite number, found {value}"
        if isinstance(number, int) and abs(number) > LARGEST_INTEGER:
            return f"expected at most {LARGEST_INTEGER}, found a number of {len(str(abs(number)))} digits"
    for rule in setting.rules:
        for number in numbers:
            if isinstance(rule, OneOf) and number not in rule.values:
                return f"expected one of {', '.join(rule.values)}, found {number!r}"
            if isinstance(rule, Above) and not number > rule.least:
                return f"expected more than {rule.least:g}, found {number:g}"
            if isinstance(rule, AtLeast) and not number >= rule.least:
                return f"expected at least {rule.least:g}, found {number:g}"
            if isinstance(rule, AtMost) and not number <= rule.most:
                return f"expected at most {rule.most:g}, found {number:g}"
    return None


def check(record: Any) -> None:
    """Refuse a dataclass whose values break their rules.

    Raises:
        ValueError: naming the field, what is expected and what was found.
    """
    for setting in settings_of(type(record)):
        value = getattr(record, setting.name)
        problem = None if value is None else broken_rule(setting, value)
        if problem:
            raise ValueError(f"{setting.name}: {problem}")


# -- command lines


class Help(NamedTuple):
    """What a command says of itself."""

    command: str
    description: str
    epilog: str = ""


def parse(record: type[Record], argv: Sequence[str], about: Help) -> Record:
    """The dataclass that a command line fills; a mistake ends the program with one line and exit code 2.

    A field that is a dataclass itself gives its own fields to the command line.
    """
    parser = parser_of(record, about)
    found, unknown = parser.parse_known_args(argv)
    if unknown:
        options = [name for action in parser._actions for name in action.option_strings]
        near = [get_close_matches(word.partition("=")[0], options, 1) for word in unknown if word.startswith("--")]
        meant = f"; did you mean {near[0][0]}?" if near and near[0] else ""
        parser.error(f"unrecognized arguments: {' '.join(unknown)}{meant}")
    given = vars(found)
    try:
        return _filled(record, given, parser)
    except ValueError as error:
        parser.error(str(error))


def _filled(record: type[Record], given: dict[str, Any], parser: argparse.ArgumentParser) -> Record:
    values = {}
    for setting in settings_of(record):
        if rule_of(setting, Hidden) is not None:
            continue
        several = rule_of(setting, Several)
        if several is not None:
            values[setting.name] = several.read(given)
            continue
        if is_dataclass(setting.type) and rule_of(setting, Option) is None:
            values[setting.name] = _filled(cast(type, setting.type), given, parser)
            continue
        value = given[setting.name]
        values[setting.name] = tuple(value) if isinstance(value, list) else value
        problem = None if value is None else broken_rule(setting, values[setting.name])
        if problem:
            parser.error(f"argument {_shown(setting)}: {problem}")
    return record(**values)


def parser_of(record: type, about: Help) -> argparse.ArgumentParser:
    """The parser of a dataclass's fields: names, types, choices, defaults and help come from the fields."""
    parser = _Parser(
        prog=about.command,
        description=about.description,
        epilog=about.epilog or None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_options(parser, record, {})
    return parser


class _Parser(argparse.ArgumentParser):
    """A mistake is one line: the usage of `selfscan render` is twenty, and hides it."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}; `{self.prog} --help` lists the options\n")


def _add_options(parser: argparse.ArgumentParser, record: type, groups: dict[str, Any]) -> None:
    for setting in settings_of(record):
        if rule_of(setting, Hidden) is not None:
            continue
        several = rule_of(setting, Several)
        if several is not None:
            several.add(parser)
            continue
        if is_dataclass(setting.type) and rule_of(setting, Option) is None:
            _add_options(parser, cast(type, setting.type), groups)
            continue
        option = rule_of(setting, Option) or Option()
        into: Any = parser
        if option.group:
            if option.group not in groups:
                groups[option.group] = parser.add_mutually_exclusive_group()
            into = groups[option.group]
        into.add_argument(*_names(setting, option), **_keywords(setting, option))


def _names(setting: Setting, option: Option) -> tuple[str, ...]:
    if option.positional:
        return (setting.name,)
    return option.names or ("--" + setting.name.replace("_", "-"),)


def _shown(setting: Setting) -> str:
    option = rule_of(setting, Option) or Option()
    return option.metavar or setting.name if option.positional else "/".join(_names(setting, option))


def _keywords(setting: Setting, option: Option) -> dict[str, Any]:
    """Keyword arguments of argparse's add_argument for a field."""
    if setting.type is bool:
        off = setting.default is True
        return {
            "dest": setting.name,
            "action": "store_false" if off else "store_true",
            "default": setting.default,
            "help": setting.means,
        }
    one = rule_of(setting, OneOf)
    choices = one.values if one else get_args(setting.type) if get_origin(setting.type) is Literal else None
    keywords: dict[str, Any] = {"help": _help(setting), "type": option.parse or _reader(setting.type)}
    if choices:
        keywords["choices"] = choices
    metavar = option.metavar or (None if choices else _METAVARS.get(setting.type))
    if metavar:
        keywords["metavar"] = metavar
    if option.positional:
        if option.several:
            keywords["nargs"] = "*" if setting.default is not MISSING else "+"
        elif setting.default is not MISSING:
            keywords |= {"nargs": "?", "default": setting.default}
        return keywords
    keywords["dest"] = setting.name
    if setting.default is MISSING:
        keywords["required"] = True
    else:
        keywords["default"] = setting.default
    if option.repeated:
        keywords |= {"action": "append", "default": None}
        if setting.default is not MISSING:
            keywords["default"] = list(setting.default)
    elif option.several:
        keywords["nargs"] = "+"
    elif option.const is not None:
        keywords |= {"nargs": "?", "const": option.const}
    return keywords


def _help(setting: Setting) -> str:
    """What the field means, and its default where it says something."""
    text = setting.means.replace("%", "%%")
    default = setting.default
    if default in (MISSING, None, ()) or "default" in text:
        return text
    shown = f"{default:g}" if isinstance(default, float) else str(default)
    return f"{text} (default: {shown})".replace("%%%%", "%%")


def integer(text: str) -> int:
    """A whole number of bounded length."""
    digits = text.strip().removeprefix("-").removeprefix("+")
    if not digits.isascii() or not digits.isdigit():
        raise argparse.ArgumentTypeError(f"expected a whole number, found {_short(text)}")
    if len(digits.lstrip("0")) > 16 or int(digits) > LARGEST_INTEGER:
        raise argparse.ArgumentTypeError(f"expected at most {LARGEST_INTEGER}, found {_short(text)}")
    return int(text)


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"expected a finite number, found {_short(text)}")
    return value


def _short(text: str) -> str:
    return repr(text if len(text) <= 40 else text[:37] + "...")


_METAVARS = {int: "N", float: "X", Path: "PATH"}


def _reader(kind: Any) -> Callable[[str], Any]:
    """How text becomes a value of a type; of a tuple, of each of its members."""
    if get_origin(kind) is tuple:
        kind = get_args(kind)[0]
    if get_origin(kind) is Literal:
        return str
    readers: dict[Any, Callable[[str], Any]] = {int: integer, float: number, Path: Path, str: str}
    return readers[kind]


def settings_json(record: Any) -> dict[str, Any]:
    """The fields of a settings record as JSON holds them, for run.json and provenance."""
    out = {}
    for entry in fields(record):
        value = getattr(record, entry.name)
        out[entry.name] = str(value) if isinstance(value, Path) else list(value) if isinstance(value, tuple) else value
    return out
