"""What a .vrm says of the nodes and morph targets of its file, in VRM 1.0 (VRMC_vrm) and in VRM 0.x (VRM).

Bones, 18 preset expressions (avatar/face_names.py) and ARKit's 52 shapes by their own names, and a gaze that turns the
joints of the eyes. VRM 0.x has no preset of surprise and calls the other presets otherwise; programs that read it look
for ARKit's names with a capital. Lids follow a gaze by the expressions lookUp and lookDown only: the gaze of bones has
none.

It is someone's likeness: the metadata say who may use it, and answer what else VRM asks in the narrowest way.
github.com/vrm-c/vrm-specification, specification/VRMC_vrm-1.0 and specification/0.0.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.face import SHAPES
from avatar.face_names import EARLIER, NUMBER, PRESETS, shapes_of
from avatar.gaze import DOWN, UP, YAW
from avatar.gltf.document import Gltf
from avatar.gltf.face import EYE_JOINTS, eye_offsets
from avatar.gltf.humanoid import vrm_names
from avatar.gltf.scene import read_skin
from avatar.skeleton import JOINTS
from files.input_file import JsonObject

# the extension of each version
EXTENSIONS = ("VRM", "VRMC_vrm")
LICENSE = "https://vrm.dev/licenses/1.0/"
# VRM's words for who may appear as this person, the narrowest first, and those of 0.x
PERMISSIONS = ("onlyAuthor", "onlySeparatelyLicensedPerson", "everyone")
EARLIER_PERMISSIONS = ("OnlyAuthor", "ExplicitlyLicensedPerson", "Everyone")
# no word of VRM allows more than these
NARROW: JsonObject = {
    "allowExcessivelyViolentUsage": False, "allowExcessivelySexualUsage": False, "commercialUsage": "personalNonProfit",
    "allowPoliticalOrReligiousUsage": False, "allowAntisocialOrHateUsage": False, "creditNotation": "required",
    "allowRedistribution": False, "modification": "prohibited",
}  # fmt: skip
# 0.x says less; its names are spelled so
EARLIER_NARROW: JsonObject = {
    "violentUssageName": "Disallow", "sexualUssageName": "Disallow", "commercialUssageName": "Disallow",
    "licenseName": "Redistribution_Prohibited",
}  # fmt: skip
# two keys of time, value and tangents
LINEAR = [0, 0, 0, 1, 1, 1, 1, 0]
# where 0.x puts a headset unless a file says otherwise, from the head's joint, metres
FOREHEAD = (0.0, 0.06, 0.0)


class Likeness(NamedTuple):
    """Whose likeness it is, and who may use it."""

    name: str
    author: str
    permission: str = PERMISSIONS[0]


def vrm_extension(gltf: Gltf, avatar: Avatar, likeness: Likeness) -> JsonObject:
    """VRMC_vrm of the file's nodes and morph targets, which stay as they are."""
    extension: JsonObject = {
        "specVersion": "1.0",
        "meta": {
            "name": likeness.name, "version": "1", "authors": [likeness.author], "licenseUrl": LICENSE,
            "avatarPermission": likeness.permission, **NARROW,
        },
        "humanoid": {"humanBones": {bone: {"node": node} for bone, node in _bones(gltf, avatar, 1).items()}},
    }  # fmt: skip
    if avatar.eyes is None:
        return extension
    body = next(k for k, node in enumerate(gltf.items("nodes")) if node.get("mesh") == 0)
    extension["lookAt"] = {
        "type": "bone",
        "offsetFromHeadBone": eye_offsets(avatar).mean(0).tolist(),
        **_reach("rangeMap", lambda degrees: {"inputMaxValue": degrees, "outputScale": degrees}),
    }
    extension["expressions"] = {
        "preset": {name: _expression(body, shapes_of(recipe)) for name, recipe in PRESETS.items()},
        "custom": {name: _expression(body, {NUMBER[name]: 1.0}) for name in SHAPES},
    }
    return extension


