"""What senders of faces have in common: a datagram is a whole face, and perhaps how the head is turned.

A decoder of one is a function in a file of its own (ifacialmocap.py, livelinkface.py, openseeface.py) and a line of
DECODERS in inbox.py. The body of such a pose stands in T-pose, or does what else moves it (playback.py).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.face import FaceFrame
from avatar.gaze import NECK_AND_HEAD, gaze_of, turned_head
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from player.draw.drawing import Pose
from player.live.frame import RESTART, Counters, Decoded, MalformedError


class SentFace(NamedTuple):
    """A datagram's face; head: yaw to the person's left, pitch downwards, roll to the person's right, radians."""

    face: FaceFrame
    head: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sent: float | None = None  # seconds on the sender's clock

    @property
    def pose(self) -> Pose:
        """The pose of it, in T-pose but for the head."""
        return Pose(turned_head(np.array(self.head)), np.zeros(3), self.face)


class FaceDecoder:
    """Datagrams of one protocol to faces. What is cut, not finite or old is counted, and the last good face stays."""

    largest = 16384  # bytes

    def __init__(self, parse: Callable[[bytes], SentFace]):
        self.parse = parse
        self.clock: float | None = None

    def decode(self, data: bytes | str, _received: float | int, counters: Counters) -> Decoded | None:
        """The face of a datagram; None where it is not used: the counters say why."""
        assert isinstance(data, bytes)
        found = self.parse(data)
        sent, last = found.sent, self.clock
        restarted = sent is not None and last is not None and sent < last - RESTART
        if sent is not None and last is not None and not restarted and sent <= last:
            counters.duplicate += sent == last
            counters.late += sent < last
            return None
        self.clock = sent
        return Decoded(found, True, sent, restarted)


def sent_face(weights: Float[Array, "52"], gaze: Float[Array, "2 2"] | None = None) -> FaceFrame:
    """A face of received numbers; without a gaze of their own eyes look where the eyeLook* shapes say.

    Raises:
        MalformedError: a number is not finite.
    """
    if not np.isfinite(weights).all() or (gaze is not None and not np.isfinite(gaze).all()):
        raise MalformedError("a number that is not finite")
    weights = np.clip(weights, 0.0, 1.0)
    return FaceFrame(weights, gaze_of(weights) if gaze is None else np.clip(gaze, -np.pi / 2, np.pi / 2))


def with_head(pose: Pose, head: Pose) -> Pose:
    """A body's pose with the face of a sender and its neck and head turned further as the sender's are."""
    axis_angle = pose.axis_angle.copy()
    R, turn = (matrix_from_axis_angle(one.axis_angle[NECK_AND_HEAD]) for one in (pose, head))
    axis_angle[NECK_AND_HEAD] = axis_angle_from_matrix(R @ turn)
    return Pose(axis_angle, pose.root, pose.face if head.face is None else head.face)
