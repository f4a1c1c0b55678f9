"""Live Link Face, Epic's app for phones: ARKit's shapes as one binary datagram a frame.

    <i 6 | 37 bytes "$" and an identifier | !i length and the device's name |
    !i frame, f part of a frame, 2 i rate | B 61 | !61f: 52 shapes, then yaw, pitch, roll of head, left and right eye

Shapes come in the order of the engine's enumeration, by which it reads them, Left before Right in all pairs: that is
the order of SHAPES. (The app's own CSV files have JawRight before JawLeft, and MouthRight before MouthLeft: those are
read by name.) Angles are radians in the engine's sense, yaw to the person's right and pitch upwards (judged). Eyes
look where their shapes say.
"""

import struct

import numpy as np

from avatar.face import SHAPES
from player.live.face_sender import SentFace, sent_face
from player.live.frame import MalformedError

VERSION = 6
START = struct.Struct("<i37s")
TIME = struct.Struct("!if2i")
VALUES = struct.Struct("!B61f")
LONGEST_NAME = 256  # bytes


def parse_livelinkface(data: bytes) -> SentFace:
    """Read one datagram.

    Raises:
        MalformedError: another version, cut short, or numbers that are not finite.
    """
    try:
        version, identifier = START.unpack_from(data)
        (length,) = struct.unpack_from("!i", data, START.size)
        if version != VERSION or identifier[:1] != b"$" or not 0 <= length <= LONGEST_NAME:
            raise MalformedError(f"expected version {VERSION} and an identifier, found version {version}")
        at = START.size + 4 + length
        frame, part, rate, unit = TIME.unpack_from(data, at)
        count, *values = VALUES.unpack_from(data, at + TIME.size)
    except struct.error as error:
        raise MalformedError(f"{len(data)} bytes: {error}") from None
    if count != 61 or len(data) != at + TIME.size + VALUES.size:
        raise MalformedError(f"expected 61 values, found {count} in {len(data)} bytes")
    yaw, pitch, roll = values[len(SHAPES) : len(SHAPES) + 3]
    if not (abs(yaw) < 10 and abs(pitch) < 10 and abs(roll) < 10):
        raise MalformedError("angles of the head that are none")
    sent = (frame + part) * unit / rate if rate > 0 and unit > 0 and 0 <= part <= 1 else None
    return SentFace(sent_face(np.array(values[: len(SHAPES)])), (-yaw, -pitch, roll), sent)
