"""Protobuf text format (.pbtxt, .prototxt, .textproto) without a schema: nested fields, numbers, names and strings.

A field that stands more than once becomes a list, as in JSON; which fields repeat is for the reader to know.
"""

import math
import re
from pathlib import Path
from typing import Any

from avatar.errors import AssetError
from avatar.input_file import read_text

MAX_BYTES = 1 << 25
MAX_FIELDS = 500_000
MAX_DEPTH = 32
TOKEN = re.compile(
    r"(?P<space>(?:[\s,;]++|#[^\n]*+)++)"
    r"|(?P<open>[{<])|(?P<close>[}>])"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_.]*)"
    r"|(?P<colon>:)"
    r"|(?P<number>[-+]?(?:\.[0-9]+|[0-9]+\.?[0-9]*)(?:[eE][-+]?[0-9]+)?f?)"
    r'|(?P<string>"(?:[^"\\\n]|\\.)*"|\'(?:[^\'\\\n]|\\.)*\')'
)


def read_protobuf_text(path: Path | str, what: str) -> dict[str, Any]:
    """The message in a text file: field name -> value, a dict for a message, a list where the field repeats.

    Raises:
        AssetError: absent, too long, no text of this format; file and line are named.
    """
    text = read_text(path, what, most=MAX_BYTES)
    top: dict[str, Any] = {}
    stack, name, colon, fields, at = [top], "", False, 0, 0

    def error(found: str) -> AssetError:
        line = text.count("\n", 0, at) + 1
        return AssetError(f"{path}: line {line}: expected {what} (protobuf text), found {found}")

    while at < len(text):
        token = TOKEN.match(text, at)
        if token is None:
            raise error(repr(text[at : at + 20]))
        kind, value = token.lastgroup, token.group()
        if kind == "name" and not name:
            name = value
        elif kind == "colon" and name and not colon:
            colon = True
        elif kind == "open" and name:
            message: dict[str, Any] = {}
            _put(stack[-1], name, message)
            stack.append(message)
            name, colon = "", False
            if len(stack) > MAX_DEPTH:
                raise error(f"messages nested more than {MAX_DEPTH} deep")
        elif kind == "close" and not name and len(stack) > 1:
            stack.pop()
        elif kind in ("number", "string", "name") and colon:
            if kind == "number":
                _put(stack[-1], name, _number(value, error))
            elif value.lower().removeprefix("-") in ("nan", "inf", "infinity"):
                raise error(f"{name}: {value}, which is not finite")
            else:
                _put(stack[-1], name, value[1:-1] if kind == "string" else value)
            name, colon = "", False
        elif kind != "space":
            raise error(repr(value[:20]))
        fields += kind not in ("space", "colon")
        if fields > MAX_FIELDS:
            raise error(f"more than {MAX_FIELDS} names and values")
        at = token.end()
    if len(stack) > 1 or name:
        raise error("its end inside a message")
    return top


def _number(text: str, error: Any) -> float:
    value = float(text.rstrip("fF"))
    if not math.isfinite(value):
        raise error(f"the number {text[:20]}, which is beyond floats")
    return value


def _put(message: dict[str, Any], name: str, value: Any) -> None:
    """Add a field; the second of a name makes a list of both."""
    if name not in message:
        message[name] = value
    elif isinstance(message[name], list):
        message[name].append(value)
    else:
        message[name] = [message[name], value]
