"""Small .vrm files with spring bones: the built-in body with tubes that hang on it."""

import base64

import numpy as np
import rigs

from avatar.gltf.humanoid import vrm_names
from avatar.skeleton import JOINTS

# joints of a tube, vertices round it
LINKS, ROUND = 5, 8
# of a tube: the joint it hangs on, where it begins off it, and from one link to the next; metres
PONYTAIL = ("head", (0.0, 0.10, -0.11), (0.0, -0.07, -0.03))
TAIL = ("pelvis", (0.0, 0.0, -0.13), (0.0, -0.07, -0.04))
SETTINGS = {"stiffness": 1.0, "gravityPower": 0.0, "gravityDir": [0, -1, 0], "dragForce": 0.4, "hitRadius": 0.02}


def spring_vrm(version=1, tubes=(PONYTAIL,), settings=SETTINGS, *, colliders=(), center=None, every=25, turn=None):
    """The glTF JSON. colliders: (joint, start, end, radius), in the world's axes from the joint; center: a joint."""
    document, _ = rigs.rig([f"bone {k}" for k in range(52)], every=every, turn=turn)
    turn = np.eye(3) if turn is None else turn
    data, nodes = b"", document["nodes"]

    def stored(array, component, kind):
        nonlocal data
        views, accessors = document["bufferViews"], document["accessors"]
        views.append({"buffer": 1, "byteOffset": len(data), "byteLength": array.nbytes})
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind})
        data += array.tobytes()
        return len(accessors) - 1

    document["materials"] = [{"doubleSided": True, "pbrMetallicRoughness": {"baseColorFactor": [0.6, 0.1, 0.05, 1]}},
                             {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.6, 1]}}]  # fmt: skip
    document["meshes"][0]["primitives"][0]["material"] = 1
    chains = []
    for joint, begins, step in tubes:
        begins, step = turn @ np.array(begins), turn @ np.array(step)
        at = _world(nodes, JOINTS.index(joint)) + begins
        # VRM 1.0 ends in a joint that is a tail alone
        count, first, above = LINKS + version, len(nodes), JOINTS.index(joint)
        for link in range(count):
            nodes.append({"name": f"{joint} {link}", "translation": (begins if link == 0 else step).tolist()})
            nodes[above].setdefault("children", []).append(first + link)
            above = first + link
        chains.append(list(range(first, first + count)))
        points, faces, joints, weights = _tube(at, step)
        inverse = np.tile(np.eye(4), (LINKS, 1, 1))
        inverse[:, :3, 3] = -(at + np.arange(LINKS)[:, None] * step)
        attributes = {
            "POSITION": stored(points.astype("<f4"), 5126, "VEC3"),
            "JOINTS_0": stored(joints.astype("<u2"), 5123, "VEC4"),
            "WEIGHTS_0": stored(weights.astype("<f4"), 5126, "VEC4"),
        }
        indices = stored(faces.reshape(-1).astype("<u4"), 5125, "SCALAR")
        matrices = stored(inverse.swapaxes(1, 2).astype("<f4").reshape(-1, 16), 5126, "MAT4")
        primitive = {"attributes": attributes, "indices": indices, "material": 0}
        document["meshes"].append({"primitives": [primitive]})
        document["skins"].append({"joints": chains[-1][:LINKS], "inverseBindMatrices": matrices})
        nodes.append({"mesh": len(document["meshes"]) - 1, "skin": len(document["skins"]) - 1})
    document["buffers"].append(
        {"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}
    )  # fmt: skip
    bones = {name: JOINTS.index(joint) for joint, name in vrm_names(version).items()}
    middle = None if center is None else JOINTS.index(center)
    turned = [(JOINTS.index(joint), turn @ np.array(a), turn @ np.array(b), r) for joint, a, b, r in colliders]
    write = _version_1 if version == 1 else _version_0
    document["extensions"] = write(bones, chains, settings, turned, middle)
    return document


def _world(nodes, joint):
    parents = {child: k for k, node in enumerate(nodes) for child in node.get("children", [])}
    out = np.zeros(3)
    while joint is not None:
        out = out + nodes[joint]["translation"]
        joint = parents.get(joint)
    return out


def _tube(at, step):
    """Rings along a chain; each point is moved by the links before and behind it."""
    rings = 4 * LINKS + 1
    along = np.linspace(0, LINKS, rings)
    angle = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
    direction = step / np.linalg.norm(step)
    side = np.cross(direction, [1.0, 0, 0])
    round_ = np.cos(angle)[:, None] * np.array([1.0, 0, 0]) + np.sin(angle)[:, None] * side
    radius = 0.03 * (1 - 0.6 * along / LINKS)
    points = at + along[:, None, None] * step + radius[:, None, None] * round_
    a, b = np.meshgrid(np.arange(rings - 1), np.arange(ROUND), indexing="ij")
    faces = np.concatenate([
        np.stack([_corner(a, b), _corner(a + 1, b), _corner(a, b + 1)], 1),
        np.stack([_corner(a, b + 1), _corner(a + 1, b), _corner(a + 1, b + 1)], 1),
    ])  # fmt: skip
    link = np.minimum(along.astype(int), LINKS - 1)
    joints, weights = np.zeros((rings, 4)), np.zeros((rings, 4))
    joints[:, 0], weights[:, 0] = link, 1
    return points.reshape(-1, 3), faces, np.repeat(joints, ROUND, 0), np.repeat(weights, ROUND, 0)


def _corner(ring, k):
    return (ring * ROUND + k % ROUND).reshape(-1)


def _version_1(bones, chains, settings, colliders, center):
    springs = [
        {"joints": [{"node": node} | settings for node in chain], "colliderGroups": [0] * bool(colliders)}
        | ({} if center is None else {"center": center})
        for chain in chains
    ]
    shapes = [
        {"node": joint, "shape": {"capsule": {"offset": list(map(float, a)), "tail": list(map(float, b)), "radius": r}}}
        for joint, a, b, r in colliders
    ]
    return {
        "VRMC_vrm": {"humanoid": {"humanBones": {name: {"node": node} for name, node in bones.items()}}},
        "VRMC_springBone": {
            "specVersion": "1.0", "springs": springs, "colliders": shapes,
            "colliderGroups": [{"colliders": list(range(len(shapes)))}] * bool(shapes),
        },
    }  # fmt: skip


def _version_0(bones, chains, settings, colliders, center):
    renamed = {k: v for k, v in settings.items() if k != "stiffness"} | {"stiffiness": settings["stiffness"]}
    renamed["gravityDir"] = dict(zip("xyz", settings["gravityDir"], strict=True))
    spheres = [
        {"node": joint, "colliders": [{"offset": {"x": float(a[0]), "y": float(a[1]), "z": -float(a[2])}, "radius": r}]}
        for joint, a, _, r in colliders
    ]
    groups = [
        {"bones": [chain[0]], "center": -1 if center is None else center, "colliderGroups": list(range(len(spheres)))}
        | renamed
        for chain in chains
    ]
    listed = [{"bone": name, "node": node} for name, node in bones.items()]
    return {"VRM": {"humanoid": {"humanBones": listed},
                    "secondaryAnimation": {"boneGroups": groups, "colliderGroups": spheres}}}  # fmt: skip
