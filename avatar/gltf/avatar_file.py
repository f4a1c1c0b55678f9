"""The avatar file: one .glb that any glTF viewer shows, and that ours shows whole.

Plain glTF holds the finest level: a skinned, unlit, textured mesh in the canonical pose on 52 named joints that
rest in pose 0. The optional extension SELFSCAN_avatar refers to the rest: coarser levels, feature images, the
view network, the canonical pose and provenance. docs/avatar-format.md is the byte-level description.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from numpy import ndarray as Array

from avatar.baked_avatar import (
    NETWORK_ARRAYS,
    VIEW_MODES,
    Avatar,
    Level,
    TwistSkin,
    ViewNetwork,
    check_avatar,
    check_level,
)
from avatar.bend import BENDS
from avatar.gltf.avatar_write import ATTRIBUTES, EXTENSION, VERSION, bones_of, canonical_bones, write_avatar
from avatar.gltf.document import Gltf, read_gltf
from avatar.gltf.face import read_eyes, read_face
from avatar.gltf.scene import (
    attribute_accessors,
    base_color_image,
    base_texture,
    node_parents,
    primitives,
    read_skin,
    triangles,
    world_from_node,
)
from avatar.helper_joints import CARRIER, HELPER_JOINTS
from avatar.light import light_from_json
from avatar.skeleton import JOINTS, rigid_inverse
from avatar.twist import TWIST_JOINTS
from command.errors import AssetError
from files.input_file import JsonObject
from files.picture import decode_png, png_pixels

__all__ = ["Avatar", "Level", "ViewNetwork", "read_avatar", "write_avatar"]

T = TypeVar("T")
MAX_LEVELS = 8
# the person that travels with the program, and one that `selfscan synth` films but that is no avatar yet
BUILTIN, FILMED = "builtin", "builtin:female"
# extensions by which a .vrm differs from any other glTF
VRM = ("VRMC_vrm", "VRM")
# images that are unpacked at once
DECODERS = 3
# pixels of all images together: 200 MB decoded
MAX_PIXELS = 1 << 26


def read_avatar(path: str | Path, *, levels: int | None = None) -> Avatar:
    """Read an avatar file, or builtin, and check every promise that `Avatar` and `Level` make.

    With `levels` only that many of the finest are decoded: a picture needs one, and the others' atlases cost a third
    of the time that reading takes. Of the rest only what the file says of them is checked.

    Raises:
        AssetError: the file is no avatar, or a field is not as promised.
    """
    gltf, extension = _extension(path)
    where = f"extensions.{EXTENSION}"
    for key, kind in (("name", str), ("defaultView", str), ("provenance", dict)):
        if not isinstance(extension.get(key), kind):
            raise gltf.error(f"{where}.{key}", f"a {kind.__name__}", extension.get(key))
    if extension["defaultView"] not in VIEW_MODES:
        raise gltf.error(f"{where}.defaultView", "network, linear or off", extension["defaultView"])
    joints = gltf.numbers(extension, "jointPositions", where, (52, 3))
    pose = gltf.numbers(extension, "canonicalPose", where, (52, 3))
    twist = extension.get("twist", False)
    if not isinstance(twist, bool):
        raise gltf.error(f"{where}.twist", "true or absent", twist)
    bend = gltf.numbers(extension, "bend", where, (len(BENDS),)) if "bend" in extension else None
    amplitude = extension.get("amplitude")
    if not isinstance(amplitude, int | float) or isinstance(amplitude, bool):
        raise gltf.error(f"{where}.amplitude", "a number", amplitude)
    linear = gltf.numbers(extension, "linear", where, (4, 3, 3)).astype(np.float32) if "linear" in extension else None
    try:
        avatar = Avatar(
            name=extension["name"],
            joint_positions=joints,
            canonical_pose=pose,
            levels=_read_levels(gltf, extension, levels, twisted=twist, bent=bend is not None),
            network=_read_network(gltf, extension),
            linear=linear,
            amplitude=float(amplitude),
            default_view=extension["defaultView"],
            provenance=extension["provenance"],
            bend=bend,
            eyes=read_eyes(gltf, extension, where),
            light=None if extension.get("light") is None else light_from_json(extension["light"]),
        )
        check_avatar(avatar)
    except (ValueError, OverflowError) as error:
        raise AssetError(f"{gltf.path}: {error}") from None
    _check_skeleton(gltf, avatar, extension["levels"][0]["mesh"])
    return avatar


def avatar_place(path: str | Path) -> Path:
    """Where an avatar's file is; `builtin` travels with the program."""
    here = str(path) != BUILTIN or Path(path).exists()
    return Path(path) if here else Path(str(files("avatar") / "data" / "avatar" / "man.glb"))


