"""The Momentum Human Rig (MHR), which SAM 3D Body poses: which of its 127 joints are ours, and how its bones' axes lie.

Facts about the rig, none of its data: the order of the joints is that of `get_joint_names()` of the published model
(github.com/facebookresearch/MHR, Apache-2.0; tools/mhr_smpl_conversion there holds real results). The axes were
measured in two of those results: what is left of a joint's rotation against its parent when the pose parameters
stored beside it are taken off is the same in both to 0.01 degrees for hips, shoulders, elbows, feet, collar bones,
neck and head, 0.3 for knees and spine.

    limbs, fingers      the bone runs along +x on the left, along -x on the right; +z is the hinge (knee, elbow, finger)
    pelvis              x to the left, y up, z forward
    spine               x up, y forward, z to the left, without any curve at rest; neck 19, head 2.2 degrees forward
    right               R_right = -M R_left with M = diag(-1, 1, 1)

A bone is laid along the rig's, hinge on hinge, so an elbow that bends there bends here, about the same axis.
Hands follow the palm that the joints span (wrist, forefinger, middle and little finger), not the wrist's own rotation:
in real results the rotations of one hand may be older than its joints, which are what was fitted to the picture. Then
the fingers' rotations are carried along with the palm. The forearm's turn is shared out evenly between elbow and wrist.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.motion.fingers import FINGERS, MIRROR, finger_axes
from avatar.motion.rest_pose import Alignment, hinge
from avatar.motion.rig import AnimatedRig, PlacedJoints, runs
from avatar.rotation import (
    left_up_frame,
    matrix_from_axis_angle,
    palm_frame,
    quaternion_from_matrix,
    rotation_between,
    unit_or_zero,
)
from avatar.skeleton import JOINT_NUMBERS as J
from avatar.skeleton import JOINTS, PARENTS

MHR_JOINTS = 127
# our joint of the left side -> the joint that turns it, the joint that places it
_LEFT: dict[str, tuple[int, int]] = {
    "hip": (2, 2), "knee": (3, 3), "ankle": (7, 5), "foot": (8, 8),
    "collar": (74, 74), "shoulder": (75, 75), "elbow": (76, 76), "wrist": (78, 78),
    "index1": (92, 92), "index2": (93, 93), "index3": (94, 94),
    "middle1": (88, 88), "middle2": (89, 89), "middle3": (90, 90),
    "pinky1": (80, 80), "pinky2": (81, 81), "pinky3": (82, 82),
    "ring1": (84, 84), "ring2": (85, 85), "ring3": (86, 86),
    "thumb1": (97, 97), "thumb2": (98, 98), "thumb3": (99, 99),
}  # fmt: skip
# legs of the right side come 16 later, arms 36 earlier
LEG, ARM = 16, -36
SPINE = (34, 35, 36, 37)
NECK, HEAD = 110, 113
FINGER_ENDS = {"index": 95, "middle": 91, "pinky": 83, "ring": 87, "thumb": 100}
# bones that lie along x: from joint, to joint (our names, left and right)
BONES = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"),
         *((f"{finger}{n}", f"{finger}{n + 1}") for finger in FINGERS for n in (1, 2, 3)))  # fmt: skip
# axes in the world at rest, left side; columns x, y, z
_COLLAR = np.array([[0.8365, 0.5443, 0.0639], [0.1003, -0.0374, -0.9943], [-0.5387, 0.8381, -0.0859]])
_ANKLE = np.array([[-0.0149, -0.0042, 0.9999], [-0.1725, 0.9850, 0.0016], [-0.9849, -0.1725, -0.0154]])
_TOES = np.array([[-0.2337, 0.0158, 0.9722], [0.0031, 0.9999, -0.0155], [-0.9723, -0.0006, -0.2337]])
_UPRIGHT = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
NECK_TILT, HEAD_TILT = np.radians(19.0), np.radians(2.2)
# the palm's frame as the left wrist sees it where rotations and joints agree
_PALM = np.array([[0.999, 0.045, 0.008], [0.046, -0.991, -0.124], [0.002, 0.124, -0.992]])
# the elbow's part of the forearm's turn
ELBOW_SHARE = 0.5


def _numbers() -> dict[str, tuple[int, int]]:
    """Our joint -> (MHR's joint that turns it, MHR's joint that places it)."""
    out = {"pelvis": (1, 1), "neck": (NECK, NECK), "head": (HEAD, HEAD)}
    out |= {f"spine{n}": (k, k) for n, k in enumerate(SPINE)}
    for side in ("left", "right"):
        for name, (turn, place) in _LEFT.items():
            shift = 0 if side == "left" else LEG if turn < 9 else ARM
            out[f"{side}_{name}"] = (turn + shift, place + shift)
    # parents first
    return dict(sorted(out.items(), key=lambda item: item[1]))


NUMBERS = _numbers()
NAMES = tuple(NUMBERS)


def _parent(name: str) -> str:
    """As our skeleton has it, with one joint more between pelvis and spine."""
    return {"spine0": "pelvis", "spine1": "spine0"}.get(name) or JOINTS[PARENTS[J[name]]]


@dataclass(frozen=True, kw_only=True)
class MhrRig(AnimatedRig):
    """MHR's joints over time, under our names.

    Its "turns away from rest" are the joints' own axes in the world, which `mhr_alignment` knows.
    """

    names: tuple[str, ...] = NAMES
    parents: tuple[int, ...] = tuple(-1 if n == "pelvis" else NAMES.index(_parent(n)) for n in NAMES)
    # (start, stop) -> rotations and places of MHR's joints in our world, metres
    read: Callable[[int, int], PlacedJoints] = field(repr=False)
    joints: Float[Array, "52 3"]  # the skeleton that is to move

    @cached_property
    def alignment(self) -> Alignment:
        """How our bones lie along MHR's."""
        return mhr_alignment(self.joints)

    @property
    def rest_positions(self) -> Float[Array, "joints 3"]:
        """The places of the first frame: only lengths are taken from them."""
        return self.transforms(np.zeros(1, int))[1][0]

    def transforms(self, frames: Int[Array, "frames"]) -> PlacedJoints:
        """Axes of each joint, every limb's and finger's bone laid exactly along the joints' places."""
        R, at = (np.concatenate(parts) for parts in zip(*(self.read(*run) for run in runs(frames)), strict=True))
        G = R[:, [turn for turn, _ in NUMBERS.values()]]
        places = at[:, [place for _, place in NUMBERS.values()]]
        for side in ("left", "right"):
            wrist = NAMES.index(f"{side}_wrist")
            palm = palm_frames(at, side)
            carried = palm @ np.swapaxes(R[:, NUMBERS[f"{side}_wrist"][0]] @ mirrored(_PALM, side), -1, -2)
            G[:, wrist] = palm
            for finger in FINGERS:
                joints = [NAMES.index(f"{side}_{finger}{n}") for n in (1, 2, 3)]
                G[:, joints] = carried[:, None] @ G[:, joints]
            for bone in BONES:
                joint = NAMES.index(f"{side}_{bone[0]}")
                bone_way = at[:, _end(side, bone[1])] - places[:, joint]
                along = unit_or_zero(G[:, joint, :, 0] * sign(side))
                G[:, joint] = rotation_between(along, unit_or_zero(bone_way)) @ G[:, joint]
            self._share_forearm(G, side)
        return G, places

    def _share_forearm(self, G: Float[Array, "frames joints 3 3"], side: str) -> None:
        """Give the elbow its part of the forearm's turn; in place."""
        elbow, wrist = NAMES.index(f"{side}_elbow"), NAMES.index(f"{side}_wrist")
        A = self.alignment.limbs
        relative = np.swapaxes(G[:, elbow] @ A[f"{side}_elbow"], -1, -2) @ G[:, wrist] @ A[f"{side}_wrist"]
        bone = unit_or_zero(self.joints[J[f"{side}_wrist"]] - self.joints[J[f"{side}_elbow"]])
        angle = twist_about(relative, bone)
        along = np.array([sign(side), 0.0, 0.0])
        G[:, elbow] = G[:, elbow] @ matrix_from_axis_angle(ELBOW_SHARE * angle[:, None] * along)


