"""Open Sound Control 1.0: bytes of a packet to messages and back, bounded in size, number and depth.

A packet is a message or a bundle. All is big-endian in units of 4 bytes; strings end in 1 to 4 zeros. A message is
an address, a string of type letters that starts with a comma, and the arguments; a bundle is "#bundle", a time
tag, and packets each after its int32 size (opensoundcontrol.org, "OSC spec 1.0").
"""

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

from player.live.frame import MalformedError

# bytes of a packet; a VMC bundle of 55 bones has about 4500
LARGEST = 32768
MOST_MESSAGES = 1024  # in a packet
DEEPEST = 8  # bundles within bundles
IMMEDIATELY = (1).to_bytes(8, "big")  # time tag

# Numbers: OSC's letter, and struct's
PLAIN = {"i": "i", "f": "f", "h": "q", "d": "d", "t": "Q"}


class Message(NamedTuple):
    address: str
    arguments: tuple


def parse_packet(data: bytes) -> list[Message]:
    """The messages of a packet, bundles flattened in order; time tags are not waited for.

    A message of other arguments than numbers after at most one string, all that VMC sends, is left out, as the
    specification asks for types that are not known.

    Raises:
        MalformedError: anything else that is not as it should be, or larger or deeper than is read here; then nothing
            of the packet is used.
    """
    if len(data) > LARGEST:
        raise MalformedError(f"packet of {len(data)} bytes, at most {LARGEST} are read")
    messages: list[Message] = []
    _parse(data, 0, len(data), messages, 0)
    return messages


def _parse(data: bytes, start: int, end: int, messages: list[Message], depth: int) -> None:
    if (end - start) % 4 or start == end:
        raise MalformedError(f"{end - start} bytes: a packet is a positive multiple of 4 long")
    if data[start] == 0x2F:  # "/"
        if len(messages) >= MOST_MESSAGES:
            raise MalformedError(f"more than {MOST_MESSAGES} messages in a packet")
        message = _message(data, start, end)
        if message is not None:
            messages.append(message)
        return
    if data[start : start + 8] != b"#bundle\0" or end - start < 16:
        raise MalformedError("neither a message nor a bundle")
    if depth == DEEPEST:
        raise MalformedError(f"bundles nested more than {DEEPEST} deep")
    at = start + 16
    while at < end:
        size = int.from_bytes(data[at : at + 4], "big")
        if size > end - at - 4:
            raise MalformedError(f"an element of {size} bytes in a bundle with {end - at - 4} left")
        _parse(data, at + 4, at + 4 + size, messages, depth + 1)
        at += 4 + size


def _message(data: bytes, start: int, end: int) -> Message | None:
    address, at = _string(data, start, end)
    if at == end:
        # senders of before 1.0 leave the type letters out
        return Message(address, ())
    if data[at] != 0x2C:  # ","
        raise MalformedError("no type letters after the address")
    stop = data.find(b"\0", at, end)
    if stop < 0:
        raise MalformedError("a string that does not end")
    letters = data[at + 1 : stop]
    at += (stop - at) // 4 * 4 + 4
    layout = _layout(letters)
    if layout is None:
        return None
    arguments: list = []
    if letters[:1] == b"s":
        text, at = _string(data, at, end)
        arguments.append(text)
    if at + layout.size > end:
        raise MalformedError("arguments end before their types do")
    return Message(address, (*arguments, *layout.unpack_from(data, at)))


@lru_cache(64)
def _layout(letters: bytes) -> struct.Struct | None:
    """How the numbers lie, where the letters are at most one string, in front, and numbers."""
    numbers = letters[1:] if letters[:1] == b"s" else letters
    if len(numbers) > 16 or not all(chr(letter) in PLAIN for letter in numbers):
        return None
    return struct.Struct(">" + "".join(PLAIN[chr(letter)] for letter in numbers))


def _string(data: bytes, start: int, end: int) -> tuple[str, int]:
    stop = data.find(b"\0", start, end)
    if stop < 0:
        raise MalformedError("a string that does not end")
    try:
        return data[start:stop].decode("utf-8"), start + (stop - start) // 4 * 4 + 4
    except UnicodeDecodeError:
        raise MalformedError("a string that is not UTF-8") from None


def build_message(address: str, *arguments: str | float | int) -> bytes:
    """A message: str as s, int as int32, float as float32."""
    letters, data = ",", b""
    for value in arguments:
        letter = "s" if isinstance(value, str) else "i" if isinstance(value, int) else "f"
        letters += letter
        data += _padded(value) if isinstance(value, str) else struct.pack(f">{letter}", value)
    return _padded(address) + _padded(letters) + data


def build_bundle(elements: Sequence[bytes]) -> bytes:
    return b"#bundle\0" + IMMEDIATELY + b"".join(struct.pack(">i", len(element)) + element for element in elements)


def _padded(text: str) -> bytes:
    data = text.encode("utf-8")
    return data + b"\0" * (4 - len(data) % 4)
