"""Which node of a rigged glTF is which of the 52 joints: Mixamo, VRM, VRM animation and SMPL+H names.

A name belongs to a rig, not to a skeleton: the joints are found by name alone, never by shape, so that a rig
that is not a humanoid is refused instead of being guessed at.
"""

import re
from pathlib import Path
from typing import NamedTuple

from avatar.skeleton import FINGERS, JOINTS
from command.errors import AssetError
from files.input_file import Json, JsonObject

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


class Naming(NamedTuple):
    """One way of naming a humanoid's joints, tried on a file."""

    # "VRM 1.0", "VRM 0.x", "VRM animation", "Mixamo", "SMPL+H"
    name: str
    # what it calls each of JOINTS
    names: dict[str, str]
    # the node of each of JOINTS that was found
    nodes: dict[str, int]


def mixamo_names() -> dict[str, str]:
    """Mixamo's name of each joint, without its prefix."""
    names = dict(_MIXAMO_BODY)
    for side in ("left", "right"):
        names |= {f"{side}_{joint}": side.title() + name for joint, name in _MIXAMO_SIDE.items()}
        fingers = [f"{finger}{n}" for finger in FINGERS for n in (1, 2, 3)]
        names |= {f"{side}_{finger}": f"{side.title()}Hand{finger.title()}" for finger in fingers}
    return names


def vrm_names(version: int) -> dict[str, str]:
    """VRM's name of each joint, version 0 or 1."""
    names = dict(_VRM_BODY)
    # VRM 1 renamed the thumb's bones; the other fingers kept their names
    thumb = ("Metacarpal", "Proximal", "Distal") if version == 1 else ("Proximal", "Intermediate", "Distal")
    for side in ("left", "right"):
        names |= {f"{side}_{joint}": side + name for joint, name in _VRM_SIDE.items()}
        for finger in FINGERS:
            bones = thumb if finger == "thumb" else ("Proximal", "Intermediate", "Distal")
            for i, bone in enumerate(bones, 1):
                names[f"{side}_{finger}{i}"] = side + _VRM_FINGER[finger] + bone
    return names


def find_naming(path: Path, document: JsonObject) -> Naming:
    """The naming that fits most joints of the file, and the nodes it finds; perhaps not all, perhaps none.

    Raises:
        AssetError: a humanoid extension is not what it should be.
    """
    nodes, extensions = document.get("nodes", []), document.get("extensions", {})
    humanoids = (("VRMC_vrm", "VRM 1.0", 1), ("VRMC_vrm_animation", "VRM animation", 1), ("VRM", "VRM 0.x", 0))
    for extension, name, version in humanoids:
        if isinstance(extensions, dict) and extension in extensions:
            named = _humanoid_bones(path, extensions[extension], extension, len(nodes))
            return _fitted(name, vrm_names(version), named)
    # 'mixamorig:Hips', 'mixamorig1:Hips' and the underscore that some exporters put for the colon
    plain: dict[str, int] = {}
    for i, node in enumerate(nodes):
        if "mesh" not in node:
            plain.setdefault(re.sub(r"^mixamorig\d*[:_]?", "", str(node.get("name", ""))), i)
    tried = [_fitted("Mixamo", mixamo_names(), plain), _fitted("SMPL+H", {joint: joint for joint in JOINTS}, plain)]
    return max(tried, key=lambda naming: len(naming.nodes))


def _fitted(name: str, names: dict[str, str], node_of: dict[str, int]) -> Naming:
    return Naming(name, names, {joint: node_of[n] for joint, n in names.items() if n in node_of})


def _humanoid_bones(path: Path, extension: Json, name: str, count: int) -> dict[str, int]:
    """VRM's own list of bones: an object by bone (VRM 1) or a list (VRM 0)."""
    humanoid = extension.get("humanoid", {}) if isinstance(extension, dict) else None
    bones = humanoid.get("humanBones", {}) if isinstance(humanoid, dict) else None
    if isinstance(bones, dict):
        pairs = [(bone, value.get("node") if isinstance(value, dict) else None) for bone, value in bones.items()]
    elif isinstance(bones, list):
        pairs = [(b.get("bone"), b.get("node")) if isinstance(b, dict) else (None, None) for b in bones]
    else:
        raise AssetError(f"{path}: {name}.humanoid.humanBones should be the bones' nodes, is not")
    found: dict[str, int] = {}
    for bone, node in pairs:
        if node == -1:
            # some VRM 0 exporters list absent bones so
            continue
        if not isinstance(bone, str) or type(node) is not int or not 0 <= node < count:
            raise AssetError(
                f"{path}: humanoid: expected a node index below {count} for {str(bone)[:40]}, found {str(node)[:40]}"
            )
        found[bone] = node
    return found


def find_joints(path: Path, gltf: dict) -> tuple[list[int], str]:
    """The node index of each of JOINTS, and the naming found ("VRM 1.0", "Mixamo", "SMPL+H").

    Raises:
        AssetError: no naming fits, or one fits and lacks joints; the message lists them.
    """
    naming = find_naming(path, gltf)
    missing = [f"{joint} ({naming.names[joint]})" for joint in JOINTS if joint not in naming.nodes]
    if len(missing) > len(JOINTS) // 2:
        raise AssetError(
            f"{path}: nodes: expected a humanoid rig with Mixamo, VRM or SMPL+H joint names, "
            f"found {len(JOINTS) - len(missing)} of {len(JOINTS)} joints"
        )
    if missing:
        raise AssetError(
            f"{path}: nodes: expected all {len(JOINTS)} joints of a {naming.name} rig with five fingers a hand, "
            f"missing {', '.join(missing)}"
        )
    found = [naming.nodes[joint] for joint in JOINTS]
    if len(set(found)) != len(found):
        raise AssetError(f"{path}: humanoid: expected {len(JOINTS)} different nodes, found {len(set(found))}")
    return found, naming.name