def avatar_gltf(path: str | Path) -> Gltf:
    return read_gltf(avatar_place(path))


def _extension(path: str | Path) -> tuple[Gltf, JsonObject]:
    """The file, and the extension that makes it an avatar's."""
    if str(path) == FILMED and not Path(path).exists():
        raise AssetError(
            f"{path}: a person to film, no avatar yet: selfscan synth {path} CAPTURE, train CAPTURE -o RUN and bake "
            "RUN -o NAME.glb; builtin is the man, mannequin:female the bare body"
        )
    gltf = avatar_gltf(path)
    extension = gltf.extensions(gltf.json, "glTF").get(EXTENSION)
    where = f"extensions.{EXTENSION}"
    if extension is None and any(name in gltf.extensions(gltf.json, "glTF") for name in VRM):
        raise AssetError(
            f"{gltf.path}: a VRM person, not a baked avatar: `selfscan synth {gltf.path} OUT` films it as a subject, "
            f"`--motion {gltf.path}` plays its animation on an avatar"
        )
    if not isinstance(extension, dict):
        raise gltf.error(where, "there: an avatar comes from `selfscan bake`", extension)
    if extension.get("version") != VERSION:
        raise gltf.error(f"{where}.version", f"{VERSION}", extension.get("version"))
    return gltf, extension


def _read_network(gltf: Gltf, extension: JsonObject) -> ViewNetwork | None:
    network, where = extension.get("network"), f"extensions.{EXTENSION}.network"
    if network is None:
        return None
    if not isinstance(network, dict):
        raise gltf.error(where, "an object", network)
    unknown, shapes = sorted(set(network) - set(NETWORK_ARRAYS)), NETWORK_ARRAYS.items()
    if unknown:
        raise gltf.error(where, f"of {', '.join(NETWORK_ARRAYS)} alone", unknown)
    return ViewNetwork(**{name: gltf.numbers(network, name, where, shape).astype(np.float32) for name, shape in shapes})


def _read_levels(
    gltf: Gltf, extension: JsonObject, wanted: int | None, *, twisted: bool, bent: bool
) -> tuple[Level, ...]:
    """The levels, each with a mesh and images of its own; of more than `wanted` the finest."""
    items, where = extension.get("levels"), f"extensions.{EXTENSION}.levels"
    if not isinstance(items, list) or not 1 <= len(items) <= MAX_LEVELS:
        raise gltf.error(where, f"a list of 1 to {MAX_LEVELS} levels", items)
    sources = [_level_source(gltf, item, f"{where}[{i}]") for i, item in enumerate(items)]
    # The same mesh or image again would multiply what a small file costs to decode.
    meshes = [source.mesh for source in sources]
    images = [image for source in sources for image in (source.base_color, source.features) if image is not None]
    for name, used in (("mesh", meshes), ("image", images)):
        if len(set(used)) != len(used):
            raise gltf.error(where, f"with a {name} of their own each", used)
    pixels = sum(_of_image(gltf, image, png_pixels) for image in images)
    if pixels > MAX_PIXELS:
        raise gltf.error("images", f"at most {MAX_PIXELS} pixels together", pixels)

    levels = []
    # unpacking is work outside of Python
    with ThreadPoolExecutor(DECODERS) as pool:
        unpacked = [
            (pool.submit(_of_image, gltf, source.base_color, decode_png, "RGB"),
             None if source.features is None else pool.submit(_four_features, gltf, source.features))
            for source in sources[:wanted]
        ]  # fmt: skip
        for i, mesh in enumerate(meshes[:wanted]):
            arrays, (base_color, features) = _read_surface(gltf, mesh), unpacked[i]
            arrays["base_color"] = base_color.result()
            fields: JsonObject = {**arrays, "features": None if features is None else features.result()}
            helpers = (HELPER_JOINTS if bent else TWIST_JOINTS) if twisted else ()
            finest = levels[0].face if levels else None
            fields["face"] = read_face(gltf, items[i], arrays, len(JOINTS) + len(helpers), finest, f"{where}[{i}]")
            if twisted:
                fields["twist"] = _twist_skin(gltf, mesh, arrays)
                fields["joints"], fields["weights"] = fields["twist"].folded()
            check_level(fields, f"levels[{i}]")
            levels.append(Level(**fields))
    return tuple(levels)


