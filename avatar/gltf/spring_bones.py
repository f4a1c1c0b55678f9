"""Loose hair and skirts as chains of joints that VRM's spring bones swing.

An avatar's file marks loose vertices one by one. Each connected piece of them that head or trunk holds is hung on
chains around its holder, one to a sector of 45 degrees, LINKS joints from its top to its hem. A vertex gives the
chains nearest to it part of its skin weights, by its looseness. The file at rest stays as it is: what a joint of a
chain moves is bound where the mean of its vertices' own skinning puts it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Integer
from numpy import ndarray as Array

from avatar.baked_avatar import Avatar
from avatar.gltf.document import Gltf
from avatar.gltf.scene import read_primitive, read_skin, world_from_node
from avatar.skeleton import JOINTS
from avatar.skinning import SkinWeights, blended_transforms, strongest_four
from files.input_file import JsonObject

# joints of a chain; sectors around a holder, and how far a chain's pull reaches aside, radians
LINKS, SECTORS, ASIDE = 3, 8, np.pi / 10
# share of a wholly loose vertex's weight that its chains take: the rest stays skin, so that legs keep under a skirt
SHARE = 0.6
# metres from top to hem, and vertices of a sector, that a chain begins to be worth
LONG, FEW = 0.06, 8
# what may hold a piece, by the joint that its vertices follow
HOLDERS = {JOINTS.index(name): JOINTS.index(name) for name in ("pelvis", "spine1", "spine2", "spine3", "neck", "head")}
HOLDERS |= {JOINTS.index(name): 0 for name in ("left_hip", "right_hip", "left_knee", "right_knee")}
# from joint to joint, what chains keep off: thighs, shins, chest, shoulders, neck
SOLID = (("left_hip", "left_knee"), ("right_hip", "right_knee"), ("left_knee", "left_ankle"),
         ("right_knee", "right_ankle"), ("spine3", "neck"), ("left_collar", "left_shoulder"),
         ("right_collar", "right_shoulder"), ("neck", "head"))  # fmt: skip
# what each joint of a chain has, in VRM's units; metres
STIFFNESS, DRAG, GRAVITY, HIT = 1.0, 0.4, 0.1, 0.01
# spheres that stand for a capsule in VRM 0.x
SPHERES = 4


class HungChain(NamedTuple):
    """Joints from top to hem, and the end of the last."""

    holder: int  # the file's joint that the first hangs on
    places: Float[Array, "ends 3"]  # LINKS + 1, where the mesh is stored
    pull: Float[Array, "vertices"]  # [0, 1], how much of a loose vertex is this chain's


class SpringBones(NamedTuple):
    """Chains as a file has them at rest: T-pose, metres, the pelvis where the file puts it."""

    holders: Int[Array, "chains"]
    places: Float[Array, "chains ends 3"]
    joint_from_mesh: Float[Array, "joints 4 4"]  # inverse binds, chain after chain
    skin: SkinWeights  # all vertices; joints of chains follow those of the file
    solid: list[tuple[int, int, float]]  # joint, next joint, radius

    def add_nodes(self, nodes: list[JsonObject], joints: list[int], at: Float[Array, "52 3"]) -> list[list[int]]:
        """Append the nodes of each chain, its end last, and hang it on its holder; `at`: where the file's joints are.

        The joints join the skin's list `joints`; the nodes of each chain are returned.
        """
        chains = []
        for holder, places in zip(self.holders.tolist(), self.places, strict=True):
            first, above = len(nodes), at[holder]
            nodes[joints[holder]].setdefault("children", []).append(first)
            for link, place in enumerate(places):
                node: JsonObject = {"name": f"spring_{len(chains)}_{link}", "translation": (place - above).tolist()}
                nodes.append(node | ({"children": [len(nodes) + 1]} if link < LINKS else {}))
                above = place
            chains.append(list(range(first, len(nodes))))
        for chain in chains:
            joints += chain[:-1]
        return chains


def spring_bones(gltf: Gltf, avatar: Avatar) -> SpringBones | None:
    """The chains of an avatar file's finest mesh; None: nothing of it hangs from head or trunk."""
    level, skin = avatar.levels[0], read_skin(gltf, 0)
    if level.loose is None:
        return None
    arrays = read_primitive(gltf, 0).attributes
    points, own = arrays["POSITION"].astype(np.float64), len(skin.nodes)
    weights = np.zeros((len(points), own))
    np.add.at(weights, (np.arange(len(points))[:, None], arrays["JOINTS_0"]), arrays["WEIGHTS_0"])
    bind = np.linalg.inv(skin.joint_from_mesh)[:, :3, 3]
    loose = level.loose.astype(np.float64)
    chains = [
        chain for piece in loose_pieces(level.positions, level.faces, loose > 0)
        if (holder := holder_of(weights[piece, : len(JOINTS)], loose[piece])) is not None
        for chain in hung_chains(points, piece, holder, bind[holder])
    ]  # fmt: skip
    if not chains:
        return None
    pulls = np.stack([chain.pull for chain in chains], 1)
    taken = np.stack([_along(points[:, 1], chain.places[:, 1]) for chain in chains], 1) * pulls[..., None]
    taken = SHARE * loose[:, None] * taken.reshape(len(points), -1)
    whole = strongest_four(np.concatenate([weights * (1 - taken.sum(1, keepdims=True)), taken], 1))
    # where the vertices of each joint stand at rest
    world = world_from_node(gltf)
    rest = world[list(skin.nodes)] @ skin.joint_from_mesh
    joints, shares = arrays["JOINTS_0"].astype(np.int64), arrays["WEIGHTS_0"]
    moved = blended_transforms(SkinWeights(joints, shares), rest).reshape(len(points), 16)
    moved = ((taken.T @ moved) / np.maximum(taken.sum(0), 1e-9)[:, None]).reshape(len(chains), LINKS, 4, 4)
    ends = np.concatenate([moved, moved[:, -1:]], 1)
    places = np.stack([chain.places for chain in chains])
    places = np.einsum("ceij,cej->cei", ends[..., :3, :3], places) + ends[..., :3, 3]
    binds = moved.copy()
    binds[..., :3, 3] -= places[:, :LINKS]
    stand = world[list(skin.nodes)][:52, :3, 3]
    solid = solid_capsules(points[loose == 0], weights[loose == 0], bind, stand, places)
    return SpringBones(np.array([chain.holder for chain in chains]), places, binds.reshape(-1, 4, 4), whole, solid)


