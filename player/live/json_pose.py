"""Our own pose in JSON, one object a UDP datagram or a WebSocket message:

    {"v": 1, "t": 12.345, "seq": 42, "id": "a", "trans": [x, y, z], "poses": [156 numbers], "face": {"jawOpen": 0.3}}

`poses` are 52 axis-angle vectors in SMPL+H order, flat-hand convention, radians; `trans` is the pelvis joint in
the world, +y up, metres. `t` is seconds on the sender's clock (Unix time lets the latency be absolute), `seq`
counts up by one a message. `id` (at most 64 letters) keeps several senders apart and may be left out, as may
`pelvis_height`: metres from the soles to the pelvis of the body that `trans` fits, and `face`: ARKit's shapes or VRM's
expressions (avatar/face_names.py) from 0 to 1; those that are not in it rest, unknown ones and other keys are ignored.
"""

import json
from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.face import SHAPES, FaceFrame
from avatar.face_names import weights_of
from avatar.gaze import gaze_of
from player.draw.drawing import Pose
from player.live.frame import Counters, Decoded, MalformedError

LARGEST = 16384  # bytes; a message has about 3000, with a face 4500
MOST_NAMES = 256  # a face's
# a sequence number older by more is a restarted sender
REORDERED = 64
# seconds that the followed sender may be silent before another is followed
PATIENCE = 1.0


class JsonPose(NamedTuple):
    time: float
    sequence: int
    sender: str
    pose: Pose
    pelvis_height: float | None


def parse_pose(data: bytes | str) -> JsonPose:
    """Read one message.

    Raises:
        MalformedError: not JSON, another version, a key missing, a number not finite or out of all measure.
    """
    try:
        found = json.loads(data, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise MalformedError(f"no JSON: {error}") from None
    if not isinstance(found, dict) or found.get("v") != 1:
        raise MalformedError('expected an object with "v": 1')
    sequence, sender = found.get("seq"), found.get("id", "")
    if not isinstance(sequence, int) or isinstance(sequence, bool) or not 0 <= sequence < 1 << 63:
        raise MalformedError("seq should be a whole number from 0")
    if not isinstance(sender, str) or len(sender) > 64:
        raise MalformedError("id should be a text of at most 64 letters")
    time = _numbers([found.get("t")], 1, 1e12, "t")[0]
    trans = _numbers(found.get("trans"), 3, 1e6, "trans")
    poses = _numbers(found.get("poses"), 156, 1e3, "poses")
    height = found.get("pelvis_height")
    if height is not None:
        height = float(_numbers([height], 1, 100, "pelvis_height")[0])
        if height < 0.05:
            raise MalformedError("pelvis_height should be metres, at least 0.05")
    return JsonPose(float(time), sequence, sender, Pose(poses.reshape(52, 3), trans, _face(found)), height)


def _face(found: dict) -> FaceFrame | None:
    named = found.get("face")
    if named is None:
        return None
    if not isinstance(named, dict) or len(named) > MOST_NAMES:
        raise MalformedError(f"face should be an object of at most {MOST_NAMES} names")
    if not all(type(value) in (int, float) and 0 <= value <= 1 for value in named.values()):
        raise MalformedError("face should have numbers from 0 to 1")
    weights = weights_of(named)
    return FaceFrame(weights, gaze_of(weights))


def _refuse(name: str) -> None:
    raise ValueError(f"{name} is no number")


def _numbers(value: object, count: int, largest: float | int, name: str) -> Float[np.ndarray, "numbers"]:
    """`count` plain numbers below `largest`; true and false are none."""
    if not isinstance(value, list) or len(value) != count:
        raise MalformedError(f"{name} should be {count} numbers")
    if not all(type(number) in (int, float) and -largest <= number <= largest for number in value):
        raise MalformedError(f"{name} should be {count} finite numbers, at most {largest:g}")
    return np.array(value, np.float64)


def build_pose(
    pose: Pose, *, time: float | int, sequence: int, sender: str = "", pelvis_height: float | None = None
) -> bytes:
    """One message; the numbers to 1e-6. A gaze is sent as the eyeLook* shapes of the face say it."""
    message: dict = {"v": 1, "t": time, "seq": sequence}
    if sender:
        message["id"] = sender
    if pelvis_height is not None:
        message["pelvis_height"] = round(pelvis_height, 6)
    message["trans"] = np.round(pose.root, 6).tolist()
    message["poses"] = np.round(pose.axis_angle, 6).reshape(-1).tolist()
    if pose.face is not None:
        weights = zip(SHAPES, pose.face.weights.tolist(), strict=True)
        message["face"] = {name: round(weight, 4) for name, weight in weights if weight > 0}
    return json.dumps(message, separators=(",", ":"), allow_nan=False).encode()


class JsonDecoder:
    """Messages to poses of one sender: each sequence number once; gaps, late and repeated ones are counted."""

    largest = LARGEST

    def __init__(self):
        self.sender: str | None = None
        # when the followed sender was last heard
        self.heard = -np.inf
        self.newest: int | None = None
        self.recent: deque[tuple[int, float]] = deque(maxlen=2 * REORDERED)
        self.late_in_a_row = 0

    def decode(self, data: bytes | str, received: float | int, counters: Counters) -> Decoded | None:
        """The pose, and whether the sender has restarted; None where it is not used: the counters say why."""
        pose, restarted = parse_pose(data), False
        if pose.sender != self.sender:
            if self.sender is not None and received - self.heard < PATIENCE:
                counters.other += 1
                return None
            restarted = self.sender is not None
            self._begin(pose.sender)
        self.heard = received
        if (pose.sequence, pose.time) in self.recent:
            counters.duplicate += 1
            return None
        self.recent.append((pose.sequence, pose.time))
        if self.newest is not None:
            ahead = pose.sequence - self.newest
            if -REORDERED <= ahead < 0 and self.late_in_a_row < REORDERED // 2:
                counters.late += 1
                # it was counted as lost when its follower came
                counters.lost = max(counters.lost - 1, 0)
                self.late_in_a_row += 1
                return None
            if ahead < 0 or ahead > 1_000_000:
                restarted = True
                self._begin(pose.sender)
                self.recent.append((pose.sequence, pose.time))
            else:
                counters.lost += max(ahead - 1, 0)
        self.newest, self.late_in_a_row = pose.sequence, 0
        return Decoded(pose, True, pose.time, restarted)

    def _begin(self, sender: str) -> None:
        self.sender, self.newest, self.late_in_a_row = sender, None, 0
        self.recent.clear()
