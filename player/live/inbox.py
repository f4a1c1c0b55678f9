"""Where the newest frame waits between the network and the window.

Times. `received` is this machine's monotonic clock. A pose's own `time` follows the sender's clock from a common
start, so that its steps are the sender's and not the network's; where the sender has no clock, or sets it back, it
follows `received`. A take is made of them.
"""

import threading
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from player.draw.drawing import Pose
from player.live.calibration import NORMALISED, calibrated, pose_from_rig
from player.live.face_sender import FaceDecoder, SentFace
from player.live.frame import Counters, Decoded, LiveFrame, MalformedError
from player.live.ifacialmocap import parse_ifacialmocap
from player.live.json_pose import JsonDecoder, JsonPose
from player.live.livelinkface import parse_livelinkface
from player.live.openseeface import parse_openseeface
from player.live.take import Take
from player.live.vmc import VmcDecoder, VmcState, rig_from_state

# seconds; float32 clocks step by 1 ms from here on, so arrival is the better clock
COARSE = 8192.0
# seconds; a sender's clock that jumps by more against ours is started anew
JUMP = 1.0
SILENT = 1.0  # seconds without a datagram


# what makes frames of the datagrams of a protocol, of at most `largest` bytes
Decoder = VmcDecoder | JsonDecoder | FaceDecoder
# by the kind of an address (player/scene/address.py)
DECODERS: dict[str, Callable[[], Decoder]] = {
    "vmc": VmcDecoder,
    "udp": JsonDecoder,
    "ws": JsonDecoder,
    "ifacialmocap": lambda: FaceDecoder(parse_ifacialmocap),
    "livelinkface": lambda: FaceDecoder(parse_livelinkface),
    "openseeface": lambda: FaceDecoder(parse_openseeface),
}


class SourceStatus(NamedTuple):
    frames: int
    rate: float  # frames a second, of late
    # seconds since the last frame; None: no frame yet
    age: float | None
    counters: Counters
    tracking: bool


class Inbox:
    """Takes datagrams from a thread, gives poses to another. Memory does not grow."""

    def __init__(self, kind: str, *, take: Take | None = None):
        self.lock = threading.Lock()
        self.arrived = threading.Condition(self.lock)
        self.decoder = DECODERS[kind]()
        self.counters = Counters()
        self.take = take
        self.calibration = NORMALISED
        self.newest: LiveFrame | None = None
        self.arrivals: deque[float] = deque(maxlen=64)
        self.start: tuple[float, float] | None = None  # sender's clock and ours at a common moment

    def feed(self, data: bytes | str, received: float | int) -> None:
        """Take a datagram that arrived at `received`. Nothing in it can make this fail."""
        with self.lock:
            self.counters.received += 1
            if len(data) > self.decoder.largest:
                self.counters.oversized += 1
                return
            try:
                found = self.decoder.decode(data, received, self.counters)
            except MalformedError:
                self.counters.malformed += 1
                return
            if found is not None:
                self._accept(found, received)

    def oversize(self) -> None:
        """Count a message that was too large to be handed over."""
        with self.lock:
            self.counters.received += 1
            self.counters.oversized += 1

    def _accept(self, found: Decoded, received: float | int) -> None:
        last = self.newest
        if found.restarted:
            self.start = None
        if found.begins or last is None:
            self.counters.frames += 1
            self.arrivals.append(received)
            self._record()
            time = self._time(found.sent, received)
        else:
            time = last.time
        self.newest = LiveFrame(found.content, received, found.sent, time, self.counters.frames)
        self.arrived.notify_all()

    def _time(self, sent: float | None, received: float | int) -> float:
        """When the pose was, on our clock; never before the last one's."""
        time = float(received)
        if sent is not None and not (isinstance(self.decoder, VmcDecoder) and abs(sent) > COARSE):
            if self.start is None or abs((received - self.start[1]) - (sent - self.start[0])) > JUMP:
                self.start = (float(sent), float(received))
            time = self.start[1] + (sent - self.start[0])
        return max(time, self.newest.time) if self.newest is not None else time

    def _record(self) -> None:
        """Give the frame that is complete now to the take."""
        if self.take is not None and self.newest is not None:
            pose = self.pose(self.newest)
            self.take.add(self.newest.time, pose)

    def finish(self) -> None:
        """The last frame is complete: nothing comes any more."""
        with self.lock:
            self._record()
            self.take = None

    def wait(self, after: int, timeout: float | int) -> bool:
        """Wait for a frame later than number `after`; whether there is one."""
        with self.arrived:
            return self.arrived.wait_for(lambda: self.newest is not None and self.newest.number > after, timeout)

    def pose(self, frame: LiveFrame) -> Pose:
        """A frame in our joints and world, of the sender's body."""
        if isinstance(frame.content, VmcState):
            return pose_from_rig(rig_from_state(frame.content), self.calibration, frame.content.face)
        assert isinstance(frame.content, JsonPose | SentFace)
        return frame.content.pose

    def leg(self) -> float | None:
        """Leg length of the sender's body (vmc.leg_length), where its bones have lengths."""
        frame = self.newest
        return rig_from_state(frame.content).leg if frame and isinstance(frame.content, VmcState) else None

    def pelvis_height(self) -> float | None:
        """Pelvis height of the sender's body, where it says so."""
        frame = self.newest
        return frame.content.pelvis_height if frame and isinstance(frame.content, JsonPose) else None

    def calibrate(self) -> bool:
        """Take the newest frame for a T-pose; whether there was one to take."""
        with self.lock:
            if self.newest is None or not isinstance(self.newest.content, VmcState):
                return False
            self.calibration = calibrated(rig_from_state(self.newest.content))
            return True

    def sample(self) -> tuple[LiveFrame, Pose] | None:
        """The newest frame and its pose. None: none yet."""
        with self.lock:
            newest = self.newest
        return None if newest is None else (newest, self.pose(newest))

    def facts(self, now: float | int) -> SourceStatus:
        with self.lock:
            times = list(self.arrivals)
            age = now - self.newest.received if self.newest else None
            span = times[-1] - times[0] if len(times) > 1 else 0.0
            rate = (len(times) - 1) / span if span > 0 and age is not None and age < SILENT else 0.0
            tracking = not isinstance(self.decoder, VmcDecoder) or self.decoder.tracking
            return SourceStatus(self.counters.frames, rate, age, Counters(**vars(self.counters)), tracking)