def loose_pieces(
    positions: Float[Array, "vertices 3"], faces: Integer[Array, "faces 3"], loose: Bool[Array, "vertices"]
) -> list[Int[Array, "own"]]:
    """Vertices of each connected piece of loose ones; those at one place are one, whatever charts divide them."""
    _, place = np.unique(positions, axis=0, return_inverse=True)
    place = place.reshape(-1)
    whole = place[faces[loose[faces].all(1)]]
    label, before = np.arange(place.max() + 1), None
    while before is None or (label != before).any():
        before, least = label, label.copy()
        np.minimum.at(least, whole, label[whole].min(1, keepdims=True))
        label = least[least]
    piece = np.where(loose, label[place], -1)
    return [np.flatnonzero(piece == one) for one in np.unique(piece[loose])]


def holder_of(weights: Float[Array, "own joints"], loose: Float[Array, "own"]) -> int | None:
    """The joint that holds a piece, where it is least loose; None: an arm does."""
    followed = int(((1.01 - loose) @ weights).argmax())
    return HOLDERS.get(followed)


def hung_chains(
    points: Float[Array, "vertices 3"], piece: Int[Array, "own"], holder: int, axis: Float[Array, "3"]
) -> list[HungChain]:
    """The chains of one piece, around the vertical through its holder."""
    own, found = points[piece], []
    angle = np.arctan2(own[:, 0] - axis[0], own[:, 2] - axis[2])
    for middle in np.arange(SECTORS) * 2 * np.pi / SECTORS:
        beside = np.abs((angle - middle + np.pi) % (2 * np.pi) - np.pi)
        there = own[beside < np.pi / SECTORS]
        if len(there) < FEW or np.ptp(there[:, 1]) < LONG:
            continue
        heights = np.linspace(there[:, 1].max(), there[:, 1].min(), LINKS + 1)
        near = np.exp(-np.square((there[:, 1] - heights[:, None]) * LINKS / np.ptp(there[:, 1])))
        places = (near @ there) / near.sum(1, keepdims=True)
        places[:, 1] = heights
        found.append((places, np.exp(-np.square(beside / ASIDE)) + 1e-12))
    total = sum(pull for _, pull in found)
    chains = []
    for places, pull in found:
        whole = np.zeros(len(points))
        whole[piece] = pull / total
        chains.append(HungChain(holder, places, whole))
    return chains


