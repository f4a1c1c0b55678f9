"""What an avatar's face does in a scene: its motion's or its sender's own, else life; and speech moves its mouth."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar
from avatar.face import REST, FaceFrame
from avatar.gaze import DOWN, UP, YAW, angles_of, gaze_at, within_reach
from avatar.skeleton import JOINT_NUMBERS, joint_transforms
from files.sound import read_wav
from player.draw.drawing import Pose
from player.face.life import life, sway
from player.face.speech import Speech
from player.scene.scene import SceneAvatar

HEAD = JOINT_NUMBERS["head"]
# seconds of a film in which nothing but life happens
ALONE = 10.0
# seconds by which eyes are ahead of a head that turns
LEAD = 0.2


@dataclass(frozen=True)
class Acting:
    """Life and speech of one avatar: functions of the scene's time, so that any frame can be made first."""

    avatar: Avatar
    # None: no life
    seed: int | None = None
    speech: Speech | None = None

    def lasts(self, alone: float | int) -> float:
        """Seconds of the speech; without one, of life `alone`."""
        return self.speech.seconds if self.speech is not None else 0.0 if self.seed is None else alone

    def swaying(self, pose: Pose, seconds: float | int) -> Pose:
        """A body that stands still, breathing."""
        if self.seed is None:
            return pose
        # the turns are small: order does not matter
        return pose._replace(axis_angle=pose.axis_angle + sway(self.seed, seconds))

    def faced(
        self, pose: Pose, seconds: float | int, eye: Float[Array, "3"], ahead: Pose | None = None,
        lived: float | int | None = None,
    ) -> Pose:  # fmt: skip
        """The pose with what the face does at a moment; `lived` is the moment of life where that is another. What eyes
        look at: the camera's place `eye`, world; `ahead`, the pose LEAD seconds later, where they get before the head.
        """
        face = pose.face
        if face is None and self.seed is not None:
            face = life(self.seed, seconds if lived is None else lived, self.gaze(pose, eye, ahead))
        if self.speech is not None:
            face = face or REST
            face = FaceFrame(np.clip(face.weights + self.speech.weights(seconds), 0.0, 1.0), face.gaze)
        return pose._replace(face=face)

    def gaze(self, pose: Pose, eye: Float[Array, "3"], ahead: Pose | None = None) -> Float[Array, "2 2"]:
        """The gaze at the camera; where that is farther aside than eyes turn, ahead to where the head will be."""
        if self.avatar.eyes is None:
            return np.zeros((2, 2))
        head, gaze = self._head(pose), np.zeros((2, 2))
        if ahead is not None:
            gaze += angles_of(head[:3, :3].T @ self._head(ahead)[:3, 2])
        canonical = joint_transforms(self.avatar.canonical_pose, self._joints)[HEAD]
        at = gaze_at(eye, self.avatar.eyes, head @ np.linalg.inv(canonical))
        yaw, pitch = at.T
        # each eye's: behind the head, their mean is ahead
        beyond = max(np.abs(yaw).max() / YAW, pitch.max() / UP, -pitch.min() / DOWN)
        share = min(max(2.0 - beyond, 0.0), 1.0)
        return share * within_reach(at) + (1.0 - share) * within_reach(gaze)

    def _head(self, pose: Pose) -> Float[Array, "4 4"]:
        return joint_transforms(pose.axis_angle, self._joints, pose.root)[HEAD]

    @property
    def _joints(self) -> Float[Array, "52 3"]:
        return self.avatar.joint_positions.astype(np.float64)


def opened_acting(entry: SceneAvatar, avatar: Avatar) -> Acting | None:
    """The life and speech that an entry of a scene asks for; None: neither.

    Raises:
        AssetError: the sound cannot be read.
    """
    if entry.life is None and entry.speech is None:
        return None
    return Acting(avatar, entry.life, None if entry.speech is None else Speech(read_wav(entry.speech)))
