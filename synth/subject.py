"""A filmed person: a skinned, textured mesh in pose 0 with its own 52 joints, read from any humanoid glTF.

Frame: pose 0 (T-pose), pelvis joint at the origin, +x the subject's left, +y up, +z out of the chest, metres.

A glTF rig is re-expressed, exactly, as vertices, weights and joint positions in its bind pose:

    x = sum_k w_k world_k(pose) inverseBind_k x_file,   bind pose: world_k inverseBind_k = S for every k

S x_file are the vertices at rest and S inverseBind_k^-1 the joints' frames there, whatever scales and axes the
file keeps in its nodes (VALID characters keep their mesh normalised and their joints scaled by .01). With the
joint frames turned parallel to the world, the skin transform is SMPL's own, so skeleton.skin_transforms with a
zero rest pose drives the mesh exactly as the file's rig does.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from avatar.errors import AssetError
from avatar.gltf.document import Gltf, read_gltf
from avatar.gltf.scene import (
    node_parents,
    parents_first,
    primitives,
    read_primitive,
    read_skin,
    texture_image,
    world_from_node,
)
from avatar.picture import WITH_WEBP, decode_picture
from avatar.rotation import axis_angle_from_matrix, rotation_between
from avatar.skeleton import JOINTS, PARTS, skin_transforms
from avatar.skinning import SkinWeights, skin_points, strongest_four
from capture.imports.template import part_of
from synth.humanoid import find_joints

# an arm this close to horizontal is a T-pose as animators leave it: turning it would only stretch the shoulders
REST_ARM_DEGREES = 8.0
HAIR_NAME = re.compile(r"wig|hair|ponytail|afro|beard", re.IGNORECASE)
# eyeballs; lids, lashes, brows and glasses are called after the eye as well
EYE_NAME = re.compile(r"eyes?(balls?)?(?![a-z])", re.IGNORECASE)
HAIR_SIZE = (
    # metres: a mesh on the head alone and larger than this in two directions is no eye and no tooth
    0.10
)


@dataclass(frozen=True)
class SynthSubject:
    """One person as drawn, whatever it came from. Vertices may be repeated along texture seams."""

    name: str
    vertices: Float[np.ndarray, "vertices 3"]  # pose 0, float32
    faces: Int[np.ndarray, "faces 3"]
    uv: Float[np.ndarray, "vertices 2"]  # glTF: v runs down
    material: Int[np.ndarray, "faces"]  # index into textures
    textures: tuple[UInt8[np.ndarray, "_height _w 3"], ...]  # sRGB
    # 0 or 255 decided at 128; None: opaque
    alpha: tuple[UInt8[np.ndarray, "_h2 _w2"] | None, ...]
    skin: SkinWeights
    joints: Float[np.ndarray, "52 3"]  # float64
    part: UInt8[np.ndarray, "vertices"]  # see PARTS
    hair: Bool[np.ndarray, "vertices"]
    licence: str
    # what was assumed in reading, printed by the command
    notes: tuple[str, ...] = ()
    # vertices of the eyeballs; None: the file does not tell them apart
    eye: Bool[np.ndarray, "vertices"] | None = None


def read_subject(path: Path) -> SynthSubject:
    """Read a rigged humanoid .glb, .gltf or .vrm.

    Raises:
        AssetError: the file is unreadable, compressed, without a mesh, or its rig lacks a joint.
    """
    path = Path(path)
    gltf = read_gltf(path)
    joint_nodes, naming = find_joints(path, gltf.json)
    notes = [f"{naming} joint names"]
    rig = _NodeTree(gltf, joint_nodes)
    nodes = [i for i, node in enumerate(gltf.items("nodes")) if "mesh" in node]
    nodes.sort(key=lambda i: "skin" not in gltf.items("nodes")[i])  # skins first: they say where bones are bound
    meshes = [mesh for node in nodes for mesh in _read_mesh_node(rig, node)]
    if not meshes:
        raise AssetError(f"{path}: meshes: expected triangles on the skeleton, found none")
    if any(mesh.get("weights") for mesh in gltf.items("meshes")):
        notes.append("morph targets are left at zero")

    bind, world = rig.bind, rig.world
    frames = np.stack([bind[node] if node in bind else world[node] for node in joint_nodes])
    unbound = [joint for joint, node in zip(JOINTS, joint_nodes, strict=True) if node not in bind]
    if unbound:
        notes.append(f"no inverse bind matrix for {', '.join(unbound)}: placed as its node stands")
    joints = frames[:, :3, 3]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])

    upright, turned = _upright(path, joints)
    if turned:
        notes.append(turned)
    joints = joints @ upright.T
    vertices = (vertices - frames[0, :3, 3]) @ upright.T
    joints = joints - joints[0]
    height = float(np.ptp(vertices[:, 1]))
    if not 0.5 < height < 3.0:
        raise AssetError(f"{path}: POSITION: expected a person 0.5 to 3 metres tall, found {height:.3g} metres")

    skin = strongest_four(np.concatenate([mesh.weights for mesh in meshes]))
    vertices, joints, posed = _arms_horizontal(vertices, joints, skin)
    notes.append(posed)

    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, offsets, strict=False)])
    materials = sorted({mesh.material for mesh in meshes})
    textures, alpha = zip(*(_read_material(gltf, index, notes) for index in materials), strict=True)
    part = part_of(skin)
    hair = np.concatenate([np.full(len(mesh.vertices), mesh.hair) for mesh in meshes])
    eye = np.concatenate([np.full(len(mesh.vertices), mesh.eye) for mesh in meshes])
    part[hair] = PARTS.index("head")  # hair that hangs over the shoulders is measured with the head all the same
    subject = SynthSubject(
        name=path.stem,
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.int32),
        uv=np.concatenate([mesh.uv for mesh in meshes]).astype(np.float32),
        material=np.concatenate([np.full(len(mesh.faces), materials.index(mesh.material)) for mesh in meshes]).astype(
            np.int32
        ),
        textures=textures,
        alpha=alpha,
        skin=skin,
        joints=joints.astype(np.float32).astype(np.float64),
        part=part,
        hair=hair,
        licence=_licence(path, gltf),
        notes=tuple(notes),
        eye=eye if eye.any() else None,
    )
    return _as_made(gltf, subject)


def _as_made(gltf: Gltf, subject: SynthSubject) -> SynthSubject:
    """The subject in the order, with the hair and weights, that `asset.extras.selfscan` states.

    experiments/builtin/glb.py writes it; other files have none and stay as they are.
    """
    extras = gltf.json["asset"].get("extras")
    stated = extras.get("selfscan") if isinstance(extras, dict) else None
    if not isinstance(stated, dict):
        return subject
    fields = {}
    count = len(subject.vertices)
    shapes = {"vertices": (count,), "faces": (len(subject.faces),), "hair": (count,), "weights": (count, 4)}
    for name, shape in shapes.items():
        where = f"asset.extras.selfscan.{name}"
        values = fields[name] = gltf.accessor(stated.get(name), field=where)
        if values.shape != shape or values.dtype.kind != ("f" if name == "weights" else "u"):
            raise gltf.error(where, f"an array of {shape}", (values.shape, values.dtype.name))
        if name in ("vertices", "faces") and not np.array_equal(np.sort(values), np.arange(len(values))):
            raise gltf.error(where, f"each of 0 to {len(values) - 1} once", values[:8].tolist())
    if np.abs(fields["weights"] - subject.skin.weights).max() > 1e-6:
        raise gltf.error("asset.extras.selfscan.weights", "WEIGHTS_0", "others")
    # where each vertex and face of the made subject stands in the file
    vertices, faces = np.argsort(fields["vertices"]), np.argsort(fields["faces"])
    skin = SkinWeights(subject.skin.joints[vertices], fields["weights"][vertices])
    return replace(
        subject,
        vertices=subject.vertices[vertices],
        faces=fields["vertices"][subject.faces[faces]].astype(np.int32),
        uv=subject.uv[vertices],
        material=subject.material[faces],
        skin=skin,
        part=part_of(skin),
        hair=fields["hair"][vertices] > 0,
        eye=None if subject.eye is None else subject.eye[vertices],
    )


@dataclass(frozen=True)
class _Primitive:
    """One primitive in the bind pose, in the file's world frame."""

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    uv: Float[np.ndarray, "vertices 2"]
    weights: Float[np.ndarray, "vertices 52"]
    material: int  # glTF material, -1: none
    hair: bool
    eye: bool


