"""The spring bones of a .vrm as the file tells them: `secondaryAnimation` of VRM 0.x, `VRMC_springBone` of VRM 1.0.

VRM 1.0 lists the joints of each chain; the last is only the tail of the one before. VRM 0.x lists roots: all nodes
below swing, each towards its first child, and one without children towards a point TIP beyond it. Units: metres, in
the coordinates of the node that is named, except gravity, which is the world's.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from avatar.gltf.document import Gltf
from avatar.gltf.scene import node_parents
from avatar.springs import MOST_COLLIDERS, STRONGEST

# metres beyond a last joint of VRM 0.x
TIP = 0.07
# what a file that is silent means, as VRMC_springBone 1.0 has it
STIFFNESS, DRAG, DOWN = 1.0, 0.5, (0.0, -1.0, 0.0)
# metres
LARGEST = 100.0


class SpringBone(NamedTuple):
    """One node that swings."""

    node: int
    # the node at its other end; -1: a point TIP beyond
    tail: int
    stiffness: float
    drag: float
    gravity: Float[np.ndarray, "3"]
    radius: float
    # which entry of `SpringBones.centers` and `heeded` it goes by
    chain: int


class Collider(NamedTuple):
    """A capsule on a node, in its coordinates; a sphere where both ends are one."""

    node: int
    start: Float[np.ndarray, "3"]
    end: Float[np.ndarray, "3"]
    radius: float


class SpringBones(NamedTuple):
    """All of a file. Each node swings once."""

    bones: list[SpringBone]
    colliders: list[Collider]
    # of each chain: the node of its centre space, -1: the world's; and the colliders that it heeds
    centers: list[int]
    heeded: list[list[int]]
    # what was left out
    notes: list[str]


def read_spring_bones(gltf: Gltf) -> SpringBones | None:
    """The spring bones of a file; None: it tells of none.

    Raises:
        AssetError: a node that is not there, chains that do not go down the tree, a number that cannot be.
    """
    extensions = gltf.extensions(gltf.json, "glTF")
    if "VRMC_springBone" in extensions:
        found = _Reader(gltf, "extensions.VRMC_springBone").version_1(extensions["VRMC_springBone"])
    elif isinstance(extensions.get("VRM"), dict) and "secondaryAnimation" in extensions["VRM"]:
        told = extensions["VRM"]["secondaryAnimation"]
        found = _Reader(gltf, "extensions.VRM.secondaryAnimation").version_0(told)
    else:
        return None
    return found if found.bones else None


class _Reader:
    """Reads one extension of one file."""

    def __init__(self, gltf: Gltf, where: str):
        self.gltf, self.where = gltf, where
        self.parents: Int[np.ndarray, "nodes"] = node_parents(gltf)
        self.out = SpringBones([], [], [], [], [])
        self.taken: set[int] = set()
        self.twice = 0

    def version_1(self, told: Any) -> SpringBones:
        where = self.where
        whole = self._object(told, where)
        for k, item in enumerate(self._list(whole, "colliders", where)):
            self.out.colliders.append(self._shape(self._object(item, f"{where}.colliders[{k}]"), k))
        groups = self._list(whole, "colliderGroups", where)
        of_group = [
            self._indices(group, "colliders", f"{where}.colliderGroups[{k}]", len(self.out.colliders))
            for k, group in enumerate(groups)
        ]
        for k, spring in enumerate(self._list(whole, "springs", where)):
            at = f"{where}.springs[{k}]"
            chain = self._chain(spring, at, of_group)
            joints = [self._object(j, f"{at}.joints[{i}]") for i, j in enumerate(self._list(spring, "joints", at))]
            nodes = [self._node(joint.get("node"), f"{at}.joints[{i}].node") for i, joint in enumerate(joints)]
            for i in range(len(nodes) - 1):
                if not self._below(nodes[i + 1], nodes[i]):
                    raise self.gltf.error(f"{at}.joints[{i + 1}].node", f"below node {nodes[i]}", nodes[i + 1])
                self._add(nodes[i], nodes[i + 1], joints[i], f"{at}.joints[{i}]", chain, "stiffness")
        return self._finished()

    def version_0(self, told: Any) -> SpringBones:
        where = self.where
        whole = self._object(told, where)
        of_group: list[list[int]] = []
        for k, item in enumerate(self._list(whole, "colliderGroups", where)):
            at = f"{where}.colliderGroups[{k}]"
            group = self._object(item, at)
            spheres = self._list(group, "colliders", at)
            node = self._node(group.get("node"), f"{at}.node") if spheres else -1
            of_group.append([])
            for i, sphere in enumerate(spheres):
                field = f"{at}.colliders[{i}]"
                sphere = self._object(sphere, field)
                # VRM 0.x has the z of offsets the other way round than glTF
                center = self._xyz(sphere, "offset", field, (0.0, 0.0, 0.0)) * [1, 1, -1]
                of_group[-1].append(len(self.out.colliders))
                radius = self._number(sphere, "radius", field, 0.0, LARGEST, 0.0)
                self.out.colliders.append(Collider(node, center, center, radius))
        children: list[list[int]] = [
            [self._node(child, "children") for child in node.get("children", [])] for node in self.gltf.items("nodes")
        ]
        for k, item in enumerate(self._list(whole, "boneGroups", where)):
            at = f"{where}.boneGroups[{k}]"
            group = self._object(item, at)
            chain = self._chain(group, at, of_group)
            todo = self._indices(group, "bones", at, len(self.parents))[::-1]
            while todo:
                node = todo.pop()
                below = children[node]
                self._add(node, below[0] if below else -1, group, at, chain, "stiffiness")
                todo += below[::-1]
        return self._finished()

    def _finished(self) -> SpringBones:
        out = self.out
        if self.twice:
            out.notes.append(f"{self.twice} spring bones are named twice: the first counts")
        if len(out.colliders) > MOST_COLLIDERS:
            out.notes.append(f"{len(out.colliders)} colliders of spring bones: the first {MOST_COLLIDERS} count")
        return out

    def _chain(self, spring: Any, at: str, of_group: list[list[int]]) -> int:
        """The number of a new chain: its centre and colliders."""
        spring = self._object(spring, at)
        center = spring.get("center", -1)
        heeded: list[int] = []
        for group in self._indices(spring, "colliderGroups", at, len(of_group)):
            heeded += of_group[group]
        # VRM 0.x says -1 for none
        self.out.centers.append(-1 if center in (-1, None) else self._node(center, f"{at}.center"))
        self.out.heeded.append(heeded)
        return len(self.out.centers) - 1

    def _add(self, node: int, tail: int, joint: dict, at: str, chain: int, stiffness: str) -> None:
        power = self._number(joint, "gravityPower", at, -STRONGEST, STRONGEST, 0.0)
        direction = self._xyz(joint, "gravityDir", at, DOWN)
        bone = SpringBone(
            node, tail, self._number(joint, stiffness, at, 0.0, STRONGEST, STIFFNESS),
            self._number(joint, "dragForce", at, 0.0, 1.0, DRAG), power * direction,
            self._number(joint, "hitRadius", at, 0.0, LARGEST, 0.0), chain,
        )  # fmt: skip
        if node in self.taken:
            self.twice += 1
            return
        self.taken.add(node)
        self.out.bones.append(bone)

    def _shape(self, item: dict, k: int) -> Collider:
        at = f"{self.where}.colliders[{k}].shape"
        shape = self._object(item.get("shape"), at)
        kind = "capsule" if "capsule" in shape else "sphere"
        described, field = self._object(shape.get(kind), f"{at}.{kind}"), f"{at}.{kind}"
        start = self._xyz(described, "offset", field, (0.0, 0.0, 0.0))
        end = self._xyz(described, "tail", field, (0.0, 0.0, 0.0)) if kind == "capsule" else start
        node = self._node(item.get("node"), f"{self.where}.colliders[{k}].node")
        return Collider(node, start, end, self._number(described, "radius", field, 0.0, LARGEST, 0.0))

    def _below(self, node: int, above: int) -> bool:
        while node >= 0 and node != above:
            node = int(self.parents[node])
            if node == above:
                return True
        return False

    def _node(self, index: object, field: str) -> int:
        return self.gltf.index("nodes", index, field)

    def _object(self, value: Any, field: str) -> dict:
        if not isinstance(value, dict):
            raise self.gltf.error(field, "an object", value)
        return value

    def _list(self, holder: Any, key: str, field: str) -> list:
        value = self._object(holder, field).get(key, [])
        if not isinstance(value, list):
            raise self.gltf.error(f"{field}.{key}", "a list", value)
        return value

    def _indices(self, holder: Any, key: str, field: str, count: int) -> list[int]:
        found = self._list(holder, key, field)
        for value in found:
            if type(value) is not int or not 0 <= value < count:
                raise self.gltf.error(f"{field}.{key}", f"indices below {count}", value)
        return list(found)

    def _number(self, holder: dict, key: str, field: str, low: float, high: float, default: float) -> float:
        value = holder.get(key, default)
        if type(value) not in (int, float) or not low <= value <= high:
            raise self.gltf.error(f"{field}.{key}", f"a number from {low:g} to {high:g}", value)
        return float(value)

    def _xyz(self, holder: dict, key: str, field: str, default: tuple[float, float, float]) -> np.ndarray:
        """Three numbers: a list in VRM 1.0, an object of x, y, z in VRM 0.x."""
        value = holder.get(key, list(default))
        listed = [value.get(axis, 0.0) for axis in "xyz"] if isinstance(value, dict) else value
        right = isinstance(listed, list) and len(listed) == 3
        if not right or not all(type(v) in (int, float) and abs(v) <= LARGEST for v in listed):
            raise self.gltf.error(f"{field}.{key}", f"three numbers up to {LARGEST:g}", value)
        return np.array(listed, np.float64)