def earlier_extension(gltf: Gltf, avatar: Avatar, likeness: Likeness) -> JsonObject:
    """VRM (0.x) of the file's nodes and of its one mesh and material.

    What is a place is in Unity's frame: x to the person's right, z forwards.
    """
    bones = _bones(gltf, avatar, 0)
    x, y, z = FOREHEAD if avatar.eyes is None else eye_offsets(avatar).mean(0).tolist()
    recipes = {} if avatar.eyes is None else PRESETS | {name: {name: 1.0} for name in SHAPES}
    return {
        "exporterVersion": "selfscan",
        "specVersion": "0.0",
        "meta": {
            "title": likeness.name, "version": "1", "author": likeness.author, "contactInformation": "",
            "reference": "", "allowedUserName": EARLIER_PERMISSIONS[PERMISSIONS.index(likeness.permission)],
            **EARLIER_NARROW, "otherPermissionUrl": "", "otherLicenseUrl": "",
        },
        "humanoid": {"humanBones": [{"bone": b, "node": node, "useDefaultValues": True} for b, node in bones.items()]},
        "firstPerson": {
            "firstPersonBone": bones["head"], "firstPersonBoneOffset": {"x": -x, "y": y, "z": z},
            "meshAnnotations": [{"mesh": 0, "firstPersonFlag": "Auto"}], "lookAtTypeName": "Bone",
            **_reach("lookAt", lambda degrees: {"curve": LINEAR, "xRange": degrees, "yRange": degrees}),
        },
        "blendShapeMaster": {"blendShapeGroups": [_group(name, shapes_of(recipe)) for name, recipe in recipes.items()]},
        "secondaryAnimation": {"boneGroups": [], "colliderGroups": []},
        # drawn as glTF says: unlit
        "materialProperties": [{
            "name": gltf.items("materials")[0].get("name", ""), "shader": "VRM_USE_GLTFSHADER", "renderQueue": 2000,
            "floatProperties": {}, "vectorProperties": {}, "textureProperties": {}, "keywordMap": {}, "tagMap": {},
        }],
    }  # fmt: skip


def _bones(gltf: Gltf, avatar: Avatar, version: int) -> dict[str, int]:
    """The node of each of VRM's bones."""
    names, nodes = vrm_names(version), {node.get("name"): k for k, node in enumerate(gltf.items("nodes"))}
    bones = {names[joint]: node for joint, node in zip(JOINTS, read_skin(gltf, 0).nodes[:52], strict=True)}
    eyes = () if avatar.eyes is None else zip(("leftEye", "rightEye"), EYE_JOINTS, strict=True)
    return bones | {bone: nodes[joint] for bone, joint in eyes}


def _reach(prefix: str, degree_map: Callable[[float], JsonObject]) -> dict[str, JsonObject]:
    """Eyes follow to their reach, degrees, each way."""
    reach = {"HorizontalInner": YAW, "HorizontalOuter": YAW, "VerticalDown": DOWN, "VerticalUp": UP}
    return {prefix + way: degree_map(round(float(np.degrees(most)), 3)) for way, most in reach.items()}


def _expression(node: int, shapes: Mapping[int, float]) -> JsonObject:
    if not shapes:
        return {"isBinary": False}
    binds = [{"node": node, "index": number, "weight": weight} for number, weight in sorted(shapes.items())]
    return {"isBinary": False, "morphTargetBinds": binds}


def _group(name: str, shapes: Mapping[int, float]) -> JsonObject:
    """An expression of 0.x, from its name in 1.0; its weights are percent."""
    earlier = {now: before for before, now in EARLIER.items()}.get(name, name[0].upper() + name[1:])
    binds = [{"mesh": 0, "index": number, "weight": 100 * weight} for number, weight in sorted(shapes.items())]
    preset = earlier.lower() if name in PRESETS and name != "surprised" else "unknown"
    return {"name": earlier, "presetName": preset, "binds": binds, "materialValues": [], "isBinary": False}