class _Source(NamedTuple):
    mesh: int
    base_color: int  # image
    features: int | None  # image of four features


def _four_features(gltf: Gltf, image: int) -> Array:
    """Four features a texel, from their planes one below the other."""
    planes = _of_image(gltf, image, decode_png, "L")
    if len(planes) % 4:
        raise gltf.error(f"images[{image}] height", "four planes", len(planes))
    return np.ascontiguousarray(np.moveaxis(planes.reshape(4, -1, planes.shape[1]), 0, -1))


def _level_source(gltf: Gltf, item: object, where: str) -> _Source:
    if not isinstance(item, dict):
        raise gltf.error(where, "an object", item)
    mesh = gltf.index("meshes", item.get("mesh"), f"{where}.mesh")
    part, *others = primitives(gltf, mesh)
    if others:
        raise gltf.error(f"meshes[{mesh}].primitives", "one", 1 + len(others))
    material = gltf.index("materials", part.get("material"), f"meshes[{mesh}] material")
    base_color = base_color_image(gltf, material)
    if base_color is None:
        raise gltf.error(f"materials[{material}]", "with a base colour texture", None)
    texcoord = base_texture(gltf, material).get("texCoord", 0)
    if texcoord != 0:
        raise gltf.error(f"materials[{material}] texCoord", "0, the only texture coordinates read", texcoord)
    features = item.get("featureImage")
    if features is not None:
        features = gltf.index("images", features, f"{where}.featureImage")
    return _Source(mesh, base_color, features)


def _of_image(gltf: Gltf, index: int, function: Callable[..., T], *arguments: object) -> T:
    """Apply a function of PNG bytes to an image; its complaint gains the place."""
    try:
        return function(gltf.image(index), *arguments)
    except ValueError as error:
        raise AssetError(f"{gltf.path}: images[{index}] {error}") from None


def _read_surface(gltf: Gltf, mesh: int) -> dict[str, Array]:
    accessors, where = attribute_accessors(gltf, mesh), f"meshes[{mesh}].primitives[0]"
    for name in (*ATTRIBUTES.values(), "_VIEW_Q0", "_VIEW_Q1"):
        if name not in accessors:
            raise gltf.error(f"{where}.attributes", f"with {name}", sorted(accessors))
    if gltf.items("accessors")[accessors["WEIGHTS_0"]].get("normalized") is not True:
        raise gltf.error(f"{where}.WEIGHTS_0", "normalised bytes", "not normalised")
    arrays = {field: gltf.accessor(accessors[name]) for field, name in ATTRIBUTES.items()}
    arrays["view_seen"] = _unpadded(gltf, arrays["view_seen"], 1, f"{where}._VIEW_SEEN")
    q0, q1 = gltf.accessor(accessors["_VIEW_Q0"]), gltf.accessor(accessors["_VIEW_Q1"])
    if q0.shape != q1.shape or q0.ndim != 2:
        raise gltf.error(f"{where}._VIEW_Q1", f"of the shape of _VIEW_Q0 {q0.shape}", q1.shape)
    arrays["view_q"] = np.concatenate([q0, q1], axis=1)
    for field, name, used in (("light", "_LIGHT", 2), ("loose", "_LOOSE", 1)):
        if name in accessors:
            arrays[field] = _unpadded(gltf, gltf.accessor(accessors[name]), used, f"{where}.{name}")
    arrays["faces"] = triangles(gltf, mesh, 0, len(arrays["positions"]))
    return arrays


