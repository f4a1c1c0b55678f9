"""A VRM 1.0 of an avatar file: the person as a humanoid that programs for virtual presence take.

The finest mesh alone, unlit, with its 52 joints as VRM's bones and the feet on the ground. Where the file has a face:
VRM's 18 preset expressions (avatar/face_names.py) and ARKit's 52 shapes by their own names, bound to the mesh's morph
targets, and a gaze that turns the joints of the eyes. Lids follow a gaze by the expressions lookUp and lookDown only:
VRM's lookAt of bones has none. What is ours alone (view dependence, levels of detail) stays behind.

It is someone's likeness: the metadata say who may use it, and answer what else VRM asks in the narrowest way.
github.com/vrm-c/vrm-specification, specification/VRMC_vrm-1.0.
"""

import copy
from pathlib import Path
from typing import NamedTuple

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.face import SHAPES
from avatar.face_names import NUMBER, PRESETS, shapes_of
from avatar.gaze import DOWN, UP, YAW
from avatar.gltf.avatar_file import avatar_gltf, read_avatar
from avatar.gltf.document import Gltf
from avatar.gltf.face import EYE_JOINTS, eye_offsets
from avatar.gltf.humanoid import vrm_names
from avatar.gltf.scene import primitives, read_skin
from avatar.gltf.write import GltfBuilder
from avatar.skeleton import JOINTS
from files.input_file import JsonObject
from files.whole import whole_file

EXTENSION = "VRMC_vrm"
LICENSE = "https://vrm.dev/licenses/1.0/"
# VRM's words for who may appear as this person, the narrowest first
PERMISSIONS = ("onlyAuthor", "onlySeparatelyLicensedPerson", "everyone")
# no word of VRM allows more than these
NARROW: JsonObject = {
    "allowExcessivelyViolentUsage": False, "allowExcessivelySexualUsage": False, "commercialUsage": "personalNonProfit",
    "allowPoliticalOrReligiousUsage": False, "allowAntisocialOrHateUsage": False, "creditNotation": "required",
    "allowRedistribution": False, "modification": "prohibited",
}  # fmt: skip


class Likeness(NamedTuple):
    """Whose likeness it is, and who may use it."""

    name: str
    author: str
    permission: str = PERMISSIONS[0]


def write_vrm(path: Path | str, avatar_path: Path | str, likeness: Likeness, pelvis_height: float) -> None:
    """Write a .vrm of the avatar file, whole or not at all; the pelvis stands at this height, metres.

    Raises:
        AssetError: `avatar_path` is not an avatar file.
    """
    avatar, gltf, builder = read_avatar(avatar_path, levels=1), avatar_gltf(avatar_path), GltfBuilder()
    source = primitives(gltf, 0)[0]
    attributes = {name: number for name, number in source["attributes"].items() if not name.startswith("_")}
    primitive: JsonObject = {
        "attributes": {name: _copied(gltf, builder, number) for name, number in attributes.items()},
        "indices": _copied(gltf, builder, source["indices"]),
        "material": 0,
    }
    mesh: JsonObject = {**gltf.items("meshes")[0], "primitives": [primitive]}
    if avatar.eyes is not None:
        targets = source["targets"]
        primitive["targets"] = [{"POSITION": _copied(gltf, builder, target["POSITION"])} for target in targets]
    nodes, skin = copy.deepcopy(gltf.items("nodes")), {**gltf.items("skins")[0]}
    nodes[0]["translation"][1] += pelvis_height
    skin["inverseBindMatrices"] = _copied(gltf, builder, skin["inverseBindMatrices"])
    material = {**gltf.items("materials")[source["material"]]}
    texture = gltf.items("textures")[material["pbrMetallicRoughness"]["baseColorTexture"]["index"]]
    image = gltf.items("images")[texture["source"]]
    material["pbrMetallicRoughness"] = {**material["pbrMetallicRoughness"], "baseColorTexture": {"index": 0}}
    builder.add_image(_view(gltf, image["bufferView"]), image.get("name", ""))
    data = builder.to_bytes(
        {
            "asset": {"version": "2.0", "generator": "selfscan"},
            "extensionsUsed": ["KHR_materials_unlit", EXTENSION],
            "extensions": {EXTENSION: _extension(gltf, avatar, likeness)},
            "scene": 0,
            "scenes": gltf.items("scenes")[:1],
            "nodes": nodes,
            "skins": [skin],
            "meshes": [mesh],
            "materials": [material],
            "textures": [{**texture, "source": 0}],
            "samplers": gltf.items("samplers"),
        }
    )
    with whole_file(path) as file:
        file.write(data)


def _extension(gltf: Gltf, avatar: Avatar, likeness: Likeness) -> JsonObject:
    """What VRMC_vrm says of the file's nodes and morph targets, which stay as they are."""
    nodes, names = gltf.items("nodes"), vrm_names(1)
    bones = {names[joint]: {"node": node} for joint, node in zip(JOINTS, read_skin(gltf, 0).nodes[:52], strict=True)}
    extension: JsonObject = {
        "specVersion": "1.0",
        "meta": {
            "name": likeness.name, "version": "1", "authors": [likeness.author], "licenseUrl": LICENSE,
            "avatarPermission": likeness.permission, **NARROW,
        },
        "humanoid": {"humanBones": bones},
    }  # fmt: skip
    if avatar.eyes is None:
        return extension
    for bone, name in zip(("leftEye", "rightEye"), EYE_JOINTS, strict=True):
        bones[bone] = {"node": next(k for k, node in enumerate(nodes) if node.get("name") == name)}
    body = next(k for k, node in enumerate(nodes) if node.get("mesh") == 0)
    extension["lookAt"] = {
        "type": "bone",
        "offsetFromHeadBone": [float(x) for x in eye_offsets(avatar).mean(0)],
        "rangeMapHorizontalInner": _range(YAW),
        "rangeMapHorizontalOuter": _range(YAW),
        "rangeMapVerticalDown": _range(DOWN),
        "rangeMapVerticalUp": _range(UP),
    }
    extension["expressions"] = {
        "preset": {name: _expression(body, shapes_of(recipe)) for name, recipe in PRESETS.items()},
        "custom": {name: _expression(body, {NUMBER[name]: 1.0}) for name in SHAPES},
    }
    return extension


def _range(most: float) -> JsonObject:
    """Eyes follow to their reach, degrees."""
    degrees = round(float(np.degrees(most)), 3)
    return {"inputMaxValue": degrees, "outputScale": degrees}


def _expression(node: int, shapes: dict[int, float]) -> JsonObject:
    if not shapes:
        return {"isBinary": False}
    binds = [{"node": node, "index": number, "weight": weight} for number, weight in sorted(shapes.items())]
    return {"isBinary": False, "morphTargetBinds": binds}


def _copied(gltf: Gltf, builder: GltfBuilder, number: int) -> int:
    accessor = copy.deepcopy(gltf.items("accessors")[number])
    sparse = accessor.get("sparse", {})
    for holder in (accessor, sparse.get("indices", {}), sparse.get("values", {})):
        if "bufferView" in holder:
            target = gltf.items("bufferViews")[holder["bufferView"]].get("target")
            holder["bufferView"] = builder.add_view(_view(gltf, holder["bufferView"]), target)
    builder.accessors.append(accessor)
    return len(builder.accessors) - 1


def _view(gltf: Gltf, number: int) -> bytes:
    view = gltf.items("bufferViews")[number]
    start = view.get("byteOffset", 0)
    return bytes(gltf.buffers[view["buffer"]][start : start + view["byteLength"]])
