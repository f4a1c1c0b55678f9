"""Reads and writes scene.toml. Every complaint names the file, the line and the key, what was expected and what was
found."""

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from pathlib import Path

from command.errors import AssetError
from command.settings import (
    RGBA,
    Color,
    KeyPath,
    Refused,
    Rows,
    SettingsSource,
    record_of,
    rule_of,
    settings_of,
    with_files,
)
from files.input_file import one_line, read_text
from files.whole import write_text
from player.scene.scene import Scene

LARGEST_FILE = 1 << 20  # bytes; a scene is a page of text
MOST_DOTS = 1000
# the lines of one value, as far as its place in the file is looked for
MOST_LINES = 200


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
    try:
        return record_of(Scene, content, SettingsSource(path.parent), shown="a scene")
    except Refused as error:
        raise AssetError(f"{path}:{line_of(text, error.at)}: {error}") from None


def write_scene(path: Path | str, scene: Scene) -> None:
    """Write what of a scene is not as usual, whole or not at all. Files in the scene's folder are named relative to it,
    so that both can be moved together; others by their whole paths."""
    folder = Path(path).absolute().parent

    def placed(name: str) -> str:
        whole = Path(name).absolute()
        inside = whole.relative_to(folder).as_posix() if whole.is_relative_to(folder) else str(whole)
        # a bare word may be the name of a built-in thing
        return inside if "." in inside or "/" in inside else f"./{inside}"

    write_text(path, "\n".join([*_lines(with_files(scene, placed)), ""]).lstrip("\n"))


def _lines(record: object, table: str = "") -> Iterator[str]:
    """The lines of a table: its own keys, then the tables in it."""
    settings = [(setting, setting.value_in(record)) for setting in settings_of(type(record))]
    settings = [(setting, value) for setting, value in settings if value is not None and value != setting.default]
    inner = [is_dataclass(value) or rule_of(setting, Rows) is not None for setting, value in settings]
    for (setting, value), table_like in zip(settings, inner, strict=True):
        if not table_like:
            yield f"{setting.key} = {_hex(value) if rule_of(setting, Color) else _toml(value)}"
    for (setting, value), table_like in zip(settings, inner, strict=True):
        name = f"{table}{setting.key}"
        for one in (value if isinstance(value, tuple) else (value,)) if table_like else ():
            yield from ("", f"[[{name}]]" if isinstance(value, tuple) else f"[{name}]")
            yield from _lines(one, f"{name}.")


def _toml(value: object) -> str:
    """A string, a number, or several in brackets."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    # JSON leaves one control character as it is that TOML does not allow
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _hex(color: RGBA) -> str:
    """#rrggbb or #rrggbbaa of a premultiplied color."""
    straight = [part / (color[3] or 1.0) for part in color[:3]] + [color[3]] * (color[3] < 1)
    return json.dumps("#" + "".join(f"{round(255 * part):02x}" for part in straight))


def line_of(text: str, at: KeyPath) -> int:
    """The line, from 1, of a key of a TOML text that parses, or of the nearest table round it; else the last."""
    lines = lines_of_keys(text)
    return next((lines[at[:end]] for end in range(len(at), 0, -1) if at[:end] in lines), text.count("\n") + 1)


def lines_of_keys(text: str) -> dict[KeyPath, int]:
    """The line, from 1, of every key and table header of a TOML text that parses, up to a value of MOST_LINES lines.

    As many lines as it takes to parse are a header, or a key and its value.
    """
    lines: dict[KeyPath, int] = {}
    counts: dict[KeyPath, int] = {}
    here: KeyPath = ()
    begin, rows = 0, text.split("\n")
    for end in range(1, len(rows) + 1):
        if end - begin > MOST_LINES:
            break
        try:
            content = tomllib.loads("\n".join(rows[begin:end]))
        except tomllib.TOMLDecodeError:
            continue
        if rows[begin].lstrip().startswith("["):
            inner, here = content, ()
            while isinstance(inner, dict) and inner:
                name, inner = next(iter(inner.items()))
                here = (*here, name)
            if isinstance(inner, list):
                counts[here] = counts.get(here, -1) + 1
                here = (*here, counts[here])
            # [avatar.x] belongs to the last [[avatar]]
            elif here and here[:1] in counts:
                here = (here[0], counts[here[:1]], *here[1:])
            lines[here] = begin + 1
        else:
            for key in _keys(content):
                lines.setdefault((*here, *key), begin + 1)
        begin = end
    return lines


def _keys(table: Mapping[str, object], at: KeyPath = ()) -> Iterator[KeyPath]:
    """Every key of a table, those of the tables in it too."""
    for name, value in table.items():
        yield (*at, name)
        if isinstance(value, dict):
            yield from _keys(value, (*at, name))


def _with_line(path: Path, message: str) -> str:
    place = re.search(r"\(at line (\d+), column (\d+)\)$", message)
    if place is None:
        return f"{path}: {message}"
    return f"{path}:{place[1]}: {message[: place.start()].strip()}, column {place[2]}"
