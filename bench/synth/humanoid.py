"""Which node of a rigged glTF is which of the 52 joints: Mixamo, VRM and SMPL+H names.

A name belongs to a rig, not to a skeleton: the joints are found by name alone, never by shape, so that a rig
that is not a humanoid is refused instead of being guessed at.
"""

import re
from pathlib import Path

from avatar.errors import AssetError
from avatar.skeleton import JOINTS

FINGERS = ("index", "middle", "pinky", "ring", "thumb")

_MIXAMO_BODY = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head",
}  # fmt: skip
_MIXAMO_SIDE = {
    "hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "ToeBase",
    "collar": "Shoulder", "shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand",
}  # fmt: skip
_VRM_BODY = {
    "pelvis": "hips", "spine1": "spine", "spine2": "chest", "spine3": "upperChest", "neck": "neck", "head": "head",
}  # fmt: skip
_VRM_SIDE = {
    "hip": "UpperLeg", "knee": "LowerLeg", "ankle": "Foot", "foot": "Toes",
    "collar": "Shoulder", "shoulder": "UpperArm", "elbow": "LowerArm", "wrist": "Hand",
}  # fmt: skip
_VRM_FINGER = {"index": "Index", "middle": "Middle", "pinky": "Little", "ring": "Ring", "thumb": "Thumb"}


def _mixamo_names() -> dict[str, str]:
    names = dict(_MIXAMO_BODY)
    for side in ("left", "right"):
        names |= {f"{side}_{joint}": side.title() + name for joint, name in _MIXAMO_SIDE.items()}
        names |= {
            f"{side}_{finger}{i}": f"{side.title()}Hand{finger.title()}{i}"
            for finger in FINGERS
            for i in (1, 2, 3)
        }
    return names


def _vrm_names(version: int) -> dict[str, str]:
    names = dict(_VRM_BODY)
    # VRM 1 renamed the thumb's bones; the other fingers kept theirs
    thumb = ("Metacarpal", "Proximal", "Distal") if version == 1 else ("Proximal", "Intermediate", "Distal")
    for side in ("left", "right"):
        names |= {f"{side}_{joint}": side + name for joint, name in _VRM_SIDE.items()}
        for finger in FINGERS:
            bones = thumb if finger == "thumb" else ("Proximal", "Intermediate", "Distal")
            for i, bone in enumerate(bones, 1):
                names[f"{side}_{finger}{i}"] = side + _VRM_FINGER[finger] + bone
    return names


def find_joints(path: Path, gltf: dict) -> tuple[list[int], str]:
    """The node index of each of JOINTS, and the naming found ("VRM 1.0", "Mixamo", "SMPL+H").

    Raises:
        AssetError: no naming fits, or one fits and lacks joints; the message lists them.
    """
    nodes = gltf.get("nodes", [])
    candidates: list[
        tuple[str, dict[str, str], dict[str, int]]
    ] = []  # naming, name of a joint, node of a name

    extensions = gltf.get("extensions", {})
    if "VRMC_vrm" in extensions:
        bones = extensions["VRMC_vrm"].get("humanoid", {}).get("humanBones", {})
        candidates.append(("VRM 1.0", _vrm_names(1), {bone: value["node"] for bone, value in bones.items()}))
    elif "VRM" in extensions:
        bones = extensions["VRM"].get("humanoid", {}).get("humanBones", [])
        candidates.append(("VRM 0.x", _vrm_names(0), {value["bone"]: value["node"] for value in bones}))
    else:
        # 'mixamorig:Hips', 'mixamorig1:Hips' and the underscore that some exporters put for the colon
        plain = {}
        for i, node in enumerate(nodes):
            if "mesh" not in node:
                plain.setdefault(re.sub(r"^mixamorig\d*[:_]?", "", node.get("name", "")), i)
        candidates.append(("Mixamo", _mixamo_names(), plain))
        candidates.append(("SMPL+H", {joint: joint for joint in JOINTS}, plain))

    naming, names, node_of = max(candidates, key=lambda c: sum(name in c[2] for name in c[1].values()))
    missing = [f"{joint} ({names[joint]})" for joint in JOINTS if names[joint] not in node_of]
    if len(missing) > len(JOINTS) // 2:
        raise AssetError(
            f"{path}: nodes: expected a humanoid rig with Mixamo, VRM or SMPL+H joint names, "
            f"found {len(JOINTS) - len(missing)} of {len(JOINTS)} joints"
        )
    if missing:
        raise AssetError(
            f"{path}: nodes: expected all {len(JOINTS)} joints of a {naming} rig with five fingers a hand, "
            f"missing {', '.join(missing)}"
        )
    found = [node_of[names[joint]] for joint in JOINTS]
    for joint, node in zip(JOINTS, found, strict=True):
        if not (isinstance(node, int) and 0 <= node < len(nodes)):
            raise AssetError(
                f"{path}: humanoid: expected a node index below {len(nodes)} for {joint}, found {node}"
            )
    if len(set(found)) != len(found):
        raise AssetError(f"{path}: humanoid: expected {len(JOINTS)} different nodes, found {len(set(found))}")
    return found, naming