def mhr_alignment(ours: Float[Array, "52 3"]) -> Alignment:
    """The constant turns that lay the bones of a skeleton along MHR's axes (A_k of avatar/motion/retarget.py)."""
    tilts = {f"spine{n}": 0.0 for n in range(4)} | {"neck": NECK_TILT, "head": HEAD_TILT}
    column = {NAMES.index("pelvis"): np.eye(3)}
    for name, tilt in tilts.items():
        column[NAMES.index(name)] = (_UPRIGHT @ matrix_from_axis_angle(np.array([0, 0, tilt]))).T
    A: dict[str, Array] = {}
    curl = finger_axes()[0]
    for side in ("left", "right"):
        for name, end in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")):
            bone = ours[J[f"{side}_{end}"]] - ours[J[f"{side}_{name}"]]
            A[f"{side}_{name}"] = _hinged(bone, hinge(f"{side}_{name}"), side)
        for n, finger in enumerate(FINGERS):
            for k in range(3):
                first = J[f"{side}_{finger}{min(k, 1) + 1}"]
                axis = curl[n, k] * (MIRROR if side == "right" else 1)
                A[f"{side}_{finger}{k + 1}"] = _hinged(ours[first + 1] - ours[first], axis, side)
        A[f"{side}_wrist"] = rest_palm(ours, side).T
        for name, rest in (("collar", _COLLAR), ("ankle", _ANKLE), ("foot", _TOES)):
            A[f"{side}_{name}"] = (rest if side == "left" else np.diag(MIRROR) @ rest).T
    return Alignment(A, column)


