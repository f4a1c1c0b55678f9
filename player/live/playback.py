"""Live poses for the window, in the place of a file's playback: taken, fitted to each avatar, smoothed, timed."""

import time
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from avatar.baked_avatar import Avatar
from avatar.face import face_between
from player.live.gains import Gains
from player.live.inbox import SILENT, Inbox
from player.live.latency import DRAWN, Latency
from player.live.one_euro import OneEuro
from player.live.vmc import VmcState, joint_offsets, leg_length
from player.scene.address import FACE_SENDERS, Address
from player.scene.framing import pelvis_height
from player.scene.renderer import Pose

# seconds in which the face of a sender that has gone comes to rest
FADE = 0.5
# metres; a pelvis lower than this was not measured, not even of someone who lies
LOW = 0.05
PATIENCE = 10.0  # seconds that a script waits for a pose


class LivePlayback:
    """Playback of the poses in an inbox; before the first one the avatars stand in T-pose.

    The person first seen stands at the world's origin; `calibrate` puts them there again, soles on the ground. The
    root is scaled by the ratio of leg lengths where the sender sends its own (VMC bone positions, JSON pelvis_height).
    """

    def __init__(
        self,
        inbox: Inbox,
        address: Address,
        avatars: Sequence[Avatar],
        *,
        smooth: float | None = None,
        calibrate_after: float | None = None,
        gains: Gains | None = None,
        clock: Callable[[], float] = time.monotonic,
    ):
        self.inbox, self.address, self.clock = inbox, address, clock
        self.playing = True
        self.heights: list[float] = [0.0] * len(avatars)
        self.legs: list[float | None] = [None] * len(avatars)
        for k, avatar in enumerate(avatars):
            self.fit(k, avatar)
        self.filter = OneEuro(smooth) if smooth is not None else None
        self.gains = gains
        self.latency = Latency()
        self.countdown = calibrate_after
        self.origin: Float[np.ndarray, "3"] | None = None  # in the sender's metres
        # whether bones of the pose that set it may not have arrived yet
        self.partial = False
        # whether the pose that sets the origin stands on the ground for certain
        self.stands = False
        self.shown: Pose | None = None
        # whether the sender moves the body; else a motion does, and the sender turns the head
        self.moves_body = address.kind not in FACE_SENDERS
        self.sampled: float | None = None

    def fit(self, k: int, avatar: Avatar) -> None:
        """Pose this avatar as avatar k: its size, metres."""
        self.heights[k] = pelvis_height(avatar)
        self.legs[k] = leg_length(joint_offsets(avatar.joint_positions.astype(np.float64)))

    def advance(self, dt: float | int) -> None:
        """Let time pass: only the countdown to the calibration needs it."""
        if self.countdown is not None and self.inbox.newest is not None:
            self.countdown -= max(dt, 0.0)
            if self.countdown <= 0:
                self.countdown = None
                self.calibrate()

    def ask_for_t_pose(self, seconds: float | int = 3.0) -> None:
        """Start the countdown to the calibration; pressed again, stop it."""
        self.countdown = None if self.countdown is not None else float(seconds)

    def calibrate(self) -> None:
        """Take the pose of now for the T-pose, standing on the ground at the origin."""
        self.inbox.calibrate()
        self.origin, self.stands = None, True
        if self.filter:
            self.filter.reset()

    def poses(self) -> list[Pose]:
        """A pose for each avatar. Paused or silent, the last good one; of a sender that has gone the face rests."""
        now = self.clock()
        found = self.inbox.sample() if self.playing else None
        if found is not None:
            frame, pose = found
            self.latency.applied(frame, now)
            if self.gains is not None and pose.face is not None:
                pose = pose._replace(face=self.gains(pose.face, now))
            dt = now - self.sampled if self.sampled is not None else 0.0
            self.shown = self.filter(pose, dt) if self.filter else pose
            gone = (now - frame.received - SILENT) / FADE
            if gone > 0:
                self.shown = self.shown._replace(face=face_between(pose.face, None, gone) if gone < 1 else None)
            self.sampled = now
            if self.origin is None or self.partial:
                # a frame of VMC has arrived whole when the next one begins
                self.partial = isinstance(frame.content, VmcState) and frame.number == 1
                self.origin = pose.root * [1.0, 0.0, 1.0]
                if self.stands or abs(pose.root[1]) < LOW:
                    self.origin[1] = pose.root[1] - self.heights[0] / self._ratio(0)
        if self.shown is None or self.origin is None:
            return [Pose(np.zeros((52, 3)), np.array([0.0, height, 0.0])) for height in self.heights]
        root, shown = self.shown.root - self.origin, self.shown
        return [Pose(shown.axis_angle, root * self._ratio(k), shown.face) for k in range(len(self.heights))]

    def _ratio(self, k: int) -> float:
        """Avatar k's size against the sender's body; 1 where the sender does not say."""
        own, height, leg = self.inbox.pelvis_height(), self.heights[k], self.legs[k]
        if own is not None:
            return height / own
        sent = self.inbox.leg()
        return leg / sent if sent and leg else 1.0

    def sender_height(self) -> float:
        """Pelvis height of the sender's body, for the take: played back it is scaled as it was live."""
        return self.heights[0] / self._ratio(0)

    def drawn(self) -> None:
        """Note that the last `poses` are on the screen."""
        self.latency.drawn(self.clock())

    def wait_for_pose(self) -> None:
        """Wait for a frame that was not shown yet, some seconds at most."""
        self.inbox.wait(self.latency.last, PATIENCE)

    def status(self) -> str:
        """Source, rate, age of the pose, loss and latency, in one line."""
        facts = self.inbox.facts(self.clock())
        count = facts.counters
        if self.countdown is not None:
            return f"{self.address}  hold a T-pose: {self.countdown:.0f}"
        if self.gains is not None and self.gains.left(self.clock()):
            return f"{self.address}  pull faces, as wide as you can: {self.gains.left(self.clock()):.0f}"
        if facts.age is None:
            bad = f", {count.malformed + count.oversized} packets are no poses" if count.received else ""
            return f"{self.address}  waiting for poses{bad}"
        parts = [str(self.address), f"{facts.rate:.0f}/s", f"age {1000 * facts.age:.0f} ms"]
        if facts.age > SILENT:
            parts[1:] = [f"SILENT {facts.age:.0f} s, last pose held"]
        elif not facts.tracking:
            parts.append("sender: no tracking")
        if not self.playing:
            parts.append("paused")
        named = {
            "lost": count.lost, "late": count.late, "twice": count.duplicate,
            "bad": count.malformed + count.oversized, "others": count.other,
        }  # fmt: skip
        parts.append("  ".join(f"{name} {n}" for name, n in named.items() if n or name == "lost"))
        drawn = self.latency.percentiles().get(DRAWN)
        if drawn is not None:
            parts.append(f"p95 {drawn.p95:.0f} ms")
        return "  ".join(parts)

    def summary(self) -> list[str]:
        """Counts of what was received and the latency, as lines for printing at the end."""
        facts = self.inbox.facts(self.clock())
        named = {name: n for name, n in vars(facts.counters).items() if n or name in ("received", "frames")}
        return [f"live: {', '.join(f'{name} {n}' for name, n in named.items())}", *self.latency.summary()]
