"""Results of SAM 3D Body and landmarks of MediaPipe, made from poses of our own skeleton, and how far poses are."""

import json
import re

import numpy as np
import pytest

from avatar.body import builtin_body
from avatar.limits import axis_angle_from_joint_angles, clamped_angles, limits
from avatar.motion.landmark_pose import FACE, FACE_AT_REST, HAND_STARTS, PAIRS
from avatar.motion.mhr_rig import (
    _PALM,
    ARM,
    FINGER_ENDS,
    NUMBERS,
    mhr_alignment,
    mirrored,
    palm_frames,
    sign,
    twist_about,
)
from avatar.motion.sam3d_body import FLIP
from avatar.rotation import matrix_from_axis_angle, quaternion_from_axis_angle, quaternion_inverse, quaternion_product
from avatar.skeleton import JOINT_NUMBERS as J
from avatar.skeleton import JOINTS, PARENTS, joint_transforms

SIDES = ("left", "right")
LIMBS = [(f"{s}_{a}", f"{s}_{b}") for s in SIDES for a, b in (
    ("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))]  # fmt: skip
FINGERS = [(JOINTS[PARENTS[k]], JOINTS[k]) for k in range(22, 52) if JOINTS[k][-1] in "23"]
# from our axes to the picture's: y down, z away
DOWN = np.array([1.0, -1, -1])
WITHOUT_CURVE = [J[name] for name in ("spine1", "spine2", "spine3")]


def natural_poses(frames, seed=0, share=0.7):
    """Poses within the limits, the pelvis turned about its height by anything."""
    rng = np.random.default_rng(seed)
    table = limits()
    angles = clamped_angles(share * rng.uniform(table.low, table.high, (frames, 52, 3)))
    angles[:, 0] = np.stack([rng.normal(0, 0.2, frames), rng.normal(0, 0.2, frames), rng.uniform(-3, 3, frames)], -1)
    # hinges bend, and do not move sideways
    for name in ("left_knee", "right_knee", "left_elbow", "right_elbow"):
        angles[:, J[name], 1:] = 0
    return axis_angle_from_joint_angles(angles)


def world(axis_angle, joints, root):
    transforms = joint_transforms(axis_angle, joints, root)
    return transforms[:, :, :3, :3], transforms[:, :, :3, 3]


def placed(motion, joints):
    """Rotations and places of the joints of a motion's frames, in the world."""
    clip = motion.read()
    return world(clip.axis_angle, joints, clip.root)


def directions(places, pairs):
    """Unit vectors from the first to the second joint of each pair."""
    bones = np.stack([places[:, J[b]] - places[:, J[a]] for a, b in pairs], 1)
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def degrees_between(a, b):
    """Degrees between unit vectors, exact for small angles as well."""
    return np.degrees(2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)))


def sam3d_fields(axis_angle, root, skeleton=None, camera=(0.3, 0.9, 5.0)):
    """pred_joint_coords, pred_global_rots and pred_cam_t of a body that stands so; its spine is not curved."""
    joints = builtin_body("male").joints if skeleton is None else skeleton
    pose = np.array(axis_angle)
    pose[:, WITHOUT_CURVE] = 0
    G, at = world(pose, joints, root)
    A = mhr_alignment(joints)
    p, R = np.zeros((len(pose), 127, 3)), np.tile(np.eye(3), (len(pose), 127, 1, 1))

    def ours(name: str) -> int:
        return J["spine1" if name == "spine0" else name]

    for k, (name, (turn, place)) in enumerate(NUMBERS.items()):
        back = A.limbs[name].T if name in A.limbs else A.column[k].T
        R[:, turn], p[:, place] = G[:, ours(name)] @ back, at[:, ours(name)]
    for side in ("left", "right"):
        # MHR's forearm has no turn of its own: the wrist's has all of it
        elbow, wrist = J[f"{side}_elbow"], J[f"{side}_wrist"]
        bone = joints[wrist] - joints[elbow]
        upper = np.swapaxes(G[:, J[f"{side}_shoulder"]], -1, -2) @ G[:, elbow]
        turn = twist_about(upper, bone / np.linalg.norm(bone))
        back = matrix_from_axis_angle(-turn[:, None] * np.array([sign(side), 0, 0]))
        R[:, NUMBERS[f"{side}_elbow"][0]] = R[:, NUMBERS[f"{side}_elbow"][0]] @ back
        for finger, tip in FINGER_ENDS.items():
            last, before = J[f"{side}_{finger}3"], J[f"{side}_{finger}2"]
            end = at[:, last] + (G[:, last] @ (joints[last] - joints[before]))
            p[:, tip + (ARM if side == "right" else 0)] = end
        R[:, NUMBERS[f"{side}_wrist"][0]] = palm_frames(p, side) @ mirrored(_PALM, side).T
    camera = np.asarray(camera)
    return {
        "pred_joint_coords": (p * FLIP - camera).astype("<f4"),
        "pred_global_rots": R.astype("<f4"),
        "pred_cam_t": np.tile(camera, (len(p), 1)).astype("<f4"),
    }


def landmarks(axis_angle, joints, root):
    """Body (frames 33 3) and both hands (frames 21 3) in the camera's axes, metres, with the joints' world places."""
    G, at = world(axis_angle, joints, root)
    body = np.zeros((len(at), 33, 3))
    head = G[:, J["head"]]
    body[:, FACE] = at[:, J["head"], None] + (FACE_AT_REST + [0, 0.05, 0.1]) @ np.swapaxes(head, -1, -2)
    for spare, near in ((1, 2), (3, 2), (4, 5), (6, 5)):
        body[:, spare] = body[:, near]
    hands = {}
    for n, side in enumerate(SIDES):
        for name in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"):
            body[:, PAIRS[name][n]] = at[:, J[f"{side}_{name}"]]
        foot = G[:, J[f"{side}_ankle"]]
        for name, offset in (("heel", (0, -0.06, -0.05)), ("toe", (0, -0.06, 0.18))):
            body[:, PAIRS[name][n]] = at[:, J[f"{side}_ankle"]] + foot @ np.array(offset)
        hand = np.zeros((len(at), 21, 3))
        hand[:, 0] = at[:, J[f"{side}_wrist"]]
        for finger, start in HAND_STARTS.items():
            names = [J[f"{side}_{finger}{k}"] for k in (1, 2, 3)]
            hand[:, start : start + 3] = at[:, names]
            hand[:, start + 3] = at[:, names[2]] + G[:, names[2]] @ (joints[names[2]] - joints[names[1]])
        hands[side] = hand * DOWN
        # pose's own points of the hand
        for point, start in ((17, 17), (19, 5), (21, 2)):
            body[:, point + n] = hand[:, start]
    return body * DOWN, hands["left"], hands["right"], at


def points(array, visibility=None):
    """Landmarks as Python prints them."""
    return [
        {"x": float(x), "y": float(y), "z": float(z)} | ({} if visibility is None else {"visibility": visibility})
        for x, y, z in array
    ]


def estimated(data, name):
    """A stored result of an estimator; the test is skipped where the sample data has none."""
    path = data / "estimators" / name
    if not path.is_file():
        pytest.skip(f"no {path}")
    return path


def from_text(source, path):
    """A stored result of MediaPipe in protobuf's text format as the JSON of its Python API, one frame."""
    text = source.read_text()
    names = {"landmarks": "hand_landmarks", "world_landmarks": "hand_world_landmarks"}
    frame = {}
    for name, body in re.findall(r"^(\w+) \{\n(.*?)^\}", text, re.MULTILINE | re.DOTALL):
        rows = [dict(re.findall(r"(\w+): (\S+)", row)) for row in re.findall(r"landmark \{(.*?)\}", body, re.DOTALL)]
        if rows and "x" in rows[0]:
            # protobuf leaves a 0 out
            filled = [{"z": 0.0} | {key: float(value) for key, value in row.items()} for row in rows]
            frame[names.get(name, name)] = filled
        elif name == "classifications":
            label = re.search(r'label: "(\w+)"', body)[1]
            frame["handedness"] = [[{"category_name": label}]]
    path.write_text(json.dumps({"frames": [frame]}))
    return path


def angles_between(a, b):
    """Radians between rotations given as axis-angle, 0 to pi; exact for small and for large ones."""
    relative = quaternion_product(quaternion_inverse(quaternion_from_axis_angle(a)), quaternion_from_axis_angle(b))
    return 2 * np.arctan2(np.linalg.norm(relative[..., :3], axis=-1), np.abs(relative[..., 3]))
