"""OpenSeeFace, a tracker for webcams that runs beside: a face of 1785 bytes in this machine's byte order.

    d time | i face | 2f size | 2f eyes, right first, 1 is open | B found in 3-D | f error | 4f quaternion | 3f Euler |
    3f place | 68 f confidences | 68 x 2f points | 70 x 3f points | 14 f features

Features are 0 at the person's median and 1 at the most: corners of the mouth and brows upwards, a wide mouth. They are
fewer than ARKit's, so their shapes are a guess, RECIPES. Euler angles are degrees, (180, 0, 90) straight ahead; their
senses are those of its example for Unity (judged). Of several faces the first is read.
"""

import struct

import numpy as np

from avatar.face_names import weights_of
from player.live.face_sender import SentFace, sent_face
from player.live.frame import MalformedError

HEAD = struct.Struct("=di4fBf4f3f3f")
FEATURES = struct.Struct("=14f")
SIZE = HEAD.size + (68 + 2 * 68 + 3 * 70) * 4 + FEATURES.size
# features by their place: the shapes of values above 0, and of those below
RECIPES: dict[int, tuple[dict[str, float], dict[str, float]]] = {
    0: ({"eyeWideLeft": 0.8}, {}),
    1: ({"eyeWideRight": 0.8}, {}),
    3: ({"browOuterUpLeft": 0.9, "browInnerUp": 0.45}, {"browDownLeft": 0.9}),
    6: ({"browOuterUpRight": 0.9, "browInnerUp": 0.45}, {"browDownRight": 0.9}),
    8: ({"mouthSmileLeft": 0.9}, {"mouthFrownLeft": 0.9}),
    10: ({"mouthSmileRight": 0.9}, {"mouthFrownRight": 0.9}),
    12: ({"jawOpen": 0.6}, {}),
    13: ({"mouthStretchLeft": 0.5, "mouthStretchRight": 0.5}, {"mouthPucker": 0.8}),
}


def parse_openseeface(data: bytes) -> SentFace:
    """Read the first face of a datagram.

    Raises:
        MalformedError: of another length, without a face that was found, or with numbers that are not finite.
    """
    if not data or len(data) % SIZE:
        raise MalformedError(f"expected faces of {SIZE} bytes, found {len(data)}")
    time, _, _, _, right, left, found, _, *turn = HEAD.unpack_from(data)
    features = FEATURES.unpack_from(data, SIZE - FEATURES.size)
    pitch, yaw, roll = turn[4:7]
    if not found or not np.isfinite([time, right, left, pitch, yaw, roll, *features]).all() or abs(time) > 1e12:
        raise MalformedError("no face in 3-D, or a number that is not finite")
    values = {"eyeBlinkLeft": 1.0 - left, "eyeBlinkRight": 1.0 - right}
    for place, ways in RECIPES.items():
        value = min(max(features[place], -1.0), 1.0)
        for name, weight in ways[value < 0].items():
            values[name] = values.get(name, 0.0) + abs(value) * weight
    head = (-_degrees(yaw), -_degrees(pitch + 180), -_degrees(roll - 90))
    return SentFace(sent_face(weights_of(values)), head, time)


def _degrees(angle: float) -> float:
    """An angle of degrees as radians from minus to plus half a turn."""
    return float(np.radians((angle + 180) % 360 - 180))
