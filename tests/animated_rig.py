"""A rig with our names, no mesh, its knees bending, as glTF."""

import numpy as np

from avatar.body import builtin_body
from avatar.rotation import quaternion_from_axis_angle
from avatar.skeleton import JOINTS, PARENTS


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