def sign(side: str) -> float:
    """Which way a side's bones run along x."""
    return 1.0 if side == "left" else -1.0


def mirrored(left: Float[Array, "3 3"], side: str) -> Float[Array, "3 3"]:
    """The palm as the wrist of one side sees it, from the left's."""
    return left if side == "left" else left @ np.diag([-1.0, 1, -1])


def palm_frames(at: Float[Array, "frames 127 3"], side: str) -> Float[Array, "frames 3 3"]:
    """Frame of the palm: x from the wrist to the middle finger, z towards the forefinger's side."""
    places = {name: at[:, NUMBERS[f"{side}_{name}"][1]] for name in ("wrist", "middle1", "index1", "pinky1")}
    return palm_frame(places["middle1"] - places["wrist"], places["index1"] - places["pinky1"])


def off_bones(
    R: Float[Array, "frames 127 3 3"], at: Float[Array, "frames 127 3"], *, fingers: bool
) -> Float[Array, "frames bones"]:
    """Angles, radians, between the bones' x axes and the ways from joint to joint: of arms and legs, or of fingers."""
    out = []
    for side in ("left", "right"):
        for a, b in BONES:
            if (a[-1] in "123") == fingers:
                turn, place = NUMBERS[f"{side}_{a}"]
                bone = unit_or_zero(at[:, _end(side, b)] - at[:, place])
                cosine = np.sum(unit_or_zero(R[:, turn, :, 0]) * bone, -1) * sign(side)
                out.append(np.arccos(np.clip(cosine, -1, 1)))
    return np.stack(out, -1)


def twist_about(R: Float[Array, "frames 3 3"], axis: Float[Array, "3"]) -> Float[Array, "frames"]:
    """The turn about an axis that is in a rotation (its swing-twist decomposition), within half a turn, radians."""
    q = quaternion_from_matrix(R)
    return 2 * np.arctan2(q[:, :3] @ axis, q[:, 3])


def _end(side: str, name: str) -> int:
    """MHR's joint at the end of a bone; finger "4"s are the tips."""
    if name.endswith("4"):
        return FINGER_ENDS[name[:-1]] + (ARM if side == "right" else 0)
    return NUMBERS[f"{side}_{name}"][1]


def _hinged(bone: Float[Array, "3"], axis: Float[Array, "3"], side: str) -> Float[Array, "3 3"]:
    """The turn that lays our bone along x, and the axis that it is bent about on z."""
    return left_up_frame(np.array([0.0, 0, 1]), np.array([sign(side), 0, 0])) @ left_up_frame(axis, bone).T


def rest_palm(ours: Float[Array, "52 3"], side: str) -> Float[Array, "3 3"]:
    """Frame of our palm at rest, as `palm_frames` has MHR's."""
    wrist, middle, index, pinky = (ours[J[f"{side}_{name}"]] for name in ("wrist", "middle1", "index1", "pinky1"))
    return palm_frame(middle - wrist, index - pinky)
