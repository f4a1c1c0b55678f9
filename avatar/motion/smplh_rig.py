"""A file's skeleton that is SMPL+H's own: its rotations are read joint by joint, nothing is retargeted.

What a rig must show for that: the 22 joints of the body under our names, hung on one another as ours are, at
rest in T-pose, upright, facing +z, and no bone turned at rest. Then, with G_k the turn of a bone away from rest,

    local_k = G_parent^T G_k

is the SMPL rotation, whatever the lengths of the bones.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.motion.clip import Motion, builtin_skeleton
from avatar.motion.rig import REQUIRED, AnimatedRig
from avatar.rotation import axis_angle_from_matrix
from avatar.skeleton import JOINT_NUMBERS as J
from avatar.skeleton import JOINTS, PARENTS

LIMBS = tuple(f"{side}_{name}" for side in ("left", "right") for name in REQUIRED) + ("head",)
# degrees that limbs may rest off a T-pose: people differ, an A-pose is 40
MOST_OFF = 20.0


def is_smplh(rig: AnimatedRig) -> bool:
    """Whether the names, the tree and the rest places are SMPL+H's; unturned bones are the caller's to know."""
    place = {name: k for k, name in enumerate(rig.names) if name in J}
    if not all(name in place for name in JOINTS[:22]):
        return False
    for name, k in place.items():
        above = rig.parents[k]
        while above >= 0 and rig.names[above] not in J:
            above = rig.parents[above]
        if (J[rig.names[above]] if above >= 0 else -1) != PARENTS[J[name]]:
            return False
    at = rig.rest_positions
    left = at[place["left_shoulder"]] - at[place["right_shoulder"]]
    up = at[place["head"]] - at[place["pelvis"]]
    upright = up[1] > 0.9 * np.linalg.norm(up) and left[0] > 0.9 * np.linalg.norm(left) > 0
    return bool(upright and off_t_pose(at, place) < MOST_OFF)


def off_t_pose(at: Float[Array, "nodes 3"], place: dict[str, int]) -> float:
    """Mean angle, degrees, of upper arms and thighs to a T-pose's, in the frame of hips and head."""
    hips = (at[place["left_hip"]] + at[place["right_hip"]]) / 2
    up, left = at[place["head"]] - hips, at[place["left_hip"]] - at[place["right_hip"]]
    total = 0.0
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for a, b, goal in (("hip", "knee", -up), ("shoulder", "elbow", sign * left)):
            bone = at[place[f"{side}_{b}"]] - at[place[f"{side}_{a}"]]
            length = np.linalg.norm(bone) * np.linalg.norm(goal)
            total += float(np.degrees(np.arccos(np.clip(bone @ goal / length, -1, 1)))) if length > 0 else 180.0
    return total / 4


def leg_length(at: Float[Array, "nodes 3"], place: dict[str, int]) -> float:
    """Thigh and shin together, mean of both sides, in the units of `at`."""
    chains = [[at[place[f"{side}_{name}"]] for name in ("hip", "knee", "ankle")] for side in ("left", "right")]
    return float(np.linalg.norm(np.diff(chains, axis=1), axis=-1).sum()) / 2


def read_exactly(rig: AnimatedRig, notes: list[str], unit: float = 1.0, pelvis_height: float | None = None) -> Motion:
    """The motion of a rig that `is_smplh`; `unit` is the metres of one unit of the file.

    `pelvis_height` is the rig's own, metres above the soles, where the file has it; else it is the built-in
    body's in the ratio of the legs.
    """
    place = {name: k for k, name in enumerate(rig.names) if name in J}
    notes.append("joints: SMPL+H in T-pose, rotations read as they are")
    if "left_index1" not in place:
        notes.append("hands: none in the file, flat")
    own = [place.get(name, -1) for name in JOINTS]

    def block(start: int, stop: int) -> tuple[Array, Array]:
        """Poses and roots of frames start .. stop - 1, as `Motion.block` gives them."""
        G, at = rig.transforms(np.arange(start, stop))
        pose = np.zeros((stop - start, 52, 3))
        for joint, k in enumerate(own):
            if k >= 0:
                parent = own[PARENTS[joint]] if joint else -1
                local = np.swapaxes(G[:, parent], -1, -2) @ G[:, k] if joint else G[:, k]
                pose[:, joint] = axis_angle_from_matrix(local)
        return pose, unit * at[:, own[0]]

    known = pelvis_height is not None
    if pelvis_height is None:
        usual = builtin_skeleton()
        height = usual.pelvis_height * unit * leg_length(rig.rest_positions, place) / leg_length(usual.joints, J)
        pelvis_height = height if height > 0 else None
    return Motion(rig.path.name, rig.frames, rig.rate, tuple(notes), block, pelvis_height, grounded=known)
