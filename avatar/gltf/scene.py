"""What a glTF file's accessors mean: the node tree, skins, triangles, materials and their base color."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt32
from numpy import ndarray as Array

from avatar.gltf.document import Gltf, refusal
from avatar.rotation import affine, matrix_from_quaternion
from avatar.texture import bytes_of, linear_from_srgb, srgb_from_linear
from command.errors import AssetError
from files.picture import WITH_WEBP, decode_picture

TRIANGLES = 4  # the mode of a primitive


class Skin(NamedTuple):
    """The joints of a skinned mesh. A vertex is at sum_k w_k world_from_node[k] joint_from_mesh[k] x."""

    # the node of each joint
    nodes: tuple[int, ...]
    joint_from_mesh: Float[Array, "joints 4 4"]  # inverse bind matrices


class Primitive(NamedTuple):
    """One drawable part of a mesh: vertex attributes by their glTF names, and triangles."""

    # float32, except JOINTS_n, which keep their integer type
    attributes: dict[str, Array]
    faces: UInt32[Array, "faces 3"]
    material: int | None


def node_parents(gltf: Gltf) -> Int[Array, "nodes"]:
    """The parent of every node, -1 for a root. Refuses a node with two parents and a cycle."""
    nodes = gltf.items("nodes")
    parents = np.full(len(nodes), -1, dtype=np.int64)
    for i, node in enumerate(nodes):
        children = node.get("children", [])
        if not isinstance(children, list):
            raise gltf.error(f"nodes[{i}].children", "a list", children)
        for child in children:
            child = gltf.index("nodes", child, f"nodes[{i}].children")
            if parents[child] >= 0:
                raise gltf.error(f"nodes[{child}]", "the child of one node", [int(parents[child]), i])
            parents[child] = i
    # With one parent each, nodes that no root reaches lie on a cycle or below one.
    reached = len(parents_first(parents))
    if reached != len(nodes):
        raise AssetError(f"{gltf.path}: nodes should be a tree, are a cycle for {len(nodes) - reached} nodes")
    return parents


def parents_first(parents: Int[Array, "nodes"]) -> list[int]:
    """The nodes that a root reaches, every node after its parent."""
    children: list[list[int]] = [[] for _ in parents]
    for node, parent in enumerate(parents):
        if parent >= 0:
            children[parent].append(node)
    order = [int(i) for i in np.flatnonzero(parents < 0)]
    # grows while it is walked
    for node in order:
        order.extend(children[node])
    return order


def nodes_of_scene(gltf: Gltf) -> Bool[Array, "nodes"]:
    """Which nodes are in the scene that a viewer shows, where the file has several; else all."""
    parents, scenes = node_parents(gltf), gltf.items("scenes")
    there = np.ones(len(parents), bool)
    if len(scenes) > 1:
        listed = gltf.item("scenes", gltf.json.get("scene", 0), "scene").get("nodes")
        roots = {root for root in listed if type(root) is int} if isinstance(listed, list) else set[int]()
        for node in parents_first(parents):
            there[node] = there[parents[node]] if parents[node] >= 0 else node in roots
    return there


def visible_nodes(gltf: Gltf) -> Bool[Array, "nodes"]:
    """Which nodes are displayed: KHR_node_visibility hides neither them nor a node above."""
    parents = node_parents(gltf)
    visible = np.ones(len(parents), bool)
    for node in parents_first(parents):
        where = f"nodes[{node}]"
        stated = gltf.extensions(gltf.items("nodes")[node], where).get("KHR_node_visibility", {})
        own = stated.get("visible", True) if isinstance(stated, dict) else None
        if type(own) is not bool:
            raise gltf.error(f"{where} KHR_node_visibility", "an object, its `visible` true or false", stated)
        visible[node] = own and (parents[node] < 0 or visible[parents[node]])
    return visible


class NodePlace(NamedTuple):
    """A node's own transform, T R S: parent_from_node x = translation + R (scale * x)."""

    translation: Float[Array, "3"]
    rotation: Float[Array, "4"]  # unit quaternion, xyzw
    scale: Float[Array, "3"]


def node_place(gltf: Gltf, index: int) -> NodePlace:
    """The transform of a node that has no `matrix`."""
    node, where = gltf.items("nodes")[index], f"nodes[{index}]"
    given = {"translation": [0.0] * 3, "rotation": [0.0, 0.0, 0.0, 1.0], "scale": [1.0] * 3} | node
    translation, scale = (gltf.numbers(given, name, where, (3,)) for name in ("translation", "scale"))
    rotation = gltf.numbers(given, "rotation", where, (4,))
    length = np.linalg.norm(rotation)
    # files round their quaternions; more is another mistake
    if abs(length - 1) > 0.01:
        raise gltf.error(f"{where}.rotation", "a unit quaternion", node["rotation"])
    return NodePlace(translation, rotation / length, scale)


