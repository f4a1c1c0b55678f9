"""Reads scene.toml. Every complaint names the file, the line and the key, what was expected and what was found."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

from command.errors import AssetError
from command.settings import KeyPath, Refused, SettingsSource, record_of
from files.input_file import one_line, read_text
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
