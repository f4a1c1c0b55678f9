"""A VRM 1.0 or 0.x of an avatar file: the person as a humanoid that programs for virtual presence take.

The finest mesh alone, unlit, with its 52 joints as VRM's bones, the feet on the ground, its face where the file has one
(vrm_extension.py) and its loose hair and skirt on spring bones (spring_bones.py). What is ours alone (view dependence,
levels of detail) stays behind.

VRM 1.0 looks along +z as an avatar file does: its bytes are copied. VRM 0.x looks along -z (specification/0.0, "VRM
rules"): everything is turned by half a turn about y, so that a transform M becomes T M T, T = diag(-1, 1, -1, 1). Its
nodes rest in T-pose; the mesh stays in the canonical pose under its inverse binds. Early UniVRM reads joints as two
bytes and weights as floats, whatever the file says, and names of targets from the primitive: so they are written.
"""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np

from avatar.baked_avatar import Avatar
from avatar.face import SHAPES
from avatar.gltf.avatar_file import avatar_gltf, read_avatar
from avatar.gltf.document import Gltf
from avatar.gltf.face import add_targets
from avatar.gltf.scene import primitives, world_from_node
from avatar.gltf.spring_bones import SpringBones, earlier_springs, spring_bones, spring_extension
from avatar.gltf.vrm_extension import EXTENSIONS, Likeness, earlier_extension, vrm_extension
from avatar.gltf.write import VERTICES, GltfBuilder
from files.input_file import JsonObject
from files.whole import whole_file

SPRINGS, BINDS = "VRMC_springBone", "inverseBindMatrices"
# half a turn about y
TURN = np.array([-1.0, 1.0, -1.0], np.float32)


def write_vrm(
    path: Path | str, avatar_path: Path | str, likeness: Likeness, pelvis_height: float, *, version: int = 1
) -> None:
    """Write a .vrm of the avatar file, whole or not at all; the pelvis stands at this height, metres.

    version: 1 (1.0) or 0 (0.x).

    Raises:
        AssetError: `avatar_path` is not an avatar file.
    """
    avatar, gltf, builder = read_avatar(avatar_path, levels=1), avatar_gltf(avatar_path), GltfBuilder()
    nodes, skin = copy.deepcopy(gltf.items("nodes")), copy.deepcopy(gltf.items("skins")[0])
    springs, at = spring_bones(gltf, avatar), world_from_node(gltf)[skin["joints"], :3, 3]
    bound = _bound(gltf, springs)
    chains = [] if springs is None else springs.add_nodes(nodes, skin["joints"], at)
    nodes[0]["translation"][1] += pelvis_height
    if version == 1:
        surface, skin["inverseBindMatrices"] = _copied_surface(gltf, builder, avatar, bound)
        extensions: JsonObject = {EXTENSIONS[1]: vrm_extension(gltf, avatar, likeness)}
        if springs is not None:
            extensions[SPRINGS] = spring_extension(springs, chains, skin["joints"], at)
    else:
        surface, skin["inverseBindMatrices"] = _turned_surface(gltf, builder, avatar, bound)
        extensions = {EXTENSIONS[0]: earlier_extension(gltf, avatar, likeness)}
        if springs is not None:
            extensions[EXTENSIONS[0]]["secondaryAnimation"] = earlier_springs(springs, chains, skin["joints"], at)
        for node in nodes:
            if "translation" in node:
                node["translation"] = (TURN * np.array(node["translation"])).tolist()
    source = primitives(gltf, 0)[0]
    primitive = {**surface, "indices": _copied(gltf, builder, source["indices"]), "material": 0}
    material = {**gltf.items("materials")[source["material"]]}
    texture = gltf.items("textures")[material["pbrMetallicRoughness"]["baseColorTexture"]["index"]]
    image = gltf.items("images")[texture["source"]]
    material["pbrMetallicRoughness"] = {**material["pbrMetallicRoughness"], "baseColorTexture": {"index": 0}}
    builder.add_image(_view(gltf, image["bufferView"]), image.get("name", ""))
    data = builder.to_bytes(
        {
            "asset": {"version": "2.0", "generator": "selfscan"},
            "extensionsUsed": ["KHR_materials_unlit", *extensions],
            "extensions": extensions,
            "scene": 0,
            "scenes": gltf.items("scenes")[:1],
            "nodes": nodes,
            "skins": [skin],
            "meshes": [{**gltf.items("meshes")[0], "primitives": [primitive]}],
            "materials": [material],
            "textures": [{**texture, "source": 0}],
            "samplers": gltf.items("samplers"),
        }
    )
    with whole_file(path) as file:
        file.write(data)