def parent_from_node(gltf: Gltf, index: int) -> Float[Array, "4 4"]:
    """A node's own transform: its `matrix`, or T R S."""
    node = gltf.items("nodes")[index]
    if "matrix" in node:
        return gltf.numbers(node, "matrix", f"nodes[{index}]", (4, 4)).T.copy()
    translation, rotation, scale = node_place(gltf, index)
    return affine(matrix_from_quaternion(rotation) * scale, translation)


def world_from_node(gltf: Gltf) -> Float[Array, "nodes 4 4"]:
    """The world transform of every node in the default pose, float64."""
    parents = node_parents(gltf)
    world = np.tile(np.eye(4), (len(parents), 1, 1))
    for node in parents_first(parents):
        own = parent_from_node(gltf, node)
        world[node] = own if parents[node] < 0 else world[parents[node]] @ own
    # A chain of scales may overflow; a picture of it would not say why.
    if not (np.abs(world) < 1e30).all():
        first = int(np.argwhere(~(np.abs(world) < 1e30))[0, 0])
        raise gltf.error(f"nodes[{first}] in the world", "finite", world[first].tolist())
    return world


def read_skin(gltf: Gltf, index: object, *, field: str = "skin") -> Skin:
    """A skin: its joints' nodes, each once, and their inverse bind matrices (identity where absent)."""
    skin, where = gltf.item("skins", index, field), f"skins[{index}]"
    joints = skin.get("joints")
    if not isinstance(joints, list) or not joints:
        raise gltf.error(f"{where}.joints", "a list of nodes", joints)
    nodes = tuple(gltf.index("nodes", joint, f"{where}.joints") for joint in joints)
    if len(set(nodes)) != len(nodes):
        raise gltf.error(f"{where}.joints", "different nodes", joints)
    matrices = np.tile(np.eye(4), (len(nodes), 1, 1))
    if "inverseBindMatrices" in skin:
        field = f"{where}.inverseBindMatrices"
        stored = gltf.accessor(skin["inverseBindMatrices"], field=field)
        if stored.dtype != np.float32 or stored.ndim != 3 or stored.shape[1:] != (4, 4):
            raise gltf.error(field, "4x4 float matrices", (stored.shape, stored.dtype.name))
        if len(stored) < len(nodes):
            raise gltf.error(field, f"{len(nodes)} matrices", len(stored))
        matrices = stored[: len(nodes)].astype(np.float64)
    return Skin(nodes, matrices)


def primitives(gltf: Gltf, mesh: object) -> list[dict]:
    return gltf.objects(gltf.item("meshes", mesh, "mesh"), "primitives", f"meshes[{mesh}]")


def read_primitive(gltf: Gltf, mesh: int, primitive: int = 0) -> Primitive:
    """The arrays of one primitive, all of one length, and its triangles."""
    part, where = primitives(gltf, mesh)[primitive], f"meshes[{mesh}].primitives[{primitive}]"
    attributes = attribute_accessors(gltf, mesh, primitive)
    arrays = {
        name: gltf.accessor(index, as_float=not name.startswith("JOINTS_"), field=f"{where}.{name}")
        for name, index in attributes.items()
    }
    count = len(arrays["POSITION"])
    for name, values in arrays.items():
        if len(values) != count:
            raise gltf.error(f"{where}.{name}", f"{count} values, as POSITION has", len(values))
    if arrays["POSITION"].shape != (count, 3):
        raise gltf.error(f"{where}.POSITION", f"({count}, 3)", arrays["POSITION"].shape)
    material = part.get("material")
    if material is not None:
        material = gltf.index("materials", material, f"{where}.material")
    return Primitive(arrays, triangles(gltf, mesh, primitive, count), material)


def attribute_accessors(gltf: Gltf, mesh: int, primitive: int = 0) -> dict[str, int]:
    """The accessor of each vertex attribute of a primitive; POSITION is among them."""
    part, where = primitives(gltf, mesh)[primitive], f"meshes[{mesh}].primitives[{primitive}]"
    attributes = part.get("attributes")
    if not isinstance(attributes, dict) or "POSITION" not in attributes:
        raise gltf.error(f"{where}.attributes", "an object with POSITION", attributes)
    for name in attributes:  # they go into messages
        if not name.isprintable() or len(name) > 64:
            raise gltf.error(f"{where}.attributes", "printable, short names", name)
    found = {name: gltf.index("accessors", i, f"{where}.{name}") for name, i in attributes.items()}
    # Draco's attributes have no bytes of their own: read as plain glTF they would all be zero.
    draco = "KHR_draco_mesh_compression" in gltf.extensions(part, where)
    if draco and "bufferView" not in gltf.items("accessors")[found["POSITION"]]:
        raise AssetError(refusal(gltf.path, "KHR_draco_mesh_compression"))
    return found


