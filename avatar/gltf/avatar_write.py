"""Writing the avatar file. docs/avatar-format.md describes the result; `avatar/gltf/avatar_file.py` reads it."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from avatar.baked_avatar import Avatar, Level, check_avatar
from avatar.face import SHAPES
from avatar.gltf.face import EYE_JOINTS, HEAD, add_follow, add_targets, bound_to_eyes, eye_offsets, eyes_json, with_eyes
from avatar.gltf.write import INDICES, VERTICES, GltfBuilder
from avatar.helper_joints import CARRIER, HelperJoints
from avatar.skeleton import JOINTS, PARENTS, joint_transforms, rigid_inverse
from command.settings import settings_json
from files.input_file import JsonObject
from files.picture import encode_png
from files.whole import whole_file

EXTENSION = "SELFSCAN_avatar"
VERSION = 1
# field of Level: glTF attribute
ATTRIBUTES = {
    "positions": "POSITION",
    "normals": "NORMAL",
    "uv": "TEXCOORD_0",
    "joints": "JOINTS_0",
    "weights": "WEIGHTS_0",
    "view_dir": "_VIEW_DIR",
    "view_seen": "_VIEW_SEEN",
}


def write_avatar(path: str | Path, avatar: Avatar) -> None:
    """Write an avatar file, whole or not at all. The same avatar gives the same bytes.

    Joints of weight 0 are written as joint 0, as glTF asks.

    Raises:
        ValueError: a field of the avatar breaks a promise of `Avatar` or `Level`.
    """
    check_avatar(avatar)
    data = _avatar_bytes(avatar)
    with whole_file(path) as file:
        file.write(data)


class Bones(NamedTuple):
    """The bones of an avatar in the order of the file's skin: the 52 joints, the helper joints, the eyes."""

    names: tuple[str, ...]
    parents: Int[np.ndarray, "bones"]  # come first
    offsets: Float[np.ndarray, "bones 3"]  # from their parent, pose 0, metres

    @property
    def nodes(self) -> list[int]:
        """The node of each; behind those of the 52 is the node of the mesh."""
        return [bone + (bone >= 52) for bone in range(len(self.names))]


def bones_of(avatar: Avatar) -> Bones:
    helpers, joints, eyes = helper_joints(avatar), avatar.joint_positions, EYE_JOINTS if avatar.eyes else ()
    names = (*JOINTS, *(helpers.names if helpers else ()))
    parents = np.r_[PARENTS, CARRIER[52 : len(names)], [HEAD] * len(eyes)].astype(np.int64)
    own = joints - np.where(PARENTS[:, None] >= 0, joints[PARENTS], 0)
    offsets = np.concatenate([own, helpers.offsets if helpers else np.zeros((0, 3)), eye_offsets(avatar)])
    return Bones((*names, *eyes), parents, offsets)


