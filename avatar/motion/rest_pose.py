"""How an avatar's rest bones lie along those of a rig that rests as a person stands: T-pose, A-pose, arms down.

A_k (avatar/motion/retarget.py) starts as the turn between the two rest frames (up axis, facing) and is passed down
each limb with the smallest turn that aligns the bone, so twist is carried along.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.motion.fingers import MIRROR
from avatar.motion.rig import FINGER_NAMES, AnimatedRig, JointMap
from avatar.rotation import (
    axis_angle_from_matrix,
    axis_name,
    left_up_frame,
    matrix_from_axis_angle,
    palm_frame,
    rotation_between,
    unit_or_zero,
)
from avatar.skeleton import JOINT_NUMBERS as J

# cosine of a thigh to the way from hips to head, above which no person stands: it points up, or sideways like a split
THIGH_UP = -0.2


@dataclass(frozen=True)
class Alignment:
    """The constant turns A_k between a rig's rest pose and ours."""

    # by name of our limb joints
    limbs: dict[str, Float[Array, "3 3"]]
    # by the rig's own joints, from the pelvis to the head
    column: dict[int, Float[Array, "3 3"]]


class RestBones:
    """Bones at rest by the names of our joints: the rig's and the avatar's."""

    def __init__(self, rig: AnimatedRig, joints: JointMap, ours: Float[Array, "52 3"]):
        self.joints, self.rest, self._ours, self._ends = joints, rig.rest_positions, ours, dict(rig.ends)

    def rig_bone(self, a: str, b: str) -> Float[Array, "3"]:
        """From joint a to joint b at rest, in the rig's axes."""
        return self.rest[self.joints.places[b]] - self.rest[self.joints.places[a]]

    def ours(self, a: str, b: str) -> Float[Array, "3"]:
        """From joint a to joint b of the avatar in pose 0."""
        return self._ours[J[b]] - self._ours[J[a]]

    def toe(self, side: str) -> Float[Array, "3"]:
        """From the ankle to the toes of the rig, or to the end of its foot; 0 where it has neither."""
        ankle, foot, places = f"{side}_ankle", f"{side}_foot", self.joints.places
        if places.get(foot, places[ankle]) != places[ankle]:
            return self.rig_bone(ankle, foot)
        return np.array(self._ends.get(places[ankle], (0.0, 0.0, 0.0)))

    def aligned(self, base: Float[Array, "3 3"], a: str, b: str) -> Float[Array, "3 3"]:
        """`base`, turned by the least that lays our bone from a to b along the rig's."""
        bone = self.rig_bone(a, b)
        if np.linalg.norm(bone) < 1e-9:
            return base
        return rotation_between(unit_or_zero(base @ self.ours(a, b)), unit_or_zero(bone)) @ base


def rests_standing(rig: AnimatedRig, joints: JointMap) -> bool:
    """Whether the rest pose is a person's: thighs that lead away from the head, shoulders over the hips."""
    at = rig.rest_positions[list(joints.places.values())]
    place = dict(zip(joints.places, at, strict=True))
    hips = (place["left_hip"] + place["right_hip"]) / 2
    up, left = place["head"] - hips, place["left_hip"] - place["right_hip"]
    shoulders = place["left_shoulder"] - place["right_shoulder"]
    if min(np.linalg.norm(v) for v in (up, left, shoulders)) == 0:
        return False
    thighs = [place[f"{side}_knee"] - place[f"{side}_hip"] for side in ("left", "right")]
    down = all(cosine(thigh, up) < THIGH_UP for thigh in thighs)
    return down and abs(cosine(left, up)) < 0.5 and cosine(left, shoulders) > 0.7


