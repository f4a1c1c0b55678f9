"""Keyframes: poses at frames of a timeline, slerp between them; and the clip of every frame."""

from bisect import bisect_right
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar import rotation
from avatar.motion.clip import Clip

Easing = Literal["linear", "smooth"]


@dataclass(frozen=True, eq=False)
class Pose:
    """One pose; its arrays are never written to."""

    axis_angle: Float[Array, "52 3"]
    root: Float[Array, "3"]

    def __post_init__(self):
        for name, given in list(vars(self).items()):
            value = np.array(given, np.float64)  # a copy: the giver may go on writing to its own
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def same(self, other: "Pose") -> bool:
        """Equal to the last bit."""
        return np.array_equal(self.axis_angle, other.axis_angle) and np.array_equal(self.root, other.root)


Keys = tuple[tuple[int, Pose], ...]  # frame numbers growing


def with_key(keys: Keys, frame: int, pose: Pose) -> Keys:
    """The keys with one more, or another at that frame.

    Raises:
        ValueError: a frame before 0.
    """
    if frame < 0:
        raise ValueError(f"a key's frame should be 0 or more, is {frame}")
    return tuple(sorted([*((f, p) for f, p in keys if f != frame), (frame, pose)], key=lambda key: key[0]))


def minimum_jerk(t: Float[Array, "*b"] | float) -> Float[Array, "*b"] | float:
    """Minimum-jerk ease from 0 to 1 (Flash and Hogan 1985): 10 t^3 - 15 t^4 + 6 t^5."""
    t = np.clip(t, 0, 1)
    return t * t * t * (10 + t * (6 * t - 15))


def pose_at(keys: Keys, frame: float | int, easing: Easing = "linear") -> Pose:
    """The pose at any time, in frames: joints by slerp on the shorter arc, the root on a line.

    "smooth" starts and ends at rest at each key. Before the first key and after the last their poses are held.

    Raises:
        ValueError: there are no keys.
    """
    if not keys:
        raise ValueError("a timeline without keys has no pose")
    k = bisect_right([f for f, _ in keys], frame) - 1
    if k < 0 or k == len(keys) - 1 or keys[k][0] == frame:
        return keys[max(k, 0)][1]
    (first, a), (last, b) = keys[k], keys[k + 1]
    part = (frame - first) / (last - first)
    return between(a, b, float(minimum_jerk(part)) if easing == "smooth" else part)


def between(a: Pose, b: Pose, part: float | int) -> Pose:
    """A share `part` of the way from one pose to another."""
    joints = rotation.between(a.axis_angle, b.axis_angle, part)
    return Pose(rotation.nearest_axis_angle(joints, a.axis_angle), a.root + part * (b.root - a.root))


def clip_of(keys: Keys, rate: float | int, easing: Easing = "linear", pelvis_height: float | None = None) -> Clip:
    """Every frame from 0 to the last key."""
    poses = [pose_at(keys, frame, easing) for frame in range(keys[-1][0] + 1)]
    return Clip(np.stack([p.axis_angle for p in poses]), np.stack([p.root for p in poses]), rate, (), pelvis_height)
