"""T-pose calibration: what a sender's bones look like in a T-pose, so that any rig becomes ours.

A rig's bones may have any rotation at rest (VRM 1 sends them raw). With q0 a bone's local rotation in the T-pose
and W its parent's rotation in the world then (the product of q0 from the hips down), the same turn between bones
that are identity at rest is

    q_n = W (q q0^-1) W^-1

because the turn in the parent's axes, q q0^-1, is carried to axes that stand as the world's. Only bones that are
sent enter W; a rig with turned joints between them that are not sent cannot be recovered.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from avatar.face import REST, FaceFrame
from avatar.gaze import with_looks
from avatar.rotation import axis_angle_from_quaternion, quaternion_inverse, quaternion_product
from avatar.skeleton import DEPTHS, JOINT_NUMBERS, PARENTS
from player.draw.drawing import Pose
from player.live.vmc import VmcRig, gaze_of_eyes

HEAD = JOINT_NUMBERS["head"]


class Calibration(NamedTuple):
    rest: Float[np.ndarray, "52 4"]  # q0
    parent_rest: Float[np.ndarray, "52 4"]  # W
    # q0 of the left and of the right eye, and W of both, which is the head's
    eyes: Float[np.ndarray, "2 4"]
    head: Float[np.ndarray, "2 4"]


IDENTITY = np.tile([0.0, 0, 0, 1], (52, 1))
IDENTITY.setflags(write=False)
# that for a rig whose bones are identity in the T-pose
NORMALISED = Calibration(IDENTITY, IDENTITY, IDENTITY[:2], IDENTITY[:2])


def calibrated(t_pose: VmcRig) -> Calibration:
    """The calibration of a rig that stands in the T-pose, facing where it should face in our pose 0."""
    world = t_pose.rotations.copy()
    parent_rest = IDENTITY.copy()
    for joints in DEPTHS:
        parent_rest[joints] = world[PARENTS[joints]]
        world[joints] = quaternion_product(parent_rest[joints], t_pose.rotations[joints])
    eyes = IDENTITY[:2] if t_pose.eyes is None else t_pose.eyes
    return Calibration(t_pose.rotations.copy(), parent_rest, eyes, np.tile(world[HEAD], (2, 1)))


def normalised(
    q: Float[np.ndarray, "bones 4"], rest: Float[np.ndarray, "bones 4"], W: Float[np.ndarray, "bones 4"]
) -> Float[np.ndarray, "bones 4"]:
    """W (q q0^-1) W^-1."""
    turn = quaternion_product(q, quaternion_inverse(rest))
    return quaternion_product(quaternion_product(W, turn), quaternion_inverse(W))


def pose_from_rig(rig: VmcRig, calibration: Calibration, face: FaceFrame | None = None) -> Pose:
    """Our pose of a rig; the root's pose moves and turns the pelvis. Eyes that turn are its gaze; lids follow."""
    normal = normalised(rig.rotations, calibration.rest, calibration.parent_rest)
    if rig.eyes is not None:
        gaze = gaze_of_eyes(normalised(rig.eyes, calibration.eyes, calibration.head))
        face = face if gaze is None else FaceFrame(with_looks((face or REST).weights, gaze), gaze)
    normal[0] = quaternion_product(rig.root_rotation, normal[0])
    hips = np.append(rig.hips, 0.0)
    carried = quaternion_product(quaternion_product(rig.root_rotation, hips), quaternion_inverse(rig.root_rotation))
    return Pose(axis_angle_from_quaternion(normal), rig.root + carried[:3], face)
