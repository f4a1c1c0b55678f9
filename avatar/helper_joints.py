"""Helper joints: the bones that follow from a pose of the 52 joints, twist joints and behind them bend joints.

They are for linear blending, in our player and in any other: limbs that turn (avatar/twist.py) or bend
(avatar/bend.py) keep their volume. Nothing of them is stored in poses.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.bend import BEND_CARRIER, BEND_JOINTS, BendJoints
from avatar.rotation import axis_angle_from_quaternion
from avatar.skeleton import JOINTS
from avatar.twist import TWIST_CARRIER, TWIST_JOINTS, TwistJoints

# names of all; files with twist joints alone end behind those
HELPER_JOINTS = (*TWIST_JOINTS, *BEND_JOINTS)
# the joint of the skeleton whose child each bone is, and for which its weights count; of the 52 themselves
CARRIER = np.concatenate([np.arange(len(JOINTS)), TWIST_CARRIER, BEND_CARRIER])
CARRIER.setflags(write=False)
BONES = len(CARRIER)


class HelperJoints:
    """Of one skeleton, whose joints rest at `joints`, metres. Without `push` (avatar/bend.py) twist joints alone."""

    def __init__(self, joints: Float[Array, "52 3"], push: Float[Array, "bends"] | None):
        self.twist = TwistJoints(joints)
        self.bend = None if push is None else BendJoints(joints, push)
        self.names = TWIST_JOINTS if push is None else HELPER_JOINTS
        bent = np.zeros((0, 3)) if self.bend is None else self.bend.offsets
        # from their parent, pose 0, metres
        self.offsets = np.concatenate([self.twist.offsets, bent])

    def with_helpers(
        self, pose: Float[Array, "52 3"], outer_from_joint: Float[Array, "52 4 4"]
    ) -> Float[Array, "bones 4 4"]:
        """The skeleton's transforms in this pose, and behind them those of the helper joints."""
        parts = [outer_from_joint, self.twist.transforms(pose, outer_from_joint)]
        if self.bend is not None:
            parts.append(self.bend.transforms(pose, outer_from_joint))
        return np.concatenate(parts)

    def local(
        self, pose: Float[Array, "frames 52 3"]
    ) -> tuple[Float[Array, "frames helpers 3"], Float[Array, "frames helpers 3"]]:
        """parent_from_helper_joint in poses: axis-angle, and places in metres."""
        turns = self.twist.axis_angle(pose)
        places = np.broadcast_to(self.twist.offsets, turns.shape)
        if self.bend is None:
            return turns, places
        bent, at = self.bend.local(pose)
        turns = np.concatenate([turns, axis_angle_from_quaternion(bent)], axis=1)
        return turns, np.concatenate([places, at], axis=1)