def _unpadded(gltf: Gltf, values: Array, used: int, where: str) -> Array:
    """The columns of an attribute that are used, or the one; avatar_write.py fills others of its three with zeros."""
    if values.ndim != 2 or values.shape[1] != 3 or values[:, used:].any():
        numbers = f"{used} number{'s' * (used > 1)} and {3 - used} of 0 for each vertex"
        raise gltf.error(where, numbers, values.shape)
    return np.ascontiguousarray(values[:, :used] if used > 1 else values[:, 0])


def _twist_skin(gltf: Gltf, mesh: int, arrays: dict[str, Array]) -> TwistSkin:
    """The skin of a file with helper joints, whose numbers are in range."""
    where = f"meshes[{mesh}].primitives[0].JOINTS_0"
    joints, weights = arrays["joints"], arrays["weights"]
    if not (joints.dtype == weights.dtype == np.uint8 and joints.shape[1:] == (4,) and joints.shape == weights.shape):
        raise gltf.error(where, "four bytes a vertex, as WEIGHTS_0", (joints.shape, joints.dtype.name))
    if joints.max() >= len(CARRIER):
        raise gltf.error(where, f"below {len(CARRIER)}", int(joints.max()))
    return TwistSkin(joints, weights)


def _check_skeleton(gltf: Gltf, avatar: Avatar, mesh: int) -> None:
    """The node tree must say what the extension says: names, order, parents, pose 0, inverse binds."""
    bearers = [i for i, node in enumerate(gltf.items("nodes")) if node.get("mesh") == mesh and "skin" in node]
    if len(bearers) != 1:
        raise gltf.error("nodes", f"one with the finest mesh {mesh} and a skin", bearers)
    skin = read_skin(gltf, gltf.items("nodes")[bearers[0]]["skin"], field=f"nodes[{bearers[0]}].skin")
    names = [gltf.items("nodes")[node].get("name") for node in skin.nodes]
    named, parent_of, offsets = bones_of(avatar)
    if names != list(named):
        pairs = enumerate(zip([*names, "absent"], [*named, "their end"], strict=False))
        wrong, (found, wanted) = next(pair for pair in pairs if pair[1][0] != pair[1][1])
        order = "the 52 SMPL+H joints in order, where it has any then the helper joints, then the eyes"
        raise gltf.error(f"skin joint {wrong}", f"{order}, here {wanted}", found)
    parents = node_parents(gltf)
    for joint, node in enumerate(skin.nodes[1:], start=1):
        if parents[node] != skin.nodes[parent_of[joint]]:
            raise gltf.error(f"parent of {named[joint]}", JOINTS[parent_of[joint]], f"node {parents[node]}")
    world = world_from_node(gltf)[list(skin.nodes)]
    expected = np.tile(np.eye(4), (len(named), 1, 1))
    for bone in range(1, len(named)):
        expected[bone, :3, 3] = expected[parent_of[bone], :3, 3] + offsets[bone]
    _check_close(gltf, "default nodes", world, expected, named)
    _check_close(gltf, "inverse bind matrices", skin.joint_from_mesh, rigid_inverse(canonical_bones(avatar)), named)


def _check_close(gltf: Gltf, field: str, found: Array, expected: Array, names: tuple[str, ...]) -> None:
    """Transforms of the joints agree to 10 micrometres (and as little rotation), of giants to so much of a metre."""
    error = np.abs(found - expected).max(axis=(1, 2))
    if not error.max() < 1e-5 * max(1.0, np.abs(expected).max()):
        joint = int(np.argmax(error))
        raise gltf.error(f"{field} of {names[joint]}", "as the extension says", f"off by {error[joint]:.2g}")
