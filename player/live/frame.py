"""What was received, before it is the pose of an avatar, and counts of it."""

from dataclasses import dataclass
from typing import NamedTuple

# seconds; a sender's clock set back by more was restarted, by less its datagram came late
RESTART = 1.0


class MalformedError(ValueError):
    """The bytes are nothing that the protocol sends."""


class LiveFrame(NamedTuple):
    """What a decoder made of one or more datagrams."""

    # that its decoder turns into a Pose
    content: object
    # monotonic seconds on this machine, of the last datagram
    received: float
    sent: float | None  # seconds on the sender's clock
    # when the pose was, on this machine's clock: the sender's steps where it has a clock
    time: float
    # counts frames; a frame that is completed by a second datagram keeps its number
    number: int


class Decoded(NamedTuple):
    """What a decoder made of a datagram: a frame's content, whether it begins a new one, and the sender's clock."""

    content: object
    begins: bool
    sent: float | None
    restarted: bool


@dataclass
class Counters:
    """Datagrams and frames; each datagram is received, and at most one of the others."""

    received: int = 0
    frames: int = 0  # poses
    # not the protocol, or a number that is not finite; the rest of a VMC bundle is used
    malformed: int = 0
    oversized: int = 0
    # older than what was used already
    late: int = 0
    duplicate: int = 0
    # from a sender that is not the one followed
    other: int = 0
    # gaps in the sequence numbers (JSON); VMC has none
    lost: int = 0
