"""What the programs of this folder share: lines about what begins, and how they end."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from command.errors import AssetError


def note(text: str) -> None:
    """A line about what begins, on standard error."""
    print(f"{Path(sys.argv[0]).stem}: {text}", file=sys.stderr, flush=True)


def end_with(main: Callable[[], int | None]) -> NoReturn:
    """Run the program and end with its status, or with its error as one line."""
    try:
        raise SystemExit(main())
    except AssetError as error:
        raise SystemExit(f"{Path(sys.argv[0]).stem}: {error}") from None