class _NodeTree:
    """The node tree of a file while its meshes are read."""

    def __init__(self, gltf: Gltf, joint_nodes: list[int]):
        self.gltf, self.joint_nodes = gltf, joint_nodes
        self.world = world_from_node(gltf)
        self.parent = node_parents(gltf)
        self.bind: dict[int, np.ndarray] = {}  # world_from_node in the bind pose, of the nodes that skins name
        self.joint_of_node = self._nearest_joints()

    def _nearest_joints(self) -> list[int]:
        """The joint that carries each node: itself or its nearest ancestor among the 52, else the pelvis."""
        index = {node: joint for joint, node in enumerate(self.joint_nodes)}
        nearest = [-1] * len(self.parent)
        for node in parents_first(self.parent):
            above = self.parent[node]
            nearest[node] = index.get(node, nearest[above] if above >= 0 else 0)
        return nearest

    def bind_skin(self, number: int) -> tuple[Float[np.ndarray, "4 4"], Int[np.ndarray, "joints"]]:
        """Where a skin's mesh is placed in the bind pose (S), and the one of the 52 joints for each of its own.

        S is taken where another skin bound the same joint, else as the pelvis stands in the file.
        """
        skin = read_skin(self.gltf, number)
        field = f"skins[{number}].inverseBindMatrices"
        anchor = next((i for i, node in enumerate(skin.nodes) if node in self.bind), None)
        if anchor is None:
            anchor = skin.nodes.index(self.joint_nodes[0]) if self.joint_nodes[0] in skin.nodes else 0
        start = skin.nodes[anchor]
        place = self.bind.get(start, self.world[start]) @ skin.joint_from_mesh[anchor]
        for i, node in enumerate(skin.nodes):
            try:
                frame = place @ np.linalg.inv(skin.joint_from_mesh[i])
            except np.linalg.LinAlgError:
                raise self.gltf.error(f"{field}[{i}]", "invertible", skin.joint_from_mesh[i].tolist()) from None
            apart = np.linalg.norm(self.bind.setdefault(node, frame)[:3, 3] - frame[:3, 3])
            if node in self.joint_nodes and apart > 0.002:
                joint = JOINTS[self.joint_nodes.index(node)]
                raise self.gltf.error(field, "one bind pose", f"{joint} {100 * apart:.2f} cm from another skin's")
        return place, np.array([self.joint_of_node[node] for node in skin.nodes])

    def place_rigid(self, node: int) -> Float[np.ndarray, "4 4"]:
        """Where a mesh hung on a bone (a hat, an eye) is in the bind pose."""
        bone = node
        while bone >= 0 and bone not in self.bind:
            bone = int(self.parent[bone])
        if bone < 0:
            return self.world[node]
        return self.bind[bone] @ np.linalg.inv(self.world[bone]) @ self.world[node]


