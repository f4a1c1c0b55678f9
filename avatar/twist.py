"""Twist joints: more bones along forearms, upper arms and thighs, so that linear blending keeps twisted limbs' volume.

A joint's rotation is a twist about its bone and a swing of the bone (swing-twist decomposition, Kavan and Sorber 2006):
of a quaternion (v, w) the twist about the unit axis e is 2 atan2(v . e, w). Linear blending of two bones that differ by
a twist d leaves cos(d / 2)^2 of a section at its thinnest, so a limb's twist is spread over bones that differ by
little. The bone at share a of a segment from joint J to joint C turns, in J's frame and about the segment, by

    a c twist(C) - (1 - a) twist(J)        c = 1 for forearms, which the wrist turns, else 0

At share 0 it has J's swing alone, at share 1 it turns as C does (forearm), or as J (upper arm, thigh). A twist jumps
where it passes a half turn, as every continuous pose must there (avatar/limits.py: no limb can). It follows from the 52
rotations of a pose alone: nothing is stored in poses.

Numbers of the twist joints follow those of the skeleton's: 52, 53 ... in the order of TWIST_JOINTS.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.rotation import affine, cross_matrix, quaternion_from_axis_angle, unit_or_zero
from avatar.skeleton import JOINTS


class Segment(NamedTuple):
    """A bone that is given twist joints."""

    joint: int
    child: int
    # 0 to 1 along it, of each twist joint
    shares: tuple[float, ...]
    # the child turns its end, else the joint itself does
    carried: bool


# bones of a forearm turned by a half turn, of an upper arm or thigh turned by 90 degrees, differ by 15 and 22 degrees:
# sections keep .98 and .96 of their area. Two joints in a forearm would leave .75.
STEPS = {"forearm": 12, "upper_arm": 4, "thigh": 4}
LIMBS = (("forearm", "elbow", "wrist"), ("upper_arm", "shoulder", "elbow"), ("thigh", "hip", "knee"))


def _segments() -> dict[str, Segment]:
    found = {}
    for side in ("left", "right"):
        for name, joint, child in LIMBS:
            steps, carried = STEPS[name], name == "forearm"
            shares = tuple(k / steps for k in range(steps + carried))
            ends = JOINTS.index(f"{side}_{joint}"), JOINTS.index(f"{side}_{child}")
            found[f"{side}_{name}"] = Segment(*ends, shares, carried)
    return found


SEGMENTS = _segments()
TWIST_JOINTS = tuple(f"{name}_twist{k}" for name, part in SEGMENTS.items() for k in range(len(part.shares)))

_JOINT = np.array([s.joint for s in SEGMENTS.values() for _ in s.shares])
_CHILD = np.array([s.child for s in SEGMENTS.values() for _ in s.shares])
_SHARE = np.array([share for s in SEGMENTS.values() for share in s.shares])
_CARRIED = np.array([float(s.carried) for s in SEGMENTS.values() for _ in s.shares])
# the joint of the skeleton that each turns with
TWIST_CARRIER = _JOINT
TWIST_CARRIER.setflags(write=False)
_SEGMENT = np.array([k for k, s in enumerate(SEGMENTS.values()) for _ in s.shares])
# the joint of every segment, then the child of every segment
_ENDS = np.array([s.joint for s in SEGMENTS.values()] + [s.child for s in SEGMENTS.values()])


class TwistJoints:
    """The twist joints of one skeleton, whose joints rest at `joints`, metres."""

    def __init__(self, joints: Float[Array, "52 3"]):
        along = joints[_CHILD] - joints[_JOINT]
        # a bone without length has no axis and is never twisted
        self.axes = unit_or_zero(along)
        # from their joint, pose 0, metres
        self.offsets = _SHARE[:, None] * along
        first = np.searchsorted(_SEGMENT, np.arange(len(SEGMENTS)))
        self._axes_of_ends = np.concatenate([self.axes[first], self.axes[first]])
        # Rodrigues' formula: R = I + sin t K + (1 - cos t) K^2
        self._K = cross_matrix(self.axes)
        self._K2 = self._K @ self._K

    def axis_angle(self, pose: Float[Array, "*b 52 3"]) -> Float[Array, "*b twists 3"]:
        """joint_from_twist_joint of each twist joint in a pose, radians."""
        return self.angles(pose)[..., None] * self.axes

    def angles(self, pose: Float[Array, "*b 52 3"]) -> Float[Array, "*b twists"]:
        """How far each turns about its segment, radians."""
        twist = self._twist(pose[..., _ENDS, :])
        own, child = twist[..., _SEGMENT], twist[..., _SEGMENT + len(SEGMENTS)]
        return _CARRIED * _SHARE * child - (1 - _SHARE) * own

    def transforms(
        self, pose: Float[Array, "52 3"], outer_from_joint: Float[Array, "52 4 4"]
    ) -> Float[Array, "twists 4 4"]:
        """outer_from_twist_joint of each, from the skeleton's own transforms in this pose."""
        angle = self.angles(pose)[:, None, None]
        R = np.eye(3) + np.sin(angle) * self._K + (1 - np.cos(angle)) * self._K2
        return outer_from_joint[_JOINT] @ affine(R, self.offsets)

    def _twist(self, axis_angle: Float[Array, "*b ends 3"]) -> Float[Array, "*b ends"]:
        """Twist of rotations about the segments, within half a turn; 0 where a swing of half a turn leaves it open."""
        q = quaternion_from_axis_angle(np.asarray(axis_angle, np.float64))
        along, w = np.einsum("...si,si->...s", q[..., :3], self._axes_of_ends), q[..., 3]
        flip = np.where(w < 0, -1.0, 1.0)
        return 2 * np.arctan2(flip * along, flip * w)
