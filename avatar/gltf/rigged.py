"""A rigged humanoid glTF in pose 0: vertices, skin and joints of the 52, whatever its own skeleton.

Frame: pose 0 (T-pose), pelvis joint at the origin, +x the person's left, +y up, +z out of the chest, metres.

A glTF rig is re-expressed, exactly, as vertices, weights and joint positions in its bind pose:

    x = sum_k w_k world_k(pose) inverseBind_k x_file,   bind pose: world_k inverseBind_k = S for every k

S x_file are the vertices at rest and S inverseBind_k^-1 the joints' frames there, whatever scales and axes the
file keeps in its nodes (VALID characters keep their mesh normalised and their joints scaled by .01). With the
joint frames turned parallel to the world, the skin transform is SMPL's own, so skeleton.skin_transforms with a
zero rest pose drives the mesh exactly as the file's rig does.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.gltf.document import Gltf
from avatar.gltf.humanoid import find_joints
from avatar.gltf.scene import (
    base_texture,
    material_of,
    node_parents,
    nodes_of_scene,
    parents_first,
    primitives,
    read_primitive,
    read_skin,
    visible_nodes,
    world_from_node,
)
from avatar.rotation import axis_angle_from_matrix, rotation_between, unit_or_zero
from avatar.skeleton import JOINT_NUMBERS, JOINTS, skin_transforms
from avatar.skinning import SkinWeights, skin_points, strongest_four
from command.errors import AssetError

# an arm this close to horizontal is a T-pose as animators leave it: turning it would only stretch the shoulders
REST_ARM_DEGREES = 8.0


@dataclass(frozen=True)
class RiggedPart:
    """One primitive in the bind pose, in the file's world frame."""

    vertices: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]
    uv: Float[Array, "vertices 2"]
    weights: Float[Array, "vertices 52"]
    material: int  # glTF material, -1: none
    # names of node, mesh and material
    called: str


@dataclass(frozen=True)
class Rigged:
    """All of a file's parts as one person in pose 0."""

    parts: list[RiggedPart]
    # the vertices of all parts, one after the other
    vertices: Float[Array, "vertices 3"]
    skin: SkinWeights
    joints: Float[Array, "52 3"]
    # what was assumed in reading
    notes: list[str]


def read_rigged(gltf: Gltf) -> Rigged:
    """The triangles of a rigged humanoid, in pose 0.

    Raises:
        AssetError: the file is without a mesh, its rig lacks a joint, or a field is not as glTF has it.
    """
    path = gltf.path
    there = nodes_of_scene(gltf)
    named = [node if k else {} for node, k in zip(gltf.items("nodes"), there, strict=True)]
    joint_nodes, naming = find_joints(path, gltf.json | {"nodes": named})
    notes = [f"{naming} joint names"]
    rig = NodeTree(gltf, joint_nodes)
    bearers = [i for i, node in enumerate(named) if "mesh" in node]
    visible = visible_nodes(gltf)
    nodes = [i for i in bearers if visible[i]]
    if not there.all():
        notes.append(f"scene: the file's own choice of {len(gltf.items('scenes'))}, the others are left out")
    if len(nodes) < len(bearers):
        notes.append(f"hidden by KHR_node_visibility: {len(bearers) - len(nodes)} meshes are left out")
    nodes.sort(key=lambda i: "skin" not in gltf.items("nodes")[i])  # skins first: they say where bones are bound
    parts = [part for node in nodes for part in _read_mesh_node(rig, node)]
    if not parts:
        raise AssetError(f"{path}: meshes: expected visible triangles on the skeleton, found none")
    if any(mesh.get("weights") for mesh in gltf.items("meshes")):
        notes.append("morph targets are left at zero")

    bind, world = rig.bind, rig.world
    frames = np.stack([bind[node] if node in bind else world[node] for node in joint_nodes])
    unbound = [joint for joint, node in zip(JOINTS, joint_nodes, strict=True) if node not in bind]
    if unbound:
        notes.append(f"no inverse bind matrix for {', '.join(unbound)}: placed as its node stands")
    joints = frames[:, :3, 3]
    vertices = np.concatenate([part.vertices for part in parts])

    upright, turned = _upright(path, joints)
    if turned:
        notes.append(turned)
    joints = joints @ upright.T
    vertices = (vertices - frames[0, :3, 3]) @ upright.T
    joints = joints - joints[0]
    height = float(np.ptp(vertices[:, 1]))
    if not 0.5 < height < 3.0:
        raise AssetError(f"{path}: POSITION: expected a person 0.5 to 3 metres tall, found {height:.3g} metres")

    skin = strongest_four(np.concatenate([part.weights for part in parts]))
    vertices, joints, posed = _arms_horizontal(vertices, joints, skin)
    notes.append(posed)
    return Rigged(parts, vertices, skin, joints, notes)


