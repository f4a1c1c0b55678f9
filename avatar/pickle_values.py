"""What a pickle is read into: its bytes, the names it asks for, values under construction, and why it is refused."""

from typing import Any, NamedTuple

import numpy as np


class Refused(Exception):
    """Why a pickle is not read; becomes the AssetError."""


class Name(NamedTuple):
    """A class or function that the pickle names."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"[:100]


class Built:
    """A value under construction: made by REDUCE or NEWOBJ, filled by BUILD, taken out at the end."""

    def __init__(self, kind: str, value: Any = None):
        self.kind, self.value = kind, value


class Source:
    """The bytes of a pickle, read forward, and how much memory was spent on arrays made from them."""

    def __init__(self, data: bytes, most: int):
        self.data, self.at = data, 0
        self.spent, self.most = 0, most

    def take(self, count: int) -> bytes:
        end = self.at + count
        if count < 0 or end > len(self.data):
            raise Refused(f"the file ends at byte {len(self.data)}, {end - len(self.data)} too early")
        piece, self.at = self.data[self.at : end], end
        return piece

    def line(self) -> bytes:
        end = self.data.find(b"\n", self.at)
        if end < 0:
            raise Refused(f"the file ends within the line at byte {self.at}")
        piece, self.at = self.data[self.at : end], end + 1
        return piece

    def unsigned(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def text_line(self) -> str:
        piece = self.line()
        return piece.rstrip(b"\r").decode("utf-8", "replace")

    def spend(self, size: int) -> None:
        self.spent += size
        if self.spent > self.most:
            raise Refused(f"arrays of more than {self.most} bytes")


def shown(value: Any) -> str:
    """A value for a message: its kind where it is large."""
    if isinstance(value, Built):
        return f"a {value.kind}"
    if isinstance(value, Exception):
        return str(value)[:120] or type(value).__name__
    if isinstance(value, (str, bytes, int, float, type(None))):
        return repr(value)[:60] if not isinstance(value, int) or abs(value) < 1 << 64 else "a long number"
    if type(value) is tuple and len(value) < 9 and all(type(v) is int and abs(v) < 1 << 64 for v in value):
        return repr(value)
    return f"a {type(value).__name__}"


def raw(value: Any) -> bytes:
    if isinstance(value, str):
        return value.encode("latin1")
    if isinstance(value, bytes):
        return value
    raise ValueError(f"bytes that are {shown(value)}")


def text(value: Any) -> str:
    if isinstance(value, bytes):
        return value.decode("latin1")
    if isinstance(value, str):
        return value
    raise ValueError(f"text that is {shown(value)}")


def dtype_of(value: Any) -> np.dtype | None:
    """The NumPy type, None for objects."""
    if not isinstance(value, Built) or value.kind != "dtype":
        raise ValueError(f"a type that is {shown(value)}")
    code, order = value.value
    return None if code[0] == "O" else np.dtype((order if order != "|" else "=") + code)


def plain_items(arguments: tuple) -> list[Any]:
    if not arguments:
        return []
    if len(arguments) != 1 or type(arguments[0]) not in (list, tuple):
        raise ValueError(f"arguments that are {shown(arguments)}")
    return list(arguments[0])


def valid_shape(shape: Any) -> bool:
    return type(shape) is tuple and len(shape) <= 8 and all(type(n) is int and 0 <= n < 1 << 40 for n in shape)


def product(shape: tuple) -> int:
    size = 1
    for n in shape:
        size *= n
    return size