def _along(height: Float[Array, "vertices"], ends: Float[Array, "ends"]) -> Float[Array, "vertices LINKS"]:
    """How much each link of a chain has of vertices at these heights: all of it at its middle, linear between."""
    link = np.clip((ends[0] - height) / (ends[0] - ends[-1]) * LINKS - 0.5, 0, LINKS - 1)
    return np.maximum(0, 1 - np.abs(link[:, None] - np.arange(LINKS)))


def solid_capsules(
    points: Float[Array, "skin 3"], weights: Float[Array, "skin joints"], bind: Float[Array, "joints 3"],
    stand: Float[Array, "52 3"], places: Float[Array, "chains ends 3"],
) -> list[tuple[int, int, float]]:  # fmt: skip
    """Joint, next joint and radius of what chains keep off: as thick as the body, but off every chain at rest.

    `bind` are the joints where the mesh is stored, `stand` those at rest, as `places` are.
    """
    found, heaviest = [], weights.argmax(1)
    for names in SOLID:
        joint, end = (JOINTS.index(name) for name in names)
        around = points[heaviest == joint]
        if len(around):
            thick = float(np.median(_segment_distance(around, bind[joint], bind[end])))
            free = float(_segment_distance(places.reshape(-1, 3), stand[joint], stand[end]).min()) - HIT
            if min(thick, free) > HIT:
                found.append((joint, end, min(thick, free)))
    return found


def _segment_distance(points: Float[Array, "n 3"], a: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, "n"]:
    way = b - a
    share = np.clip((points - a) @ way / max(float(way @ way), 1e-12), 0, 1)
    return np.linalg.norm(points - a - share[:, None] * way, axis=1)


def spring_extension(springs: SpringBones, chains: list[list[int]], joints: list[int], at: Array) -> JsonObject:
    """VRMC_springBone 1.0 of the nodes of each chain; `at`: where the file's joints are at rest, unturned."""
    each = {"hitRadius": HIT, "stiffness": STIFFNESS, "gravityPower": GRAVITY, "dragForce": DRAG}
    colliders = [
        {"node": joints[joint],
         "shape": {"capsule": {"offset": [0, 0, 0], "radius": radius, "tail": (at[end] - at[joint]).tolist()}}}
        for joint, end, radius in springs.solid
    ]  # fmt: skip
    groups = [{"name": "body", "colliders": list(range(len(colliders)))}] if colliders else []
    extension: JsonObject = {
        "specVersion": "1.0",
        "springs": [
            {"joints": [*({"node": node, **each} for node in chain[:-1]), {"node": chain[-1]}]}
            | ({"colliderGroups": [0]} if groups else {})
            for chain in chains
        ],
    }
    return extension | ({"colliders": colliders, "colliderGroups": groups} if groups else {})


def earlier_springs(springs: SpringBones, chains: list[list[int]], joints: list[int], at: Array) -> JsonObject:
    """`secondaryAnimation` of VRM 0.x, which knows spheres alone; places in Unity's frame, x to the person's right."""
    colliders = []
    for joint, end, radius in springs.solid:
        centers = np.linspace(0, 1, SPHERES)[:, None] * (at[end] - at[joint])
        spheres = [{"offset": {"x": -x, "y": y, "z": z}, "radius": radius} for x, y, z in centers.tolist()]
        colliders.append({"node": joints[joint], "colliders": spheres})
    # the specification spells it so
    group = {
        "stiffiness": STIFFNESS, "gravityPower": GRAVITY, "gravityDir": {"x": 0, "y": -1, "z": 0}, "dragForce": DRAG,
        "center": -1, "hitRadius": HIT, "bones": [chain[0] for chain in chains],
        "colliderGroups": list(range(len(colliders))),
    }  # fmt: skip
    return {"boneGroups": [group], "colliderGroups": colliders}