def _avatar_bytes(avatar: Avatar) -> bytes:
    builder, bones = GltfBuilder(), bones_of(avatar)
    joint_from_mesh = rigid_inverse(canonical_bones(avatar))
    skin = {
        "name": "SMPL+H",
        "joints": bones.nodes,
        "skeleton": 0,
        "inverseBindMatrices": builder.add_accessor(joint_from_mesh.astype(np.float32)),
    }
    meshes, materials, textures, levels = [], [], [], []
    first_eye = len(bones.names) - len(avatar.eyes or ())
    for i, level in enumerate(avatar.levels):
        name = f"{avatar.name} {len(level.faces)}"
        image = builder.add_image(encode_png(level.base_color), f"{name} base colour")
        textures.append({"name": name, "sampler": 0, "source": image})
        color = {"baseColorTexture": {"index": i}, "metallicFactor": 0, "roughnessFactor": 1}
        materials.append({"name": name, "pbrMetallicRoughness": color, "extensions": {"KHR_materials_unlit": {}}})
        primitive: JsonObject = {**_add_surface(builder, level, first_eye), "material": i}
        meshes.append({"name": name, "primitives": [primitive]})
        levels.append({"mesh": i})
        if level.face is not None:
            if level.face.follow is None:
                primitive["targets"] = add_targets(builder, level, level.face)
                meshes[i] |= {"weights": [0] * len(SHAPES), "extras": {"targetNames": list(SHAPES)}}
            else:
                levels[i]["follow"] = add_follow(builder, level.face, level.face.follow)
            levels[i]["balls"] = [int(number) for number in level.face.balls.reshape(-1)]
        if level.features is not None:
            planes = np.concatenate(np.moveaxis(level.features, -1, 0))  # (4 h, w)
            levels[i]["featureImage"] = builder.add_image(encode_png(planes), f"{name} features")

    return builder.to_bytes(
        {
            "asset": {"version": "2.0", "generator": "selfscan"},
            "extensionsUsed": ["KHR_materials_unlit", EXTENSION],
            "extensions": {EXTENSION: _extension(avatar, levels)},
            "scene": 0,
            "scenes": [{"name": avatar.name, "nodes": [0, 52]}],
            "nodes": _nodes(bones, avatar.name),
            "skins": [skin],
            "meshes": meshes,
            "materials": materials,
            "textures": textures,
            "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        }
    )


def _nodes(bones: Bones, name: str) -> list[JsonObject]:
    """The skeleton in pose 0, the mesh called `name`, the helper joints and the eyes."""
    nodes: list[JsonObject] = []
    for bone, (own_name, offset) in enumerate(zip(bones.names, bones.offsets, strict=True)):
        children = [bones.nodes[child] for child in np.flatnonzero(bones.parents == bone)]
        node = {"name": own_name, "translation": [float(x) for x in offset]}
        nodes.append(node | ({"children": children} if children else {}))
    return [*nodes[:52], {"name": name, "mesh": 0, "skin": 0}, *nodes[52:]]


def _extension(avatar: Avatar, levels: list[JsonObject]) -> JsonObject:
    """What SELFSCAN_avatar says; `levels` are where the levels lie in the file."""
    extension: JsonObject = {
        "version": VERSION,
        "name": avatar.name,
        "jointPositions": _flat(avatar.joint_positions),
        "canonicalPose": _flat(avatar.canonical_pose),
        "levels": levels,
        "defaultView": avatar.default_view,
        "amplitude": float(avatar.amplitude),
        "provenance": avatar.provenance,
    }
    network = avatar.network
    optional: JsonObject = {
        "twist": None if avatar.levels[0].twist is None else True,
        "bend": None if avatar.bend is None else _flat(avatar.bend),
        "face": None if avatar.eyes is None else eyes_json(avatar),
        "network": None if network is None else {name: _flat(values) for name, values in vars(network).items()},
        "linear": None if avatar.linear is None else _flat(avatar.linear),
        "light": None if avatar.light is None else settings_json(avatar.light),
    }
    return extension | {name: value for name, value in optional.items() if value is not None}


def _add_surface(builder: GltfBuilder, level: Level, eye: int) -> JsonObject:
    """The attributes and indices of a level's one primitive; `eye` is the number of the left eye's bone."""
    q = level.view_q
    arrays = {name: getattr(level, field) for field, name in ATTRIBUTES.items()}
    arrays |= {"_VIEW_Q0": q[:, :3], "_VIEW_Q1": q[:, 3:]}
    few = {"_VIEW_SEEN": level.view_seen[:, None], "_LIGHT": level.light}
    few["_LOOSE"] = None if level.loose is None else level.loose[:, None]
    # three numbers as the others: Blender up to 5.1 takes attributes of several types for one another (its #2658)
    arrays |= {
        name: np.pad(values, ((0, 0), (0, 3 - values.shape[1]))) for name, values in few.items() if values is not None
    }
    joints, arrays["WEIGHTS_0"] = level.drawn_skin
    if level.face is not None:
        joints = bound_to_eyes(joints, level.face, eye)
    arrays["JOINTS_0"] = np.where(arrays["WEIGHTS_0"] > 0, joints, 0).astype(np.uint8)
    attributes = {
        name: builder.add_accessor(values, VERTICES, normalised=name == "WEIGHTS_0", bounds=name == "POSITION")
        for name, values in arrays.items()
    }
    # the largest index of a type is kept for primitive restart
    small = len(level.positions) < 65535
    indices = level.faces.reshape(-1).astype(np.uint16 if small else np.uint32)
    return {"attributes": attributes, "indices": builder.add_accessor(indices, INDICES)}


def canonical_bones(avatar: Avatar) -> Float[np.ndarray, "bones 4 4"]:
    """Where the bones stand in the pose that the levels are stored in: 52, or with helper joints and eyes more."""
    transforms = joint_transforms(avatar.canonical_pose, avatar.joint_positions)
    helpers = helper_joints(avatar)
    return with_eyes(helpers.with_helpers(avatar.canonical_pose, transforms) if helpers else transforms, avatar)


def helper_joints(avatar: Avatar) -> HelperJoints | None:
    """Those of an avatar; None: it has none."""
    return None if avatar.levels[0].twist is None else HelperJoints(avatar.joint_positions, avatar.bend)


def _flat(values: np.ndarray) -> list[float]:
    """Numbers for JSON, row by row; JSON keeps every bit of a float64, so of a float32 too."""
    return [float(value) for value in values.reshape(-1)]
