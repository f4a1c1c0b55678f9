"""The 52-joint SMPL+H skeleton and its forward kinematics."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.rotation import affine, axis_angle_from_matrix, matrix_from_axis_angle

_BODY = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot right_foot "
    "neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist"
).split()
FINGERS = ("index", "middle", "pinky", "ring", "thumb")  # SMPL+H order, not anatomical

JOINTS: tuple[str, ...] = tuple(
    _BODY + [f"{side}_{finger}{n}" for side in ("left", "right") for finger in FINGERS for n in (1, 2, 3)]
)
JOINT_NUMBERS = {name: number for number, name in enumerate(JOINTS)}
LEFT_HAND, RIGHT_HAND = slice(22, 37), slice(37, 52)

# parts of the person, each with a video and a field of its own; the index is the part's number everywhere
PARTS = ("body", "head", "hand_left", "hand_right")


def _parents() -> np.ndarray:
    body = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
    hands = []
    for wrist, first in ((20, 22), (21, 37)):
        for finger in range(5):
            hands += [wrist, first + 3 * finger, first + 3 * finger + 1]
    return np.array(body + hands)


PARENTS = _parents()


# [k, j]: joint k is j or hangs from it
DESCENDS = np.eye(52, dtype=bool)
for _joint in range(1, 52):
    DESCENDS[_joint] |= DESCENDS[PARENTS[_joint]]
# joints by their distance from the pelvis, nearest first, the pelvis left out
DEPTHS = tuple(np.flatnonzero(DESCENDS.sum(1) == count) for count in range(2, DESCENDS.sum(1).max() + 1))

# canonical pose of the fields: both hips opened 30 degrees about z
BIG_POSE = np.zeros((52, 3))
BIG_POSE[1, 2], BIG_POSE[2, 2] = np.pi / 6, -np.pi / 6
BIG_POSE.setflags(write=False)
PARENTS.setflags(write=False)


def joint_transforms(
    axis_angle: Float[Array, "*b 52 3"], joints: Float[Array, "52 3"], root: Float[Array, "*b 3"] | None = None
) -> Float[Array, "*b 52 4 4"]:
    """Forward kinematics: G_k = world_from_joint of each joint (Loper et al. 2015, Eq. 3-4).

    axis_angle is parent_from_joint, radians; joint frames are parallel to the world in pose 0. `joints` are
    the rest positions in metres. The pelvis lands on `root` (world, metres), or stays at joints[0].
    """
    axis_angle = np.asarray(axis_angle, np.float64)
    local = np.zeros((*axis_angle.shape[:-1], 4, 4))
    local[..., :3, :3] = matrix_from_axis_angle(axis_angle)
    local[..., 1:, :3, 3] = joints[1:] - joints[PARENTS[1:]]
    local[..., 0, :3, 3] = joints[0] if root is None else root
    local[..., 3, 3] = 1
    world = local.copy()
    # all joints equally far from the pelvis at once: twice as fast as one by one
    for joints_of_depth in DEPTHS:
        parents = PARENTS[joints_of_depth]
        world[..., joints_of_depth, :, :] = world[..., parents, :, :] @ local[..., joints_of_depth, :, :]
    return world


def pose_of_rotations(R: Float[Array, "frames 52 3 3"]) -> Float[Array, "frames 52 3"]:
    """The pose, axis-angle, whose joints have these rotations in the world."""
    local = R.copy()
    local[:, 1:] = np.swapaxes(R[:, PARENTS[1:]], -1, -2) @ R[:, 1:]
    return axis_angle_from_matrix(local)


def rigid_inverse(transforms: Float[Array, "*b 4 4"]) -> Float[Array, "*b 4 4"]:
    """Inverse of rotations with translations: [R^T, -R^T t]."""
    back = np.swapaxes(transforms[..., :3, :3], -1, -2)
    return affine(back, (-back @ transforms[..., :3, 3:])[..., 0])


def skin_transforms(
    axis_angle: Float[Array, "*b 52 3"], joints: Float[Array, "52 3"], root: Float[Array, "*b 3"] | None = None,
    rest: Float[Array, "52 3"] = BIG_POSE,
) -> Float[Array, "*b 52 4 4"]:  # fmt: skip
    """B_k = G_k(pose) G_k(rest)^-1: where bone k takes a point that is given in the rest pose.

    `rest` is the pose that the points are stored in: the big pose for canonical points, zeros for pose 0.
    """
    return joint_transforms(axis_angle, joints, root) @ rigid_inverse(joint_transforms(rest, joints))
