"""A .vrm as an avatar: its person in pose 0 on the 52 joints, its textures in one, its spring bones.

Nothing was trained or baked: it is drawn in its base colour, as it is (no view dependence, no toon shading, no
expressions). Materials become one texture; what they cut away is left out triangle by triangle.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image

from avatar.baked_avatar import Avatar, Level, check_avatar
from avatar.errors import AssetError
from avatar.gltf.base_color import material_of, read_base_color
from avatar.gltf.document import Gltf
from avatar.gltf.rigged import Rigged, read_rigged
from avatar.gltf.scene import parents_first
from avatar.gltf.spring_bones import TIP, SpringBones, read_spring_bones
from avatar.skinning import SkinWeights
from avatar.springs import MOST_BONES, MOST_COLLIDERS, Springs

# pixels: of the texture of all materials, and of the rim round each that mipmaps mix in
TEXTURE, RIM = 4096, 8
# metres: a shorter bone has no direction
SHORTEST = 1e-5
# vertices looked at at once
CHUNK = 4096


class Atlas(NamedTuple):
    """The textures of all materials in one, in cells of a grid."""

    pixels: UInt8[np.ndarray, "height width 3"]
    # of each material: where its texture's corner lies and how large it is, parts of the whole; u, v
    corners: Float[np.ndarray, "materials 2"]
    sizes: Float[np.ndarray, "materials 2"]


def read_vrm(gltf: Gltf) -> Avatar:
    """The person of a .vrm.

    Raises:
        AssetError: the file is not as it should be, or its rig lacks a joint.
    """
    rigged = read_rigged(gltf)
    notes, parts = rigged.notes, rigged.parts
    materials = sorted({part.material for part in parts})
    pictures = [read_base_color(gltf, index, notes) for index in materials]
    atlas = texture_atlas([color for color, _ in pictures])
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces, uv, copied, clipped, left_out = [], [], [], 0, 0
    for part, start in zip(parts, starts, strict=False):
        number = materials.index(part.material)
        turned = part.uv - np.floor(part.uv.min(0) + 1e-4)
        clipped += int(((turned < -0.01) | (turned > 1.01)).any())
        turned = np.clip(turned, 0, 1)
        there = _opaque(part.faces, turned, pictures[number][1])
        left_out += int((~there).sum())
        faces.append(part.faces[there] + start)
        uv.append(atlas.corners[number] + turned * atlas.sizes[number])
        if material_of(gltf, part.material).get("doubleSided") is True:
            copied.append(faces[-1])
    if left_out:
        notes.append(f"{left_out} triangles lie in holes of their material: left out")
    if clipped:
        notes.append(f"{clipped} meshes repeat their texture: its border is drawn instead")
    all_faces = np.concatenate(faces)
    if not len(all_faces):
        raise gltf.error("materials", "opaque somewhere", "holes alone")
    normals = _normals(rigged.vertices, all_faces)
    springs = placed_springs(gltf, rigged)
    arrays = {"positions": rigged.vertices, "normals": normals, "uv": np.concatenate(uv)}
    arrays["joints"], arrays["weights"] = _bytes(rigged.skin)
    if copied:
        # the other side of what has two: the player draws fronts alone
        back = np.concatenate(copied)
        own, corners = np.unique(back, return_inverse=True)
        all_faces = np.concatenate([all_faces, corners.reshape(-1, 3)[:, ::-1] + len(rigged.vertices)])
        arrays = {name: np.concatenate([values, values[own]]) for name, values in arrays.items()}
        arrays["normals"][len(rigged.vertices) :] *= -1
        if springs is not None:
            near, follows = (np.concatenate([rows, rows[own]]) for rows in (springs.near, springs.follows))
            springs = springs.with_followers(near, follows)
    count = len(arrays["positions"])
    upright = np.zeros((count, 6), np.float32)
    upright[:, [0, 3, 5]] = 1
    level = Level(
        positions=arrays["positions"].astype(np.float32),
        normals=arrays["normals"].astype(np.float32),
        uv=arrays["uv"].astype(np.float32),
        faces=all_faces.astype(np.uint32),
        joints=arrays["joints"],
        weights=arrays["weights"],
        view_dir=-arrays["normals"].astype(np.float32),
        view_q=upright,
        view_seen=np.zeros(count, np.float32),
        base_color=atlas.pixels,
        features=None,
        springs=springs,
    )
    avatar = Avatar(
        name=gltf.path.stem,
        joint_positions=rigged.joints,
        canonical_pose=np.zeros((52, 3)),
        levels=(level,),
        network=None,
        linear=None,
        amplitude=0.0,
        default_view="off",
        provenance={},
        notes=tuple(f"{gltf.path.name}: {note}" for note in notes),
    )
    try:
        check_avatar(avatar)
    except ValueError as error:
        raise AssetError(f"{gltf.path}: {error}") from None
    return avatar


def texture_atlas(pictures: list[UInt8[np.ndarray, "_height _width 3"]]) -> Atlas:
    """Pictures side by side in a grid of square cells, each as large as its cell allows; equal ones share a cell."""
    keys = [(picture.shape, picture.tobytes()) for picture in pictures]
    different = list(dict.fromkeys(keys))
    columns = int(np.ceil(np.sqrt(len(different))))
    largest = max(max(picture.shape[:2]) for picture in pictures) + 2 * RIM
    cell = min(largest, TEXTURE // columns)
    rows = -(-len(different) // columns)
    pixels = np.zeros((rows * cell, columns * cell, 3), np.uint8)
    corners, sizes = np.zeros((len(pictures), 2)), np.zeros((len(pictures), 2))
    whole = np.array([columns * cell, rows * cell])
    for number, (key, picture) in enumerate(zip(keys, pictures, strict=True)):
        place = different.index(key)
        shrink = min(1.0, (cell - 2 * RIM) / max(picture.shape[:2]))
        height, width = (max(1, round(shrink * size)) for size in picture.shape[:2])
        small = np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.BOX))
        x, y = cell * (place % columns), cell * (place // columns)
        rim = ((RIM, RIM), (RIM, RIM), (0, 0))
        pixels[y : y + height + 2 * RIM, x : x + width + 2 * RIM] = np.pad(small, rim, mode="edge")
        corners[number], sizes[number] = np.array([x + RIM, y + RIM]) / whole, np.array([width, height]) / whole
    return Atlas(pixels, corners, sizes)


def placed_springs(gltf: Gltf, rigged: Rigged) -> Springs | None:
    """The file's spring bones in pose 0 and what follows them; None: it has none. Notes say what was left out."""
    told = read_spring_bones(gltf)
    if told is None:
        return None
    rigged.notes.extend(told.notes)
    kept = _kept(told, rigged)
    if not kept:
        return None
    tree = rigged.tree
    bones = [told.bones[k] for k in kept]
    bone_of_node = {bone.node: k for k, bone in enumerate(bones)}
    # the bone that carries each node, itself or above it; a joint of the 52 lets go
    carrier = np.full(len(tree.parent), -1)
    for node in parents_first(tree.parent):
        above = tree.parent[node]
        inherited = carrier[above] if above >= 0 and node not in tree.joint_nodes else -1
        carrier[node] = bone_of_node.get(node, inherited)
    joints = np.array([tree.joint_of_node[bone.node] for bone in bones])
    heads, tails = _ends(told, rigged, kept)
    heads, tails = rigged.placed(heads, joints), rigged.placed(tails, joints)
    parents = np.array([carrier[tree.parent[bone.node]] if tree.parent[bone.node] >= 0 else -1 for bone in bones])
    colliders = told.colliders[:MOST_COLLIDERS]
    frames = [tree.place_rigid(one.node) for one in colliders]
    collider_joints = np.array([tree.joint_of_node[one.node] for one in colliders], int)
    ends = np.zeros((2, len(colliders), 3))
    radii = np.zeros(len(colliders))
    for k, (one, frame) in enumerate(zip(colliders, frames, strict=True)):
        ends[:, k] = np.stack([one.start, one.end]) @ frame[:3, :3].T + frame[:3, 3]
        radii[k] = one.radius * np.cbrt(abs(np.linalg.det(frame[:3, :3])))
    heeds = np.zeros((len(bones), len(colliders)), bool)
    centers = np.zeros(len(bones), int)
    for k, bone in enumerate(bones):
        heeds[k, [c for c in told.heeded[bone.chain] if c < len(colliders)]] = True
        center = told.centers[bone.chain]
        centers[k] = -1 if center < 0 else tree.joint_of_node[center]
    near, follows = _followers(rigged, carrier, heads, tails, parents)
    return Springs(
        heads, tails, joints, parents,
        np.array([bone.stiffness for bone in bones]), np.array([bone.gravity for bone in bones]) @ rigged.upright.T,
        np.array([bone.drag for bone in bones]), centers, np.array([bone.radius for bone in bones]),
        collider_joints, np.stack([rigged.placed(end, collider_joints) for end in ends]), radii, heeds, near, follows,
    )  # fmt: skip


