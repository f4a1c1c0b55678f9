"""Commands of the project that are recorded and not run."""

from collections.abc import Callable
from types import ModuleType

import pytest


def recorded_commands(
    monkeypatch: pytest.MonkeyPatch, module: ModuleType, leave: Callable[[list[str]], int | None]
) -> list[list[str]]:
    """The words of every command that `module` runs from now on; `leave` leaves what it would have, or has a code."""
    calls: list[list[str]] = []

    def command(*words):
        def run() -> int:
            calls.append([str(word) for word in words])
            return leave(calls[-1]) or 0

        return run

    monkeypatch.setattr(module, "command", command)
    return calls