def _read_mesh_node(rig: _NodeTree, node: int) -> list[_Primitive]:
    """The triangles of a node, skinned or rigid, in the bind pose."""
    gltf, described = rig.gltf, rig.gltf.items("nodes")[node]
    number = gltf.index("meshes", described["mesh"], f"nodes[{node}].mesh")
    skinned = "skin" in described
    place, column = rig.bind_skin(described["skin"]) if skinned else (rig.place_rigid(node), np.zeros(1, np.int64))
    meshes = []
    for i in range(len(primitives(gltf, number))):
        field = f"meshes[{number}].primitives[{i}]"
        primitive = read_primitive(gltf, number, i)
        attributes = primitive.attributes
        count = len(attributes["POSITION"])
        weights = np.zeros((count, len(JOINTS)))
        if skinned:
            if "JOINTS_0" not in attributes or "WEIGHTS_0" not in attributes:
                raise gltf.error(f"{field}.attributes", "with JOINTS_0 and WEIGHTS_0", sorted(attributes))
            for k in range(8):
                if f"JOINTS_{k}" not in attributes or f"WEIGHTS_{k}" not in attributes:
                    break
                index = attributes[f"JOINTS_{k}"].astype(np.int64)
                weight = attributes[f"WEIGHTS_{k}"].astype(np.float64)
                if index.shape != (count, 4) or weight.shape != (count, 4):
                    raise gltf.error(f"{field}.WEIGHTS_{k}", f"({count}, 4)", weight.shape)
                if index.max() >= len(column):
                    raise gltf.error(f"{field}.JOINTS_{k}", f"joints below {len(column)}", int(index.max()))
                np.add.at(weights, (np.arange(count)[:, None], column[index]), weight)
            total = weights.sum(1)
            if (weights < 0).any() or (total < 1e-6).any():
                raise gltf.error(f"{field}.WEIGHTS_0", "positive on every vertex", float(total.min()))
            weights /= total[:, None]
        else:
            weights[:, rig.joint_of_node[node]] = 1
        material = -1 if primitive.material is None else primitive.material
        texcoord = f"TEXCOORD_{_base_texture(gltf, material).get('texCoord', 0)}"
        uv = attributes.get(texcoord, np.zeros((count, 2)))
        if uv.shape != (count, 2):
            raise gltf.error(f"{field}.{texcoord}", f"({count}, 2)", uv.shape)
        vertices = attributes["POSITION"].astype(np.float64) @ place[:3, :3].T + place[:3, 3]
        faces = primitive.faces.astype(np.int64)
        if np.linalg.det(place[:3, :3]) < 0:
            faces = faces[:, ::-1]
        names = (described, gltf.items("meshes")[number], _material(gltf, material))
        called = " ".join(str(named.get("name", "")) for named in names)
        hair = _is_hair(called, vertices, weights)
        meshes.append(_Primitive(vertices, faces, uv, weights, material, hair, _is_eye(called, hair, weights)))
    return meshes