def _kept(told: SpringBones, rigged: Rigged) -> list[int]:
    """The bones that can swing, parents before their children."""
    tree, notes = rigged.tree, rigged.notes
    depth = np.zeros(len(tree.parent), int)
    for node in parents_first(tree.parent):
        depth[node] = depth[tree.parent[node]] + 1 if tree.parent[node] >= 0 else 0
    order = sorted(range(len(told.bones)), key=lambda k: (depth[told.bones[k].node], k))
    heads, tails = _ends(told, rigged, order)
    long = np.linalg.norm(tails - heads, axis=1) > SHORTEST
    own = np.array([told.bones[k].node in tree.joint_nodes for k in order])
    if own.any():
        notes.append(f"{own.sum()} spring bones are joints of the body: they do not swing")
    if (~long & ~own).any():
        notes.append(f"{(~long & ~own).sum()} spring bones have no length: they do not swing")
    kept = [k for k, right in zip(order, long & ~own, strict=True) if right]
    if len(kept) > MOST_BONES:
        notes.append(f"{len(kept)} spring bones: those nearest to the body swing, {MOST_BONES} of them")
    return kept[:MOST_BONES]


def _ends(
    told: SpringBones, rigged: Rigged, which: list[int]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Head and tail of bones in the bind pose."""
    tree, cache = rigged.tree, {}

    def place(node: int) -> np.ndarray:
        if node not in cache:
            cache[node] = tree.bind[node][:3, 3] if node in tree.bind else tree.place_rigid(node)[:3, 3]
        return cache[node]

    heads, tails = np.zeros((len(which), 3)), np.zeros((len(which), 3))
    for row, k in enumerate(which):
        bone = told.bones[k]
        heads[row] = place(bone.node)
        if bone.tail >= 0:
            tails[row] = place(bone.tail)
        else:
            above = int(tree.parent[bone.node])
            along = heads[row] - place(above) if above >= 0 else np.zeros(3)
            length = np.linalg.norm(along)
            tails[row] = heads[row] + TIP * along / length if length > SHORTEST else heads[row]
    return heads, tails


def _followers(
    rigged: Rigged, carrier: Int[np.ndarray, "nodes"], heads: np.ndarray, tails: np.ndarray,
    parents: Int[np.ndarray, "bones"],
) -> tuple[Int[np.ndarray, "vertices 4"], Float[np.ndarray, "vertices 4"]]:  # fmt: skip
    """The four tails that each vertex follows most.

    What a bone moves is on its way from head to tail: at a share s of it a vertex goes (1 - s) as far as the head,
    which is its parent's tail, and s as far as the tail.
    """
    count = len(rigged.vertices)
    near, follows = np.zeros((count, 4), np.int64), np.zeros((count, 4))
    along = tails - heads
    length2 = (along * along).sum(1)
    start = 0
    for part in rigged.parts:
        owners = carrier[part.nodes]
        for first in range(0, len(owners), CHUNK):
            rows = first + np.flatnonzero((owners[first : first + CHUNK] >= 0).any(1))
            dense = np.zeros((len(rows), len(heads)))
            for slot in range(owners.shape[1]):
                moved = np.flatnonzero(owners[rows, slot] >= 0)
                bone, share = owners[rows[moved], slot], part.shares[rows[moved], slot]
                offset = rigged.vertices[start + rows[moved]] - heads[bone]
                s = np.clip((offset * along[bone]).sum(1) / length2[bone], 0, 1.5)
                np.add.at(dense, (moved, bone), share * s)
                held = parents[bone] >= 0
                np.add.at(dense, (moved[held], parents[bone[held]]), (share * (1 - s))[held])
            order = np.argsort(-np.abs(dense), axis=1, kind="stable")[:, :4]
            columns = order.shape[1]
            near[start + rows, :columns] = order
            follows[start + rows, :columns] = np.take_along_axis(dense, order, 1)
        start += len(owners)
    return near, follows


def _opaque(faces: np.ndarray, uv: np.ndarray, alpha: np.ndarray | None) -> np.ndarray:
    """Which triangles have anything opaque at their corners, edges or middle."""
    if alpha is None:
        return np.ones(len(faces), bool)
    a, b, c = (uv[faces[:, k]] for k in range(3))
    size = np.array(alpha.shape[::-1])
    found = np.zeros(len(faces), bool)
    for point in (a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2, (a + b + c) / 3):
        x, y = np.minimum((point * size).astype(int), size - 1).T
        found |= alpha[y, x] >= 128
    return found


def _bytes(skin: SkinWeights) -> tuple[UInt8[np.ndarray, "vertices 4"], UInt8[np.ndarray, "vertices 4"]]:
    """Joints and weights as bytes; rows of weights sum to 255."""
    weights = np.floor(skin.weights.astype(np.float64) * 255 + 1e-6).astype(np.int64)
    # the heaviest takes what rounding left
    weights[:, 0] += 255 - weights.sum(1)
    return np.where(weights > 0, skin.joints, 0).astype(np.uint8), weights.astype(np.uint8)


def _normals(vertices: Float[np.ndarray, "vertices 3"], faces: np.ndarray) -> Float[np.ndarray, "vertices 3"]:
    """Area-weighted, over all triangles at a place: seams of the texture do not show."""
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    _, place = np.unique(vertices.astype(np.float32), axis=0, return_inverse=True)
    place = place.reshape(-1)
    out = np.zeros((int(place.max()) + 1, 3))
    for corner in range(3):
        np.add.at(out, place[faces[:, corner]], area)
    length = np.linalg.norm(out, axis=1, keepdims=True)
    out = np.where(length > 1e-20, out / np.maximum(length, 1e-30), [0.0, 0.0, 1.0])
    return out[place]
