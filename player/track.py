"""One avatar's motion on a timeline: its pose at a moment, read in stretches, and where it stands."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from avatar.motion.clip import Clip
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from player.drawing import Pose
from player.motions import BLOCK
from player.passes.foot_lock import FootLock


@dataclass
class Track:
    """One avatar's motion and where it stands. Place and start may be changed while it plays.

    A motion of any length takes the memory of two blocks.
    """

    clip: Callable[[int, int], Clip]
    frames: int
    rate: float
    # seconds into the motion at which the timeline begins
    start: float = 0.0
    at: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))  # metres
    turn: float = 0.0  # radians about y
    name: str = ""
    # what was assumed in reading it
    notes: tuple[str, ...] = ()
    # of the avatar in pose 0, metres; with them its feet can be held
    joints: Float[np.ndarray, "52 3"] | None = None
    # whether they are
    foot_lock: FootLock | None = None
    _held: tuple[FootLock, Callable[[int, Pose], Pose]] | None = field(default=None, repr=False)
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
        pose = block.axis_angle[i], block.root[i]
        held = self._held_feet()
        return self.placed(pose if held is None else held(frame, pose))

    def _held_feet(self) -> Callable[[int, Pose], Pose] | None:
        """What holds the feet, where that is asked for and there is something to hold."""
        if self.foot_lock is None or self.joints is None or self.frames < 2:
            return None
        if self._held is None or self._held[0] != self.foot_lock:
            # inverse kinematics only where they are asked for
            from player.held_feet import HeldFeet

            feet = HeldFeet(self.clip, self.frames, self.rate, self.joints, self.foot_lock)
            self._held = self.foot_lock, feet.pose
        return self._held[1]

    def placed(self, pose: Pose) -> Pose:
        """A pose turned about the world's y axis, then moved."""
        axis_angle, root = pose
        if self.turn:
            turned = matrix_from_axis_angle(np.array([0.0, self.turn, 0.0]))
            axis_angle = axis_angle.copy()
            axis_angle[0] = axis_angle_from_matrix(turned @ matrix_from_axis_angle(axis_angle[0]))
            root = turned @ root
        return axis_angle, root + self.at
