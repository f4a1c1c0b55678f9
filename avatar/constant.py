"""What is made once a process and shared by everybody."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cache, wraps
from typing import ParamSpec, TypeVar, cast

from numpy import ndarray as Array

P = ParamSpec("P")
T = TypeVar("T")


def constant(make: Callable[P, T]) -> Callable[P, T]:
    """`functools.cache`, and all arrays in what is made are read-only: written to, they would be so for the process."""

    @wraps(make)
    def made(*arguments: P.args, **named: P.kwargs) -> T:
        out = make(*arguments, **named)
        _close(out)
        return out

    return cast(Callable[P, T], cache(made))


def _close(value: object) -> None:
    if isinstance(value, Array):
        value.flags.writeable = False
    elif is_dataclass(value):
        for entry in fields(value):
            _close(getattr(value, entry.name))
    elif isinstance(value, tuple | list):
        for entry in value:
            _close(entry)
    elif isinstance(value, dict):
        for entry in value.values():
            _close(entry)