def _attributes(gltf: Gltf) -> dict[str, int]:
    """The accessors of the finest mesh that others know."""
    return {k: number for k, number in primitives(gltf, 0)[0]["attributes"].items() if not k.startswith("_")}


def _bound(gltf: Gltf, springs: SpringBones | None) -> dict[str, np.ndarray]:
    """What spring bones change of the mesh's skin: joints, weights as bytes whose rows sum to 255, inverse binds."""
    if springs is None:
        return {}
    joints, weights = springs.skin
    whole = np.round(weights * 255).astype(int)
    whole[:, 0] += 255 - whole.sum(1)  # the largest comes first
    binds = np.concatenate([gltf.accessor(gltf.items("skins")[0][BINDS]), springs.joint_from_mesh.astype(np.float32)])
    joints = np.where(whole > 0, joints, 0)
    joints = joints.astype(np.uint8 if joints.max() < 256 else np.uint16)
    return {"JOINTS_0": joints, "WEIGHTS_0": whole.astype(np.uint8), BINDS: binds}


def _copied_surface(
    gltf: Gltf, builder: GltfBuilder, avatar: Avatar, bound: dict[str, np.ndarray]
) -> tuple[JsonObject, int]:
    """Attributes and targets of the mesh, and the accessor of the inverse binds: byte for byte but for `bound`."""
    attributes = {
        name: builder.add_accessor(bound[name], VERTICES, normalised=name == "WEIGHTS_0")
        if name in bound else _copied(gltf, builder, number)
        for name, number in _attributes(gltf).items()
    }  # fmt: skip
    surface: JsonObject = {"attributes": attributes}
    if avatar.eyes is not None:
        targets = primitives(gltf, 0)[0]["targets"]
        surface["targets"] = [{"POSITION": _copied(gltf, builder, target["POSITION"])} for target in targets]
    if bound:
        return surface, builder.add_accessor(bound[BINDS])
    return surface, _copied(gltf, builder, gltf.items("skins")[0][BINDS])


def _turned_surface(
    gltf: Gltf, builder: GltfBuilder, avatar: Avatar, bound: dict[str, np.ndarray]
) -> tuple[JsonObject, int]:
    """The same, turned to look along -z."""
    attributes: dict[str, int] = {}
    for name, number in _attributes(gltf).items():
        values = bound[name] if name in bound else gltf.accessor(number)
        if name == "JOINTS_0":
            values = values.astype(np.uint16)
        elif name == "WEIGHTS_0":
            values = values.astype(np.float32) / np.float32(255)
        elif name in ("POSITION", "NORMAL"):
            values = values * TURN
        attributes[name] = builder.add_accessor(values, VERTICES, bounds=name == "POSITION")
    surface: JsonObject = {"attributes": attributes}
    level = avatar.levels[0]
    if level.face is not None:
        turned = replace(level.face, offsets=level.face.offsets * TURN)
        surface |= {"targets": add_targets(builder, level, turned), "extras": {"targetNames": list(SHAPES)}}
    turn = np.append(TURN, np.float32(1))
    inverse_binds = bound[BINDS] if bound else gltf.accessor(gltf.items("skins")[0][BINDS])
    return surface, builder.add_accessor(inverse_binds * np.outer(turn, turn))


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
