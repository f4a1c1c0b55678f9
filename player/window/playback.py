"""The pose of every avatar on screen at a moment: each with its own motion or live source, start and place."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from avatar.motion.clip import Clip
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from player.live.playback import LivePlayback
from player.renderer import Pose
from player.window.timeline import Timeline

# frames read at once; a motion of any length takes the memory of two blocks
BLOCK = 256


@dataclass
class Track:
    """One avatar's motion and where it stands. Place and start may be changed while it plays."""

    clip: Callable[[int, int], Clip]
    frames: int
    rate: float
    # seconds into the motion at which the timeline begins
    start: float = 0.0
    at: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))  # metres
    turn: float = 0.0  # radians about y
    name: str = ""
    _blocks: list[tuple[int, Clip]] = field(default_factory=list, repr=False)

    @property
    def end(self) -> float:
        """Seconds into the timeline at which the motion has been shown."""
        return self.frames / self.rate - self.start

    def frame(self, seconds: float | int) -> int:
        """The motion's own frame at a moment of the timeline; past its end the last is held."""
        return min(max(int((seconds + self.start) * self.rate + 1e-6), 0), self.frames - 1)

    def pose(self, seconds: float | int) -> Pose:
        """The pose at a moment, in its place."""
        frame = self.frame(seconds)
        first = frame - frame % BLOCK
        block = next((clip for start, clip in self._blocks if start == first), None)
        if block is None:
            block = self.clip(first, min(first + BLOCK, self.frames))
            # the one before stays, for stepping back
            self._blocks = [*self._blocks[-1:], (first, block)]
        i = frame - first
        return self.placed((block.axis_angle[i], block.root[i]))

    def placed(self, pose: Pose) -> Pose:
        """A pose turned about the world's y axis, then moved."""
        axis_angle, root = pose
        if self.turn:
            turned = matrix_from_axis_angle(np.array([0.0, self.turn, 0.0]))
            axis_angle = axis_angle.copy()
            axis_angle[0] = axis_angle_from_matrix(turned @ matrix_from_axis_angle(axis_angle[0]))
            root = turned @ root
        return axis_angle, root + self.at


class Playback:
    """All tracks on one timeline. `live` says which avatars a live source poses instead of their track's motion."""

    def __init__(
        self, tracks: Sequence[Track], live: Sequence[tuple[LivePlayback, Sequence[int]]] = (), *,
        rate: float | None = None,
    ):  # fmt: skip
        self.tracks, self.live = list(tracks), list(live)
        rate = rate or tracks[0].rate
        frames = max(int(np.ceil(track.end * rate - 1e-6)) for track in tracks)
        self.timeline = Timeline(max(frames, 1), rate)

    def advance(self, dt: float | int) -> None:
        """Let time pass."""
        self.timeline.advance(dt)
        for live, _ in self.live:
            live.advance(dt)

    def poses(self) -> list[Pose]:
        """A pose for each avatar, now."""
        poses: list[Pose | None] = [None] * len(self.tracks)
        for live, indices in self.live:
            live.playing = self.timeline.playing
            for index, pose in zip(indices, live.poses(), strict=True):
                poses[index] = self.tracks[index].placed(pose)
        return [
            pose if pose is not None else track.pose(self.timeline.seconds)
            for pose, track in zip(poses, self.tracks, strict=True)
        ]

    def close(self) -> None:
        """Let go of the motions, whose files close with them."""
        self.tracks.clear()

    def drawn(self) -> None:
        """The picture of the last `poses` is on the screen."""
        for live, _ in self.live:
            live.drawn()

    def status(self) -> str:
        """Where the timeline is, and how the live sources do."""
        lines = [live.status() for live, _ in self.live]
        if not self.live or self.timeline.frames > 1:
            lines.insert(0, self.timeline.status())
        return "  ".join(lines)
