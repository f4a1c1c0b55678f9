"""What reports are written with: tables in Markdown, and numbers in them."""

from collections.abc import Iterable, Sequence

from files.input_file import JsonObject

# an object that json.dump takes
Json = JsonObject


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
