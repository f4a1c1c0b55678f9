"""Where eyes look, and the eyeLook* shapes that say it: 1 is as far as an eye turns; and a head that turns.

Angles are those of `FaceFrame.gaze`: yaw to the person's left and pitch upwards, radians, away from an eye's axis. What
turns the balls is the gaze; the eyeLook* shapes move lids with it.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.face import Eye
from avatar.face_names import NUMBER
from avatar.rotation import axis_angle_from_matrix, matrix_from_axis_angle
from avatar.skeleton import JOINT_NUMBERS

# as far as eyes turn without effort
YAW, UP, DOWN = np.radians([35.0, 25.0, 30.0]).tolist()
# as far as each turns towards the other from where both look
CROSSED = float(np.radians(25.0))
NECK_AND_HEAD = [JOINT_NUMBERS["neck"], JOINT_NUMBERS["head"]]
# the neck's share of the head's turn
NECK = 0.4
# by eye, left first: the shapes of looking to the person's left and right, up and down
_LOOKS = np.array([[NUMBER[f"eyeLook{way}"] for way in ways.split()] for ways in (
    "OutLeft InLeft UpLeft DownLeft", "InRight OutRight UpRight DownRight",
)])  # fmt: skip
# by eye, left first: its blink, and what else moves its lids
_BLINKS = [NUMBER["eyeBlinkLeft"], NUMBER["eyeBlinkRight"]]
_LIDS = np.array([[*looks, NUMBER[f"eyeSquint{side}"], NUMBER[f"eyeWide{side}"]]
                  for looks, side in zip(_LOOKS, ("Left", "Right"), strict=True)])  # fmt: skip


def within_reach(gaze: Float[Array, "*f 2 2"]) -> Float[Array, "*f 2 2"]:
    """Each eye no further than it turns, and both no further towards each other than eyes do."""
    out = np.clip(gaze, [-YAW, -DOWN], [YAW, UP])
    beyond = np.maximum((out[..., 1, 0] - out[..., 0, 0]) / 2 - CROSSED, 0.0)
    out[..., 0, 0] += beyond
    out[..., 1, 0] -= beyond
    return out


def gaze_of(weights: Float[Array, "*f 52"]) -> Float[Array, "*f 2 2"]:
    """The gaze that the eyeLook* shapes of a sender mean."""
    left, right, up, down = np.moveaxis(weights[..., _LOOKS], -1, 0)
    return np.stack([YAW * (left - right), UP * up - DOWN * down], -1)


def with_looks(weights: Float[Array, "52"], gaze: Float[Array, "2 2"]) -> Float[Array, "52"]:
    """The weights with the eyeLook* shapes of a gaze, so that lids follow it."""
    out = weights.copy()
    yaw, pitch = within_reach(gaze).T
    looks = np.stack([yaw / YAW, -yaw / YAW, pitch / UP, -pitch / DOWN], 1)
    out[_LOOKS] = np.maximum(looks, 0.0)
    return out


def with_blinks(weights: Float[Array, "*f 52"]) -> Float[Array, "*f 52"]:
    """The weights, from 0 to 1, as they are shown: what else moves lids less by what a blink closes them, so that a
    closed eye is closed, no more and no less, whatever it looks at, squints or widens."""
    out = weights.copy()
    out[..., _LIDS] *= 1.0 - weights[..., _BLINKS, None]
    return out


def gaze_at(
    point: Float[Array, "3"], eyes: Sequence[Eye], world_from_canonical: Float[Array, "4 4"]
) -> Float[Array, "2 2"]:
    """The gaze of each eye at a point of the world, whatever its reach: with its own angle each, so that eyes converge.

    `world_from_canonical` is the head's bone matrix.
    """
    canonical = np.linalg.inv(world_from_canonical) @ np.append(point, 1.0)
    return np.stack([angles_of(canonical[:3] - eye.center) - angles_of(eye.axis) for eye in eyes])


def angles_of(direction: Float[Array, "3"]) -> Float[Array, "2"]:
    """Yaw to the person's left and pitch upwards of a direction of the canonical frame (x left, y up, z forward)."""
    x, y, z = direction
    return np.array([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])


def turned_head(turn: Float[Array, "*f 3"]) -> Float[Array, "*f 52 3"]:
    """Poses whose neck and head share a turn: yaw to the person's left, pitch downwards, roll to the right, radians."""
    each = matrix_from_axis_angle(turn[..., None] * np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]))
    yaw, pitch, roll = np.moveaxis(each, -3, 0)
    return pose_of_head(yaw @ pitch @ roll)


def pose_of_head(R: Float[Array, "*f 3 3"]) -> Float[Array, "*f 52 3"]:
    """Poses whose neck and head share a rotation."""
    turn, pose = axis_angle_from_matrix(R), np.zeros((*R.shape[:-2], 52, 3))
    # both turn about one axis, so their shares add up
    pose[..., NECK_AND_HEAD, :] = np.array([[NECK], [1 - NECK]]) * turn[..., None, :]
    return pose
