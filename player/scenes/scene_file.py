"""Reads scene.toml. Every complaint names the file, the line and the key, what was expected and what was found."""

import difflib
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING
from pathlib import Path
from typing import Any, NoReturn, get_args, get_origin

from avatar.errors import AssetError
from avatar.input_file import one_line, read_text
from avatar.settings import Color, Place, Setting, broken_rule, settings_of
from player.address import PORTS, parse_address
from player.passes.background import Background
from player.scenes.effects import STUDIO, Effects
from player.scenes.scene import MOST_AVATARS, Scene, SceneAvatar, SceneCamera, keys_outside_tables

# ("avatar", 1, "motion") is `motion` of the second [[avatar]]
KeyPath = tuple[str | int, ...]

HEADER = re.compile(r"^\s*(\[\[|\[)\s*([^\]]+?)\s*\]\]?\s*(?:#.*)?$")
KEY = re.compile(r"""^\s*((?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*'))*)\s*=""")
STRINGS = re.compile(r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*', re.DOTALL)
LARGEST_FILE = 1 << 20  # bytes; a scene is a page of text
MOST_DOTS = 1000
# beyond it nothing that a scene says has a meaning, and squares still are numbers
LARGEST_NUMBER = 1e18
SCALARS = {str: "a string", float: "a number", int: "a whole number", bool: "true or false"}


def read_scene(path: Path | str) -> Scene:
    """The scene in a file. Paths in it count from the file's folder.

    Raises:
        AssetError: no TOML, an unknown key, a wrong value, or a file that is not there, by line and key.
    """
    path = Path(path)
    text = read_text(path, "a scene", most=LARGEST_FILE)
    # the parser walks every part of a key from the first one
    if max(line.count(".") for line in text.split("\n")) > MOST_DOTS:
        raise AssetError(f"{path}: expected at most {MOST_DOTS} dots in a line")
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise AssetError(_with_line(path, str(error))) from None
    except RecursionError:
        raise AssetError(f"{path}: nested too deeply") from None
    except ValueError as error:  # a whole number of thousands of digits
        raise AssetError(f"{path}: {one_line(error)}") from None
    return _Reader(path, text).scene(content)


def lines_of_keys(text: str) -> dict[KeyPath, int]:
    """The line, from 1, of every key and table header of a TOML text that parses.

    Keys inside an inline table are not listed: they stand on the line of the table's own key.
    """
    # strings and comments may hold anything: blank them, keeping their line ends
    bare = STRINGS.sub(lambda match: _blanked(match[0]), text)
    lines: dict[KeyPath, int] = {}
    here: KeyPath = ()
    counts: dict[KeyPath, int] = {}
    open_brackets = 0
    for number, (line, raw) in enumerate(zip(bare.split("\n"), text.split("\n"), strict=True), 1):
        header = HEADER.match(line) if open_brackets == 0 else None
        key = KEY.match(raw) if open_brackets == 0 else None
        if header:
            here = tuple(_parts(HEADER.match(raw)[2] if HEADER.match(raw) else header[2]))  # type: ignore[index]
            if header[1] == "[[":
                counts[here] = counts.get(here, -1) + 1
                here = (*here, counts[here])
            elif here[:1] in counts:  # [avatar.x] belongs to the last [[avatar]]
                here = (here[0], counts[here[:1]], *here[1:])
            lines[here] = number
        elif key and KEY.match(line):
            parts = _parts(key[1])
            for end in range(1, len(parts) + 1):
                lines.setdefault((*here, *parts[:end]), number)
        if not header:
            open_brackets += sum(line.count(c) for c in "[{") - sum(line.count(c) for c in "]}")
    return lines


def _blanked(piece: str) -> str:
    """A string as an empty one of the same lines, so that a quoted key still looks like a key; a comment as nothing."""
    if piece.startswith("#"):
        return ""
    return '""' + "\n" * piece.count("\n")


def _parts(key: str) -> tuple[str, ...]:
    return tuple(part.strip().strip("\"'") for part in re.findall(r'"[^"]*"|\'[^\']*\'|[^.\s]+', key))


def _with_line(path: Path, message: str) -> str:
    place = re.search(r"\(at line (\d+), column (\d+)\)$", message)
    if place is None:
        return f"{path}: {message}"
    return f"{path}:{place[1]}: {message[: place.start()].strip()}, column {place[2]}"


class _Reader:
    """One file being read."""

    def __init__(self, path: Path, text: str):
        self.path, self.lines, self.last = path, lines_of_keys(text), text.count("\n") + 1

    def scene(self, content: Mapping[str, Any]) -> Scene:
        sections = {
            "avatar": SceneAvatar,
            "camera": SceneCamera,
            "background": Background,
            "effects": Effects,
        }
        own = {setting.name: setting for setting in keys_outside_tables()}
        self.known((), content, [*sections, *own])
        fields: dict[str, Any] = {
            name: self.value((name,), setting, content[name]) for name, setting in own.items() if name in content
        }
        for name, plural in (("avatar", "avatars"), ("camera", "cameras")):
            if name in content:
                rows = content[name]
                if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
                    self.fail((name,), f"expected [[{name}]], found {_kind(rows)}")
                fields[plural] = tuple(
                    self.record((name, i), sections[name], row, f"[[{name}]]") for i, row in enumerate(rows)
                )
        for name, record in (("background", Background), ("effects", Effects)):
            if name in content:
                if not isinstance(content[name], dict):
                    self.fail((name,), f"expected a table, [{name}], found {_kind(content[name])}")
                fields[name] = self.record((name,), record, content[name], f"[{name}]")
        if not fields.get("avatars"):
            raise AssetError(f"{self.path}: expected at least one [[avatar]], found none")
        if len(fields["avatars"]) > MOST_AVATARS:
            found = len(fields["avatars"])
            raise AssetError(f"{self.path}: expected at most {MOST_AVATARS} [[avatar]], found {found}")
        return Scene(**fields)

    def record(self, at: KeyPath, record: type, table: Mapping[str, Any], shown: str) -> Any:
        """A table as a dataclass."""
        by_name = {setting.name: setting for setting in settings_of(record)}
        self.known(at, table, list(by_name), shown)
        values = {name: self.value((*at, name), by_name[name], table[name]) for name in table}
        for setting in by_name.values():
            if setting.default is MISSING and setting.name not in table:
                self.fail(at, f"{shown} needs the key {setting.name}: {setting.means}")
        if record is Background:
            values = self.background(at, table, values)
        if values.get("live") is not None:
            try:
                parse_address(values["live"], tuple(PORTS))
            except ValueError as error:
                self.fail((*at, "live"), str(error))
        try:
            return record(**values)
        except ValueError as error:  # rules between keys
            named = next((name for name in by_name if name in table and name in str(error).split(":")[0]), None)
            self.fail((*at, named) if named else at, str(error))

    def background(self, at: KeyPath, table: Mapping[str, Any], values: dict[str, Any]) -> dict[str, Any]:
        kind = values.get("kind", "color")
        if kind == "transparent" and "color" in table:
            self.fail((*at, "color"), "a transparent background takes no color")
        return values if kind == "transparent" else {"color": STUDIO.color, **values}

    def known(self, at: KeyPath, table: Mapping[str, Any], names: list[str], shown: str = "a scene") -> None:
        """Refuse keys that nothing reads."""
        for key in table:
            if key not in names:
                near = difflib.get_close_matches(key.lower(), names, 1, 0.5)
                hint = f"did you mean {near[0]}?" if near else f"{shown} has {', '.join(names)}"
                self.fail((*at, key), f"unknown key in {shown}; {hint}")

    def value(self, at: KeyPath, setting: Setting, found: Any) -> Any:
        """A value of the type and within the rules of its field."""
        if setting.table is not None:
            shown = f"[{'.'.join(map(str, at))}]"
            if not isinstance(found, dict):
                self.fail(at, f"expected a table, {shown}, found {_kind(found)}")
            return self.record(at, setting.table, found, shown)
        if any(isinstance(rule, Color) for rule in setting.rules):
            return self.color(at, found)
        value = self.typed(at, setting.type, found)
        problem = broken_rule(setting, value)
        if problem:
            self.fail(at, problem)
        place = next((rule for rule in setting.rules if isinstance(rule, Place)), None)
        is_background = at[0] == "background" and at[-1] == "path"
        if is_background or (place is not None and value not in place.names):
            return self.file(at, value, place.names if place else ())
        return value

    def typed(self, at: KeyPath, kind: Any, found: Any) -> Any:
        if get_origin(kind) is tuple:
            each = get_args(kind)
            if not isinstance(found, list) or len(found) != len(each):
                what = SCALARS[each[0]].removeprefix("a ")
                length = f", found {len(found)} of them" if isinstance(found, list) else f", found {_kind(found)}"
                self.fail(at, f"expected {len(each)} {what}s in brackets{length}")
            return tuple(self.typed(at, one, item) for one, item in zip(each, found, strict=True))
        right = type(found) is kind or (kind is float and type(found) is int)  # true is no number
        if not right:
            self.fail(at, f"expected {SCALARS[kind]}, found {_kind(found)}")
        if kind in (int, float) and LARGEST_NUMBER <= abs(found) != math.inf:
            self.fail(at, f"expected a number below {LARGEST_NUMBER:g}, found {_kind(found)}")
        return kind(found)

    def color(self, at: KeyPath, found: Any) -> tuple[float, float, float, float]:
        """#rrggbb or #rrggbbaa, as premultiplied RGBA."""
        match = re.fullmatch(r"#([0-9a-fA-F]{6})([0-9a-fA-F]{2})?", found) if isinstance(found, str) else None
        if match is None:
            self.fail(at, f"expected #rrggbb or #rrggbbaa, found {_kind(found)}")
        alpha = int(match[2] or "ff", 16) / 255
        red, green, blue = (int(match[1][i : i + 2], 16) / 255 * alpha for i in (0, 2, 4))
        return red, green, blue, alpha

    def file(self, at: KeyPath, value: str, names: tuple[str, ...]) -> str:
        """A path as it counts from here. It has to be there."""
        try:
            place = self.path.parent / Path(value).expanduser()
            there = place.exists()
        except (ValueError, OSError, RuntimeError) as error:  # a NUL, a name too long, ~ of a user who is not there
            self.fail(at, f"{_kind(value)} is no path: {one_line(error)}")
        if not there:
            or_name = f" (and it is none of {', '.join(names)})" if names else ""
            self.fail(at, f"no such file: {place}{or_name}")
        return str(place)

    def fail(self, at: KeyPath, problem: str) -> NoReturn:
        """Complain about a key, or the nearest table round it that has a line of its own."""
        line = next((self.lines[at[:end]] for end in range(len(at), 0, -1) if at[:end] in self.lines), self.last)
        words = []
        for part in at:
            words.append(f"{words.pop()} {part + 1}" if isinstance(part, int) else part)
        raise AssetError(f"{self.path}:{line}: {'.'.join(words)}: {problem}")


def _kind(found: Any) -> str:
    """A value of TOML in a few words."""
    if isinstance(found, bool):
        return "true" if found else "false"
    if isinstance(found, str):
        return f"the string {found!r}" if len(found) < 60 else f"a string of {len(found)} characters"
    if isinstance(found, int) and abs(found) >= 1 << 64:
        return f"a whole number of {found.bit_length()} bits"
    if isinstance(found, (int, float)):
        return f"the number {found}"
    return {list: "an array", dict: "a table"}.get(type(found), f"a {type(found).__name__}")
