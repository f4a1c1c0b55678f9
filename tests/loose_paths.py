"""Ways a body goes with loose parts on it, and where they go."""

import numpy as np

from player.effects.loose_motion import LooseMotion
from player.effects.secondary_motion import SecondaryMotion

SETTINGS = SecondaryMotion()


def dance(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """A pose of a wild dance: turns of the whole body, steps, swinging arms and a nodding head; smooth in time."""
    pose, w = np.zeros((52, 3)), 2 * np.pi * seconds
    pose[0, 1] = 1.6 * np.sin(0.5 * w)
    pose[1, 0], pose[2, 0] = -0.5 - 0.5 * np.sin(0.9 * w), -0.5 + 0.5 * np.sin(0.9 * w)
    pose[4, 0], pose[5, 0] = 0.5 + 0.5 * np.sin(0.9 * w), 0.5 - 0.5 * np.sin(0.9 * w)
    pose[6] = [0.2 * np.sin(0.7 * w), 0.3 * np.sin(0.6 * w), 0.15 * np.sin(0.8 * w)]
    pose[15] = [0.3 * np.sin(1.1 * w), 0.7 * np.sin(0.8 * w), 0.2 * np.sin(0.5 * w)]
    pose[16], pose[17] = [0, 0.6 * np.sin(0.9 * w), -1.0 + 0.4 * np.sin(w)], [0, 0.6 * np.sin(0.9 * w), 1.0]
    pose[18, 1], pose[19, 1] = -0.8 + 0.6 * np.sin(1.2 * w), 0.8 + 0.6 * np.sin(w)
    root = np.array([0.4 * np.sin(0.4 * w), 0.9 + 0.08 * np.sin(1.8 * w), 0.3 * np.sin(0.3 * w)])
    return pose, root


def gently(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """The dance with joints turned a third as far."""
    axis_angle, root = dance(seconds)
    return 0.3 * axis_angle, root


def danced(renderer, seconds=0.7):
    """The renderer told of a dance; its last pose."""
    for frame in range(int(60 * seconds) + 1):
        renderer.move([dance(frame / 60)], frame / 60)
    return dance(int(60 * seconds) / 60)


def moved(parts, rate, seconds, pose_at, settings=SETTINGS):
    """The motion after so many seconds, and the offsets 30 times a second."""
    motion, offsets = LooseMotion(parts, settings), []
    for frame in range(round(seconds * rate) + 1):
        motion.move(pose_at(frame / rate), frame / rate)
        if frame % round(rate / 30) == 0:
            offsets.append(motion.offsets)
    return motion, np.array(offsets)