def _is_hair(name: str, vertices: Float[np.ndarray, "vertices 3"], weights: Float[np.ndarray, "vertices 52"]) -> bool:
    """Whether a mesh is hair: it is called so, or it moves with the head alone and is too large for an eye."""
    on_head = weights[:, JOINTS.index("head")].mean() > 0.9
    second_extent = np.sort(np.ptp(vertices, axis=0))[1]
    return bool(HAIR_NAME.search(name)) or bool(on_head and second_extent > HAIR_SIZE)


def _is_eye(name: str, hair: bool, weights: Float[np.ndarray, "vertices 52"]) -> bool:
    """Whether a mesh is eyeballs: it is called so and moves with the head alone."""
    return not hair and bool(EYE_NAME.search(name)) and bool(weights[:, JOINTS.index("head")].mean() > 0.9)


def _upright(path: Path, joints: Float[np.ndarray, "52 3"]) -> tuple[Float[np.ndarray, "3 3"], str]:
    """The rotation that makes the skeleton face +z with +y up, and what was turned ("" if nothing).

    Only quarter turns: a rig that stands at an odd angle is not a T-pose we know how to read.
    """
    at = {name: joints[i] for i, name in enumerate(JOINTS)}
    left = at["left_hip"] - at["right_hip"] + at["left_shoulder"] - at["right_shoulder"]
    up = at["neck"] - at["pelvis"]
    found = np.stack([left, up]) / np.linalg.norm([left, up], axis=1, keepdims=True)
    snapped = np.round(found)
    off = np.degrees(
        np.arccos(np.clip((found * snapped).sum(1) / np.maximum(np.linalg.norm(snapped, axis=1), 1), -1, 1))
    )
    if (np.abs(snapped).sum(1) != 1).any() or (off > 20).any() or abs(snapped[0] @ snapped[1]) > 0:
        raise AssetError(
            f"{path}: joints: expected a person standing along the axes, found left {np.round(found[0], 2)} "
            f"and up {np.round(found[1], 2)}"
        )
    rotation = np.stack([snapped[0], snapped[1], np.cross(snapped[0], snapped[1])])
    if np.array_equal(rotation, np.eye(3)):
        return rotation, ""
    return (
        rotation,
        f"turned to face +z with +y up (left was {snapped[0].astype(int)}, up was {snapped[1].astype(int)})",
    )


