"""MediaPipe's landmarks made from poses of our own skeleton."""

import json
import re

import numpy as np
from mhr_twin import SIDES, J, world

from avatar.motion.landmark_pose import FACE, FACE_AT_REST, HAND_STARTS, PAIRS

# from our axes to the picture's: y down, z away
DOWN = np.array([1.0, -1, -1])


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