class NodeTree:
    """The node tree of a file, and where its nodes stand in the bind pose."""

    def __init__(self, gltf: Gltf, joint_nodes: list[int]):
        self.gltf, self.joint_nodes = gltf, joint_nodes
        self.world = world_from_node(gltf)
        self.parent = node_parents(gltf)
        self.bind: dict[int, Array] = {}  # world_from_node in the bind pose, of the nodes that skins name
        # the joint that carries each node: itself or its nearest ancestor among the 52, else the pelvis
        self.joint_of_node = [0] * len(self.parent)
        for node in parents_first(self.parent):
            above = self.joint_of_node[self.parent[node]] if self.parent[node] >= 0 else 0
            self.joint_of_node[node] = joint_nodes.index(node) if node in joint_nodes else above

    def bind_skin(self, number: int) -> tuple[Float[Array, "4 4"], Int[Array, "joints"]]:
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

    def place_rigid(self, node: int) -> Float[Array, "4 4"]:
        """Where a mesh hung on a bone (a hat, an eye) is in the bind pose."""
        bone = node
        while bone >= 0 and bone not in self.bind:
            bone = int(self.parent[bone])
        if bone < 0:
            return self.world[node]
        return self.bind[bone] @ np.linalg.inv(self.world[bone]) @ self.world[node]


def _read_mesh_node(rig: NodeTree, node: int) -> list[RiggedPart]:
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
        texcoord = f"TEXCOORD_{base_texture(gltf, material).get('texCoord', 0)}"
        uv = attributes.get(texcoord, np.zeros((count, 2)))
        if uv.shape != (count, 2):
            raise gltf.error(f"{field}.{texcoord}", f"({count}, 2)", uv.shape)
        vertices = attributes["POSITION"].astype(np.float64) @ place[:3, :3].T + place[:3, 3]
        faces = primitive.faces.astype(np.int64)
        if np.linalg.det(place[:3, :3]) < 0:
            faces = faces[:, ::-1]
        names = (described, gltf.items("meshes")[number], material_of(gltf, material))
        called = " ".join(str(named.get("name", "")) for named in names)
        meshes.append(RiggedPart(vertices, faces, uv, weights, material, called))
    return meshes


def _upright(path: Path, joints: Float[Array, "52 3"]) -> tuple[Float[Array, "3 3"], str]:
    """The rotation that makes the skeleton face +z with +y up, and what was turned ("" if nothing).

    Only quarter turns: a rig that stands at an odd angle is not a T-pose we know how to read.
    """
    at = {name: joints[i] for i, name in enumerate(JOINTS)}
    left = at["left_hip"] - at["right_hip"] + at["left_shoulder"] - at["right_shoulder"]
    up = at["neck"] - at["pelvis"]
    found = np.stack([left, up]) / np.linalg.norm([left, up], axis=1, keepdims=True)
    snapped = np.round(found)
    cosines = (found * snapped).sum(1) / np.maximum(np.linalg.norm(snapped, axis=1), 1)
    off = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    if (np.abs(snapped).sum(1) != 1).any() or (off > 20).any() or abs(snapped[0] @ snapped[1]) > 0:
        raise AssetError(
            f"{path}: joints: expected a person standing along the axes, found left {np.round(found[0], 2)} "
            f"and up {np.round(found[1], 2)}"
        )
    rotation = np.stack([snapped[0], snapped[1], np.cross(snapped[0], snapped[1])])
    was = f"left was {snapped[0].astype(int)}, up was {snapped[1].astype(int)}"
    return rotation, "" if np.array_equal(rotation, np.eye(3)) else f"turned to face +z with +y up ({was})"


def _arms_horizontal(vertices, joints, skin: SkinWeights):
    """Pose 0 from the rest pose: arms along x, if they rest further from it than REST_ARM_DEGREES.

    Returns vertices, joints and a note. An A-pose is skinned to the T-pose with the rig's own weights; the upper arm,
    the forearm and the hand are each turned the shortest way.
    """
    pose = np.zeros((len(JOINTS), 3))
    worst = 0.0
    for side, outward in (("left", 1.0), ("right", -1.0)):
        chain = [JOINT_NUMBERS[f"{side}_{joint}"] for joint in ("shoulder", "elbow", "wrist", "middle1")]
        arm = joints[chain[2]] - joints[chain[0]]
        worst = max(worst, np.degrees(np.arctan2(abs(arm[1]), outward * arm[0])))
        accumulated = np.eye(3)
        for upper, lower in zip(chain, chain[1:], strict=False):
            bone = unit_or_zero(joints[lower] - joints[upper])
            # keep what the bone leans forward: only its fall below the horizontal is the A of an A-pose
            level = np.array([outward * np.sqrt(max(1 - bone[2] ** 2, 0)), 0.0, bone[2]])
            turn = rotation_between(bone, level)
            pose[upper] = axis_angle_from_matrix(accumulated.T @ turn)
            accumulated = turn
    if worst <= REST_ARM_DEGREES:
        return vertices, joints, f"arms rest {worst:.1f} degrees from horizontal: kept as pose 0"
    transforms = skin_transforms(pose, joints, rest=np.zeros((len(JOINTS), 3)))
    posed = np.einsum("kij,kj->ki", transforms[:, :3, :3], joints) + transforms[:, :3, 3]
    note = f"arms rested {worst:.0f} degrees from horizontal: skinned to a T-pose"
    return skin_points(vertices, skin, transforms), posed, note
