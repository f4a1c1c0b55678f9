"""Command lines made of settings: names, types, choices, defaults and help of options come from a dataclass's fields.

size: Annotated[int, AtLeast(64), Option(("-s",), "PIXELS"), OptionGroup("picture").rare, "of the picture"] = 520
"""

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, NamedTuple, NoReturn, TypeVar, get_args, get_origin

from command.settings import LARGEST_INTEGER, OneOf, Setting, broken_rule, rule_of, settings_of

Record = TypeVar("Record")


class Option(NamedTuple):
    """How a field stands on the command line; without it the field is `--its-name`.

    names: as written, `-o`; for a switch that turns a True field off, its name. Empty: the field's own.
    metavar: what stands for the value in the help.
    parse: text to value, raising argparse.ArgumentTypeError; none: by the field's type.
    positional: given by its place. several: any number of values, as a tuple. repeated: the option may be given often.
    const: the value where the option stands without one. exclusive: at most one option of such a set is given.
    """

    names: tuple[str, ...] = ()
    metavar: str | None = None
    parse: Callable[[str], object] | None = None
    positional: bool = False
    several: bool = False
    repeated: bool = False
    const: object = None
    exclusive: str = ""


class OptionGroup(NamedTuple):
    """Where the field stands in a command's help: under this title; one that is not common in --help-all alone."""

    title: str
    common: bool = True

    @property
    def rare(self) -> "OptionGroup":
        """The same group for an option that few need."""
        return self._replace(common=False)


class Hidden(NamedTuple):
    """The field is no option of the command line."""


class Several(NamedTuple):
    """The field is made of several options: `add` gives them to a command line, as argparse's add_argument takes them
    with the group of each, `read` makes the value of what was given."""

    add: Callable[..., None]
    read: Callable[[Mapping[str, Any]], Any]


class Help(NamedTuple):
    """What a command says of itself; `more` stands in --help-all alone."""

    command: str
    description: str
    epilog: str = ""
    more: str = ""


def parse(record: type[Record], argv: Sequence[str], about: Help) -> Record:
    """The dataclass that a command line fills; a mistake ends the program with one line and exit code 2.

    A field that is a dataclass itself gives its own fields to the command line.
    """
    parser = parser_of(record, about, everything="--help-all" in argv)
    found, unknown = parser.parse_known_args(argv)
    if unknown:
        options = [name for action in parser._actions for name in action.option_strings]
        near = [get_close_matches(word.partition("=")[0], options, 1) for word in unknown if word.startswith("--")]
        meant = f"; did you mean {near[0][0]}?" if near and near[0] else ""
        parser.error(f"unrecognized arguments: {' '.join(unknown)}{meant}")
    try:
        return _filled(record, vars(found), parser)
    except ValueError as error:
        parser.error(str(error))


def _filled(record: type[Record], given: Mapping[str, object], parser: "_Parser") -> Record:
    values = {}
    for setting in settings_of(record):
        several = rule_of(setting, Several)
        if several is not None:
            values[setting.name] = several.read(given)
        elif _inner(setting):
            values[setting.name] = _filled(setting.table, given, parser)
        elif rule_of(setting, Hidden) is None:
            value = given[setting.name]
            values[setting.name] = value = tuple(value) if isinstance(value, list) else value
            problem = None if value is None else broken_rule(setting, value)
            if problem:
                parser.error(f"argument {_shown(setting)}: {problem}")
    return record(**values)


def _inner(setting: Setting) -> bool:
    """Whether the field's own fields are options."""
    return setting.table is not None and rule_of(setting, Option) is None


def parser_of(record: type, about: Help, *, everything: bool = False) -> "_Parser":
    """The parser of a dataclass's fields: names, types, choices, defaults and help come from the fields. Its help has
    the rare ones where `everything` is asked for."""
    parser = _Parser(about, everything)
    parser.add_fields(record)
    parser.add_argument("-h", "--help", action="help", help="this list")
    if parser.rare:
        parser.add_argument("--help-all", action="help", help=f"all options, {parser.rare} more")
    words = [about.command]
    for action in sorted(parser._actions, key=lambda action: bool(action.option_strings)):
        name = str(action.metavar or action.dest)
        name += " ..." * (action.nargs in ("*", "+") and " " not in name)
        if action.required and action.nargs != "*":
            words.append(" ".join([*action.option_strings[:1], name]))
        elif not action.option_strings:
            words.append(f"[{name}]")
    parser.usage = " ".join([*words, "[options]"])
    return parser


class _HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Texts as they are broken into lines."""

    def _split_lines(self, text: str, width: int) -> list[str]:
        return [part for line in text.splitlines() for part in super(_HelpFormatter, self)._split_lines(line, width)]


class _Parser(argparse.ArgumentParser):
    """A command's parser. A mistake is one line: the options of `selfscan render` are twenty lines, and hide it."""

    def __init__(self, about: Help, everything: bool):
        epilog = f"{about.epilog}\n{about.more}" if everything else about.epilog
        super().__init__(
            about.command, description=about.description, epilog=epilog or None, add_help=False,
            formatter_class=_HelpFormatter,
        )  # fmt: skip
        self.everything, self.rare = everything, 0
        self.groups: dict[str, Any] = {}

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message}; `{self.prog} --help` lists the options\n")

    def add_fields(self, record: type) -> None:
        """An option for each field."""
        for setting in settings_of(record):
            several, option = rule_of(setting, Several), rule_of(setting, Option) or Option()
            if several is not None:
                several.add(self.add_grouped)
            elif _inner(setting):
                self.add_fields(setting.table)
            elif rule_of(setting, Hidden) is None:
                self.add_grouped(
                    rule_of(setting, OptionGroup), *_names(setting, option), exclusive=option.exclusive,
                    **_keywords(setting, option),
                )  # fmt: skip

    def add_grouped(self, group: OptionGroup | None, *names: str, exclusive: str = "", **keywords: Any) -> None:
        """`add_argument` under the title of its group."""
        into: Any = self
        if group is not None:
            if not group.common:
                self.rare += 1
                keywords["help"] = keywords["help"] if self.everything else argparse.SUPPRESS
            into = self.groups.get(group.title) or self.add_argument_group(group.title)
            self.groups[group.title] = into
        if exclusive:
            into = self.groups.setdefault(f"one of {exclusive}", into.add_mutually_exclusive_group())
        into.add_argument(*names, **keywords)


def _names(setting: Setting, option: Option) -> tuple[str, ...]:
    if option.positional:
        return (setting.name,)
    return option.names or ("--" + setting.name.replace("_", "-"),)


def _shown(setting: Setting) -> str:
    option = rule_of(setting, Option) or Option()
    if option.positional:
        return option.metavar or setting.name
    # with its unit
    return " ".join(filter(None, ["/".join(_names(setting, option)), option.metavar]))


def _keywords(setting: Setting, option: Option) -> dict[str, Any]:
    """Keyword arguments of argparse's add_argument for a field."""
    if setting.type is bool:
        action = "store_false" if setting.default is True else "store_true"
        return {"dest": setting.name, "action": action, "default": setting.default, "help": setting.means}
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
_READERS: dict[object, Callable[[str], object]] = {int: integer, float: number, Path: Path, str: str}


def _reader(kind: object) -> Callable[[str], object]:
    """How text becomes a value of a type; of a tuple, of each of its members."""
    if get_origin(kind) is tuple:
        kind = get_args(kind)[0]
    return str if get_origin(kind) is Literal else _READERS[kind]
