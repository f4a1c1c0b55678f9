"""The One-Euro filter (Casiez, Roussel and Vogel 2012) for poses: steady at rest, quick in motion.

A low pass whose cut-off rises with speed:

    x^ = x^_last + a (x - x^_last),    a = 1 / (1 + 1 / (2 pi f dt)),    f = least + gain |speed|

per joint on the sphere of rotations (speed in radians a second, slerp for the sum) and on the root (metres).
The speed itself goes through a low pass of 1 Hz.
"""

import numpy as np

from avatar.rotation import (
    axis_angle_from_quaternion,
    quaternion_from_axis_angle,
    quaternion_inverse,
    quaternion_product,
    slerp,
)
from player.draw.drawing import Pose

LEAST = 1.5  # Hz, at rest
TURN_GAIN = 4.0  # Hz for a radian a second
MOVE_GAIN = 8.0  # Hz for a metre a second
SPEED_CUTOFF = 1.0  # Hz


class OneEuro:
    """Smooths poses given one after another. A constant pose comes out as it is."""

    def __init__(self, least: float | int = LEAST):
        self.least = least
        self.reset()

    def reset(self) -> None:
        self.raw: tuple[np.ndarray, np.ndarray] | None = None
        self.smooth: tuple[np.ndarray, np.ndarray] | None = None
        self.speed = (np.zeros((52, 3)), np.zeros(3))

    def __call__(self, pose: Pose, dt: float | int) -> Pose:
        """The smoothed pose, `dt` seconds after the last; with dt <= 0, the last again."""
        q, root = quaternion_from_axis_angle(pose.axis_angle), np.asarray(pose.root, np.float64)
        if self.raw is None or self.smooth is None:
            self.raw = self.smooth = (q, root)
            return pose
        if dt > 0:
            a = share(SPEED_CUTOFF, dt)
            turn = axis_angle_from_quaternion(quaternion_product(q, quaternion_inverse(self.raw[0]))) / dt
            move = (root - self.raw[1]) / dt
            self.speed = (self.speed[0] + a * (turn - self.speed[0]), self.speed[1] + a * (move - self.speed[1]))
            turning = share(self.least + TURN_GAIN * np.linalg.norm(self.speed[0], axis=-1), dt)
            moving = share(self.least + MOVE_GAIN * np.linalg.norm(self.speed[1]), dt)
            last_q, last_root = self.smooth
            self.raw = (q, root)
            self.smooth = (slerp(last_q, q, turning), last_root + moving * (root - last_root))
        return Pose(axis_angle_from_quaternion(self.smooth[0]), self.smooth[1], pose.face)


def share(cutoff, dt: float | int):
    """How much of a new value a low pass takes: a = 1 / (1 + 1 / (2 pi f dt))."""
    return 1 / (1 + 1 / (2 * np.pi * cutoff * dt))