def triangles(gltf: Gltf, mesh: int, primitive: int, vertices: int) -> UInt32[Array, "faces 3"]:
    """The triangles of a primitive with this many vertices; every index is below it."""
    part, where = primitives(gltf, mesh)[primitive], f"meshes[{mesh}].primitives[{primitive}]"
    mode = part.get("mode", TRIANGLES)
    if mode != TRIANGLES:
        raise gltf.error(f"{where}.mode", "4, a list of triangles", mode)
    if "indices" in part:
        indices = gltf.accessor(part["indices"], field=f"{where}.indices")
        if indices.ndim != 1 or indices.dtype.kind != "u":
            raise gltf.error(f"{where}.indices", "unsigned whole numbers", (indices.shape, indices.dtype.name))
        if indices.max() >= vertices:
            raise gltf.error(f"{where}.indices", f"below the {vertices} vertices", int(indices.max()))
    else:
        indices = np.arange(vertices)
    indices = indices.astype(np.uint32)
    if len(indices) < 3 or len(indices) % 3:
        raise gltf.error(f"{where}.indices", "whole triangles", len(indices))
    return indices.reshape(-1, 3)


def base_color_image(gltf: Gltf, material: int) -> int | None:
    """The image of a material's base colour; None where it has a plain colour."""
    texture, where = base_texture(gltf, material), f"materials[{material}].pbrMetallicRoughness.baseColorTexture"
    if not texture:
        return None
    transform = gltf.extensions(texture, where).get("KHR_texture_transform", {})
    plain = {"offset": [0, 0], "rotation": 0, "scale": [1, 1], "texCoord": texture.get("texCoord", 0)}
    if not isinstance(transform, dict) or any(transform.get(key, rest) != rest for key, rest in plain.items()):
        raise gltf.error(f"{where} KHR_texture_transform", "one that moves nothing: bake it into the UVs", transform)
    item, where = gltf.item("textures", texture.get("index"), f"{where}.index"), f"textures[{texture.get('index')}]"
    webp = gltf.extensions(item, where).get("EXT_texture_webp")
    return gltf.index("images", (webp if isinstance(webp, dict) else item).get("source"), f"{where}.source")


def material_of(gltf: Gltf, index: int) -> dict:
    """A material's JSON, empty where there is none."""
    return gltf.items("materials")[index] if index >= 0 else {}


def _within(gltf: Gltf, index: int, *keys: str) -> dict:
    """An object inside a material, empty where the file has none."""
    found = material_of(gltf, index)
    for n, key in enumerate(keys, 1):
        found = found.get(key, {})
        if not isinstance(found, dict):
            raise gltf.error(f"materials[{index}].{'.'.join(keys[:n])}", "an object", found)
    return found


def base_texture(gltf: Gltf, index: int) -> dict:
    """Which texture it has, by which coordinates; empty where it has none."""
    return _within(gltf, index, "pbrMetallicRoughness", "baseColorTexture")


def read_base_color(gltf: Gltf, index: int, notes: list[str]) -> tuple[Array, Array | None]:
    """Base colour (H, W, 3) sRGB and, where the material cuts holes, alpha (H, W) with its cutoff moved to 128.

    What is assumed is added to the notes.
    """
    material = material_of(gltf, index)
    coloring = {"baseColorFactor": [1.0] * 4} | _within(gltf, index, "pbrMetallicRoughness")
    factor = gltf.numbers(coloring, "baseColorFactor", f"materials[{index}].pbrMetallicRoughness", (4,))
    source = base_color_image(gltf, index)
    if source is not None:
        try:
            rgba = decode_picture(gltf.image(source), "RGBA", formats=WITH_WEBP)
        except ValueError as error:
            raise AssetError(f"{gltf.path}: images[{source}]: {error}") from None
    else:
        rgba = np.full((1, 1, 4), 255, np.uint8)
    color = rgba[..., :3]
    if not np.array_equal(factor[:3], [1, 1, 1]):  # the factor is linear, the texture sRGB
        linear = linear_from_srgb(np.arange(256) / 255)
        table = bytes_of(srgb_from_linear(linear[:, None] * factor[:3]))
        color = np.stack([table[color[..., c], c] for c in range(3)], -1)

    mode = material.get("alphaMode", "OPAQUE")
    if mode == "OPAQUE":
        return np.ascontiguousarray(color), None
    cutoff = material.get("alphaCutoff", 0.5) if mode == "MASK" else 0.5
    if type(cutoff) not in (int, float) or not 0 <= cutoff < 1e6:
        raise gltf.error(f"materials[{index}].alphaCutoff", "a number from 0", cutoff)
    if mode == "BLEND":
        notes.append(f"material {material.get('name', index)} blends: drawn with holes where alpha is below one half")
    opacity = rgba[..., 3] / 255 * factor[3]
    # piecewise linear, so that a bilinear sample passes 128 where the file's passes its cutoff
    moved = np.interp(opacity, [0, max(cutoff, 1e-6), max(1, cutoff + 1e-6)], [0, 128, 255])
    return np.ascontiguousarray(color), np.round(moved).astype(np.uint8)
