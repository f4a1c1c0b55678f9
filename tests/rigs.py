"""Small rigged glTF files made from the built-in body, with a mesh or with an animation, to be read back."""

import base64
import json
from pathlib import Path

import numpy as np

from avatar.body import builtin_body
from avatar.gltf.write import GltfBuilder
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
    built = GltfBuilder()
    for array in (
        points, faces.reshape(-1).astype("<u4"), body.skin.joints[used].astype("<u2"),
        body.skin.weights[used].astype("<f4"), np.linalg.inv(frames).astype("<f4"),
    ):  # fmt: skip
        built.add_accessor(array)
    attributes = {"POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3}
    document = {
        "asset": {"version": "2.0"},
        "nodes": [*_joint_nodes(names, frames[:, :3, 3]), {"name": "person", "mesh": 0, "skin": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1}]}],
        "skins": [{"joints": list(range(52)), "inverseBindMatrices": 4}],
        "buffers": [buffer_of(built)],
        "bufferViews": built.views,
        "accessors": built.accessors,
    }
    return document, body.vertices[used]


def _joint_nodes(names, places: np.ndarray) -> list[dict]:
    """Nodes of joints that stand at these places, their bones parallel to the world."""
    nodes = []
    for k, name in enumerate(names):
        children = [int(c) for c in np.flatnonzero(k == PARENTS)]
        node = {"name": name, "translation": (places[k] - (places[PARENTS[k]] if k else 0)).tolist()}
        nodes.append(node | ({"children": children} if children else {}))
    return nodes


def buffer_of(built: GltfBuilder) -> dict:
    """What was added, as a buffer of a .gltf."""
    return {"byteLength": len(built.binary), "uri": "data:;base64," + base64.b64encode(built.binary).decode()}


def write(path: Path, document: dict) -> Path:
    path.write_text(json.dumps(document))
    return path


def rigged_glb() -> tuple[dict, bytes]:
    """`rig` as JSON and binary chunk."""
    document, _ = rig()
    return document, base64.b64decode(document["buffers"][0].pop("uri").split(",")[1])


def animated_glb() -> tuple[dict, bytes]:
    """A rig with our names, no mesh, its knees bending; JSON and binary chunk."""
    built = GltfBuilder()
    built.add_accessor(np.arange(8, dtype="<f4") / 30)
    built.add_accessor(quaternion_from_axis_angle(np.linspace([0, 0, 0], [1.0, 0, 0], 8)).astype("<f4"))
    targets = [{"node": JOINTS.index(f"{side}_knee"), "path": "rotation"} for side in ("left", "right")]
    channels = [{"sampler": 0, "target": target} for target in targets]
    document = {
        "asset": {"version": "2.0"},
        "nodes": _joint_nodes(JOINTS, builtin_body("male").joints),
        "buffers": [{"byteLength": len(built.binary)}],
        "bufferViews": built.views,
        "accessors": built.accessors,
        "animations": [{"samplers": [{"input": 0, "output": 1}], "channels": channels}],
    }
    return document, bytes(built.binary)