def _arms_horizontal(vertices, joints, skin: SkinWeights):
    """Pose 0 from the rest pose: arms along x, if they rest further from it than REST_ARM_DEGREES.

    Returns vertices, joints and a note. An A-pose is skinned to the T-pose with the rig's own weights; the
    upper arm, the forearm and the hand are each turned the shortest way.
    """
    number = {name: i for i, name in enumerate(JOINTS)}
    pose = np.zeros((len(JOINTS), 3))
    worst = 0.0
    for side, outward in (("left", 1.0), ("right", -1.0)):
        chain = [number[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist", "middle1")]
        arm = joints[chain[2]] - joints[chain[0]]
        worst = max(worst, np.degrees(np.arctan2(abs(arm[1]), outward * arm[0])))
        accumulated = np.eye(3)
        for upper, lower in zip(chain, chain[1:], strict=False):
            bone = joints[lower] - joints[upper]
            bone = bone / np.linalg.norm(bone)
            # keep what the bone leans forward: only its fall below the horizontal is the A of an A-pose
            level = np.array([outward * np.sqrt(max(1 - bone[2] ** 2, 0)), 0.0, bone[2]])
            turn = rotation_between(bone, level)
            pose[upper] = axis_angle_from_matrix(accumulated.T @ turn)
            accumulated = turn
    if worst <= REST_ARM_DEGREES:
        return vertices, joints, f"arms rest {worst:.1f} degrees from horizontal: kept as pose 0"
    transforms = skin_transforms(pose, joints, rest=np.zeros((len(JOINTS), 3)))
    posed = np.einsum("kij,kj->ki", transforms[:, :3, :3], joints) + transforms[:, :3, 3]
    return (
        skin_points(vertices, skin, transforms),
        posed,
        f"arms rested {worst:.0f} degrees from horizontal: skinned to a T-pose",
    )


def _material(gltf: Gltf, index: int) -> dict:
    return gltf.items("materials")[index] if index >= 0 else {}


def _within(gltf: Gltf, index: int, *keys: str) -> dict:
    """An object inside a material, empty where the file has none."""
    found = _material(gltf, index)
    for key in keys:
        found = found.get(key, {})
        if not isinstance(found, dict):
            raise gltf.error(f"materials[{index}].{key}", "an object", found)
    return found


def _base_texture(gltf: Gltf, index: int) -> dict:
    return _within(gltf, index, "pbrMetallicRoughness", "baseColorTexture")


def _read_material(gltf: Gltf, index: int, notes: list[str]) -> tuple[np.ndarray, np.ndarray | None]:
    """Base colour (H, W, 3) sRGB and, where the material cuts holes, alpha (H, W) with its cutoff moved to 128."""
    material = _material(gltf, index)
    described = _base_texture(gltf, index)
    coloring = _within(gltf, index, "pbrMetallicRoughness")
    factor = np.ones(4)
    if "baseColorFactor" in coloring:
        factor = gltf.numbers(coloring, "baseColorFactor", f"materials[{index}].pbrMetallicRoughness", (4,))
    if "KHR_texture_transform" in gltf.extensions(described, f"materials[{index}].baseColorTexture"):
        raise AssetError(
            f"{gltf.path}: materials[{index}]: expected plain texture coordinates, found KHR_texture_transform; "
            "bake it with a glTF tool first"
        )
    if "index" in described:
        source = texture_image(gltf, described["index"], field=f"materials[{index}].baseColorTexture.index")
        data, _mime = gltf.image(source)
        try:
            rgba = decode_picture(data, "RGBA", formats=WITH_WEBP)
        except ValueError as error:
            raise AssetError(f"{gltf.path}: images[{source}]: {error}") from None
    else:
        rgba = np.full((1, 1, 4), 255, np.uint8)
    color = rgba[..., :3]
    if not np.array_equal(factor[:3], [1, 1, 1]):  # the factor is linear, the texture sRGB
        steps = np.arange(256) / 255
        linear = np.where(steps <= 0.04045, steps / 12.92, ((steps + 0.055) / 1.055) ** 2.4)
        scaled = np.clip(linear[:, None] * factor[:3], 0, 1)
        encoded = np.where(scaled <= 0.0031308, 12.92 * scaled, 1.055 * scaled ** (1 / 2.4) - 0.055)
        table = np.round(255 * encoded).astype(np.uint8)
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


def _licence(path: Path, gltf: Gltf) -> str:
    """What the file says of its licence, else the first two lines (name, holder) of a LICENSE beside it."""
    copyright_line = gltf.json["asset"].get("copyright", "")
    if copyright_line:
        return str(copyright_line)
    beside = path.parent / "LICENSE"
    if beside.is_file():
        lines = [line.strip() for line in beside.read_text(errors="replace").splitlines()]
        return "; ".join([line for line in lines if line][:2]) or "not stated"
    return "not stated"