def rest_alignment(
    rig: AnimatedRig, joints: JointMap, ours: Float[Array, "52 3"], notes: list[str]
) -> tuple[Alignment, Alignment]:
    """Two alignments that differ in the feet: rolled with the leg, and flat on the ground at rest."""
    bones = RestBones(rig, joints, ours)
    rest, places = bones.rest, joints.places
    left = rest[places["left_hip"]] - rest[places["right_hip"]]
    up = rest[places["head"]] - (rest[places["left_hip"]] + rest[places["right_hip"]]) / 2
    root = snapped(left_up_frame(left, up))
    notes.append(f"rest pose: up {axis_name(root[:, 1])}, facing {axis_name(root[:, 2])}")
    A: dict[str, Array] = {}
    flat: dict[str, Array] = {}
    for side in ("left", "right"):
        hip, knee, ankle, foot = (f"{side}_{n}" for n in ("hip", "knee", "ankle", "foot"))
        A[hip] = bones.aligned(root, hip, knee)
        A[knee] = bones.aligned(A[hip], knee, ankle)
        toe = bones.toe(side)
        A[ankle] = A[foot] = A[knee] @ _heading(bones.ours(ankle, foot), A[knee].T @ toe)
        flat[ankle] = flat[foot] = root @ _heading(bones.ours(ankle, foot), root.T @ toe)

        collar, shoulder, elbow = (f"{side}_{n}" for n in ("collar", "shoulder", "elbow"))
        A[collar] = root
        # it rests raised, not sideways
        if collar in places and cosine(root @ bones.ours(collar, shoulder), bones.rig_bone(collar, shoulder)) < 0.5:
            A[collar] = bones.aligned(root, collar, shoulder)
        A[shoulder] = bones.aligned(root, shoulder, elbow)
        A |= below_elbow(bones, side, A[shoulder])
    for name in ("left_hip", "left_shoulder"):
        angle = np.degrees(np.linalg.norm(axis_angle_from_matrix(root.T @ A[name])))
        if angle > 10:
            notes.append(f"rest pose: {name.split('_')[1]} bones rest {angle:.0f} degrees off our T-pose, aligned")
    column = dict.fromkeys((joints.pelvis, *joints.spine, *joints.neck, joints.head), root)
    with_leg = Alignment(A, column)
    return with_leg, replace(with_leg, limbs=A | flat)


def below_elbow(bones: RestBones, side: str, upper_arm: Float[Array, "3 3"]) -> dict[str, Float[Array, "3 3"]]:
    """A of elbow, wrist and fingers, passed down from the upper arm's."""
    places = bones.joints.places
    elbow, wrist = f"{side}_elbow", f"{side}_wrist"
    A = {elbow: bones.aligned(upper_arm, elbow, wrist) if wrist in places else upper_arm}
    A[wrist] = A[elbow]
    names = [f"{side}_{n}" for n in ("middle1", "index1", "pinky1")]
    if all(name in places for name in (wrist, *names)):
        along, across = bones.rig_bone(wrist, names[0]), bones.rig_bone(names[2], names[1])
        # finger joints at one place span no palm
        if np.linalg.norm(np.cross(along, across)) > 1e-9 * np.linalg.norm(along):
            mine = palm_frame(bones.ours(wrist, names[0]), bones.ours(names[2], names[1]))
            A[wrist] = palm_frame(along, across) @ mine.T
    for finger in FINGER_NAMES:
        base = A[wrist]
        for n in (1, 2, 3):
            name, beyond = f"{side}_{finger}{n}", f"{side}_{finger}{n + 1}"
            if name in places and beyond in places:
                base = bones.aligned(base, name, beyond)
            A[name] = base
    return A


# the axis about which a limb of the left side bends, by its upper and by its lower joint
_HINGES = {"hip": (1.0, 0, 0), "knee": (1.0, 0, 0), "shoulder": (0, -1.0, 0), "elbow": (0, -1.0, 0)}


def hinge(joint: str) -> Float[Array, "3"]:
    """The axis about which the limb of one of our joints bends: knees backward, elbows forward."""
    side, name = joint.split("_")
    return np.array(_HINGES[name]) * (MIRROR if side == "right" else 1)


def cosine(a: Float[Array, "3"], b: Float[Array, "3"]) -> float:
    """Of the angle between two directions; 0 where one has no length."""
    length = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / length if length > 0 else 0.0


def snapped(R: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """The rotation onto the axes that lies nearest, up before left."""
    out = np.zeros((3, 3))
    for column in (1, 0):
        free = np.abs(R[:, column]) * (np.abs(out).sum(1) == 0)
        row = int(np.argmax(free))
        out[row, column] = np.sign(R[row, column])
    out[:, 2] = np.cross(out[:, 0], out[:, 1])
    return out


def _heading(ours: Array, foot: Array) -> Float[Array, "3 3"]:
    """Turn about our up axis that gives our foot the rig's heading; both in our rest frame."""
    if np.hypot(foot[0], foot[2]) < 1e-9:
        return np.eye(3)
    angle = np.arctan2(foot[0], foot[2]) - np.arctan2(ours[0], ours[2])
    return matrix_from_axis_angle(np.array([0, angle, 0]))
