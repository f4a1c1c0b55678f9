"""What the programs of this folder share: lines about what begins, what was absent, and how they end."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from command.errors import AssetError


def note(text: str) -> None:
    """A line about what begins, on standard error."""
    print(f"{Path(sys.argv[0]).stem}: {text}", file=sys.stderr, flush=True)


def written(page: Path, absent: Sequence[str], was_not: str = "measured") -> int:
    """Say what is missing in a page, and where it is; the program's status."""
    for line in absent:
        note(f"not {was_not}: {line}")
    print(page)
    return 1 if absent else 0


def distinct(names: Sequence[str], what: str) -> None:
    """Refuse two of one name: their results would share a folder."""
    if len(set(names)) < len(names):
        raise ValueError(f"{what} are told apart by their names, which are {', '.join(names)}")


def end_with(main: Callable[[list[str]], int | None]) -> NoReturn:
    """Run the program and end with its status, or with its error as one line."""
    try:
        raise SystemExit(main(sys.argv[1:]))
    except AssetError as error:
        raise SystemExit(f"{Path(sys.argv[0]).stem}: {error}") from None
