"""One avatar's motion on a timeline: its pose at a moment, read in stretches, and where it stands."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from avatar import rotation
from avatar.face import face_between
from avatar.motion.clip import Clip, Motion
from player.draw.drawing import FASTEST, TURNED, Pose
from player.effects.foot_lock import FootLock
from player.scene.acting import LEAD, Acting
from player.scene.motions import BLOCK


@dataclass
class Track:
    """One avatar's motion and where it stands. Place and start may be changed while it plays.

    A motion of any length takes the memory of two blocks.
    """

    motion: Motion | Clip
    start: float = 0.0  # seconds into the motion at which the timeline begins
    at: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))  # metres
    turn: float = 0.0  # radians about y
    name: str = ""
    # the avatar's joints in pose 0, metres; with them its feet can be held
    joints: Float[np.ndarray, "52 3"] | None = None
    # whether they are
    foot_lock: FootLock | None = None
    # its face beside its motion's, where that is asked for
    acting: Acting | None = None
    _held: tuple[FootLock, Callable[[int, int, Clip], Pose]] | None = field(default=None, repr=False)
    _blocks: list[tuple[int, Clip]] = field(default_factory=list, repr=False)

    @property
    def end(self) -> float:
        """Seconds into the timeline at which the motion has been shown."""
        return self.motion.frames / self.motion.rate - self.start

    def frame(self, seconds: float | int) -> int:
        """The motion's own frame at a moment of the timeline; past its end the last is held."""
        return min(max(int((seconds + self.start) * self.motion.rate + 1e-6), 0), self.motion.frames - 1)

    def lasts(self, alone: float | int = 0.0) -> float:
        """Seconds into the timeline at which motion and speech have ended, of a still body `alone` seconds of life."""
        if self.acting is None:
            return self.end
        return max(self.end, self.acting.lasts(alone if self.motion.frames == 1 else 0.0))

    def pose(self, seconds: float | int, lived: float | int | None = None) -> Pose:
        """The pose at a moment, in its place; `lived` is the moment of life where that is another."""
        return self.placed(self._swaying(self._own(self.frame(seconds)), seconds if lived is None else lived))

    def faced(
        self, pose: Pose, seconds: float | int, eye: Float[np.ndarray, "3"], lived: float | int | None = None
    ) -> Pose:
        """A pose of it at a moment of the timeline with what the face does then, before a camera at `eye`, world."""
        if self.acting is None:
            return pose
        ahead = self.pose(seconds + LEAD, lived) if self.motion.frames > 1 else None
        return self.acting.faced(pose, seconds, eye, ahead, lived)

    def _swaying(self, pose: Pose, seconds: float | int) -> Pose:
        """A body that no motion moves, breathing where that is asked for."""
        return pose if self.acting is None or self.motion.frames > 1 else self.acting.swaying(pose, seconds)

    def pose_beside(self, seconds: float, away: float) -> Pose:
        """The pose `away` seconds from a moment, between two frames of the motion; where it jumps between them (faster
        than FASTEST, or turned by more than TURNED), the pose on this moment's side of the jump."""
        here = self.frame(seconds)
        # a moment shows the frame that began last; times beside it are counted from there
        at = min(max(here + away * self.motion.rate, 0.0), self.motion.frames - 1.0)
        while here + 1 <= at and not self._jumps(here):
            here += 1
        while here - 1 >= at and not self._jumps(here - 1):
            here -= 1
        part = at - here
        low = here if part > 0 else here - 1
        if part == 0 or abs(part) >= 1 or self._jumps(low):
            return self.placed(self._swaying(self._own(here), seconds + away))
        part = at - low
        (before, root_before, face), (after, root_after, face_after) = self._own(low), self._own(low + 1)
        root = root_before + part * (root_after - root_before)
        return self.placed(Pose(rotation.between(before, after, part), root, face_between(face, face_after, part)))

    def _jumps(self, frame: int) -> bool:
        """Whether the motion jumps between this frame and the next."""
        (before, root_before, _), (after, root_after, _) = self._own(frame), self._own(frame + 1)
        if np.linalg.norm(root_after - root_before) * self.motion.rate > FASTEST:
            return True
        q_before, q_after = (rotation.quaternion_from_axis_angle(one[0]) for one in (before, after))
        return bool(2 * np.arccos(min(abs(float(q_before @ q_after)), 1.0)) > TURNED)

    def _own(self, frame: int) -> Pose:
        """The motion's own frame, its feet held where that is asked for."""
        first = frame - frame % BLOCK
        block = next((clip for start, clip in self._blocks if start == first), None)
        if block is None:
            block = self.motion.read(first, min(first + BLOCK, self.motion.frames))
            # the one before stays, for stepping back
            self._blocks = [*self._blocks[-1:], (first, block)]
        i = frame - first
        held = self._held_feet()
        face = block.face_at(i)
        if held is not None:
            return held(frame, first, block)._replace(face=face)
        return Pose(block.axis_angle[i], block.root[i], face)

    def _held_feet(self) -> Callable[[int, int, Clip], Pose] | None:
        """What holds the feet, where that is asked for and there is something to hold."""
        if self.foot_lock is None or self.joints is None or self.motion.frames < 2:
            return None
        if self._held is None or self._held[0] != self.foot_lock:
            # inverse kinematics only where they are asked for
            from player.effects.held_feet import HeldFeet

            self._held = self.foot_lock, HeldFeet(self.motion, self.joints, self.foot_lock).pose
        return self._held[1]

    def placed(self, pose: Pose) -> Pose:
        """A pose turned about the world's y axis, then moved."""
        axis_angle, root, face = pose
        if self.turn:
            turned = rotation.matrix_from_axis_angle(np.array([0.0, self.turn, 0.0]))
            axis_angle = axis_angle.copy()
            axis_angle[0] = rotation.axis_angle_from_matrix(turned @ rotation.matrix_from_axis_angle(axis_angle[0]))
            root = turned @ root
        return Pose(axis_angle, root + self.at, face)
