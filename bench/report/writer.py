"""What reports are written with: tables in Markdown, numbers in them, and files of JSON and text."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from files.whole import whole_file

# an object that json.dump takes
Json = dict[str, Any]


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table; each row has as many cells as the head."""
    lines = [head, ["-"] * len(head), *rows]
    for row in lines:
        if len(row) != len(head):
            raise ValueError(f"a row of {len(head)} columns has {len(row)} cells: {row}")
    return ["|" + "|".join(f" {cell} " if cell else " " for cell in row) + "|" for row in lines]


def number(value: float | None, digits: int = 2) -> str:
    """Rounded; a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    with whole_file(path, "w") as file:
        file.write(text)


def write_json(path: Path, value: Json) -> None:
    """Write an object as JSON, one entry a line."""
    write_text(path, json.dumps(value, indent=1))
