"""Small rigged glTF files made from the built-in body, with a mesh or with an animation, to be read back."""

import base64
import json
from pathlib import Path

import numpy as np

from avatar.body import builtin_body
from avatar.rotation import quaternion_from_axis_angle
from avatar.skeleton import JOINTS, PARENTS, joint_transforms, skin_transforms
from avatar.skinning import skin_points


def rig(names=JOINTS, pose=None, turn=None) -> tuple[dict, np.ndarray]:
    """glTF JSON of a few of the free body's triangles, bound in `pose` and standing as `turn` says; its vertices."""
    body = builtin_body("male")
    pose = np.zeros((52, 3)) if pose is None else pose
    turn = np.eye(3) if turn is None else turn
    faces = body.faces[::25]
    used, faces = np.unique(faces, return_inverse=True)
    points = skin_points(body.vertices, body.skin, skin_transforms(pose, body.joints, rest=np.zeros((52, 3))))
    points = (points @ turn.T)[used].astype("<f4")
    frames = np.tile(np.eye(4), (52, 1, 1))  # bones parallel to the world, where the pose left their joints
    frames[:, :3, 3] = joint_transforms(pose, body.joints)[:, :3, 3] @ turn.T
    arrays = [
        (points, 5126, "VEC3"),
        (faces.reshape(-1).astype("<u4"), 5125, "SCALAR"),
        (body.skin.joints[used].astype("<u2"), 5123, "VEC4"),
        (body.skin.weights[used].astype("<f4"), 5126, "VEC4"),
        (np.linalg.inv(frames).swapaxes(1, 2).astype("<f4").reshape(52, 16), 5126, "MAT4"),
    ]
    data, views, accessors = b"", [], []
    for array, component, kind in arrays:
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind})
        data += array.tobytes()
    nodes = []
    for k, name in enumerate(names):
        origin = frames[PARENTS[k], :3, 3] if k else np.zeros(3)
        children = [int(c) for c in np.flatnonzero(k == PARENTS)]
        node = {"name": name, "translation": (frames[k, :3, 3] - origin).tolist()}
        nodes.append(node | ({"children": children} if children else {}))
    nodes.append({"name": "person", "mesh": 0, "skin": 0})
    attributes = {"POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3}
    document = {
        "asset": {"version": "2.0"},
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1}]}],
        "skins": [{"joints": list(range(52)), "inverseBindMatrices": 4}],
        "buffers": [{"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return document, body.vertices[used]


def write(path: Path, document: dict) -> Path:
    path.write_text(json.dumps(document))
    return path


def animated_glb() -> tuple[dict, bytes]:
    """A rig with our names, no mesh, its knees bending; JSON and binary chunk."""
    joints = builtin_body("male").joints
    times = np.arange(8, dtype="<f4") / 30
    values = quaternion_from_axis_angle(np.linspace([0, 0, 0], [1.0, 0, 0], 8)).astype("<f4")
    binary = times.tobytes() + values.tobytes()
    nodes = []
    for k, name in enumerate(JOINTS):
        place = joints[k] - (joints[PARENTS[k]] if k else 0)
        children = [int(c) for c in np.flatnonzero(k == PARENTS)]
        nodes.append({"name": name, "translation": place.tolist()} | ({"children": children} if children else {}))
    document = {
        "asset": {"version": "2.0"},
        "nodes": nodes,
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 32},
            {"buffer": 0, "byteOffset": 32, "byteLength": 128},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "SCALAR"},
            {"bufferView": 1, "componentType": 5126, "count": 8, "type": "VEC4"},
        ],
        "animations": [
            {
                "samplers": [{"input": 0, "output": 1}],
                "channels": [
                    {"sampler": 0, "target": {"node": JOINTS.index(f"{side}_knee"), "path": "rotation"}}
                    for side in ("left", "right")
                ],
            }
        ],
    }
    return document, binary
