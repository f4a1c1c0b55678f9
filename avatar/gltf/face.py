"""The face in an avatar file. Its shapes are morph targets of the finest mesh, named as ARKit names them, and vertices
of coarser meshes follow its own. The eyes' balls are bound to two joints under the head, after all others, which
stand at the balls' centers. SELFSCAN_avatar says which vertices the balls are and how the eyes look.
docs/avatar-format.md describes the bytes.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from avatar.baked_avatar import MOST_MOVING, Avatar, Level
from avatar.face import SHAPES, SIDES, Eye, FaceShapes, Follow, followed
from avatar.gltf.document import Gltf
from avatar.gltf.scene import primitives
from avatar.gltf.write import GltfBuilder
from avatar.skeleton import JOINT_NUMBERS, joint_transforms
from files.input_file import JsonObject

FACE_VERSION = 1
HEAD = JOINT_NUMBERS["head"]
EYE_JOINTS = tuple(f"{side}_eye" for side in SIDES)


def eye_offsets(avatar: Avatar) -> Float[Array, "eyes 3"]:
    """Where the joints of the eyes stand, from the head's joint in its frame, metres; none without eyes."""
    head = joint_transforms(avatar.canonical_pose, avatar.joint_positions)[HEAD]
    centers = np.array([eye.center for eye in avatar.eyes or ()], np.float64).reshape(-1, 3)
    return (centers - head[:3, 3]) @ head[:3, :3]


def with_eyes(bones: Float[Array, "bones 4 4"], avatar: Avatar) -> Float[Array, "more 4 4"]:
    """Transforms of the bones, and behind them those of the eyes at rest."""
    eyes = np.tile(bones[HEAD], (len(avatar.eyes or ()), 1, 1))
    eyes[:, :3, 3] += eye_offsets(avatar) @ bones[HEAD, :3, :3].T
    return np.concatenate([bones, eyes])


def eyes_json(avatar: Avatar) -> JsonObject:
    """The extension's `face`."""
    eyes = (
        {"center": e.center.tolist(), "axis": e.axis.tolist(), "radius": float(e.radius)} for e in avatar.eyes or ()
    )
    return {"version": FACE_VERSION, "eyes": list(eyes)}


def bound_to_eyes(joints: Array, face: FaceShapes, first: int) -> Array:
    """Joints of vertices, those of the balls bound to the eyes, whose bones are number `first` and the next."""
    joints = joints.copy()
    for bone, (start, count) in enumerate(face.balls.astype(int).tolist()):
        joints[start : start + count] = first + bone
    return joints


def add_targets(builder: GltfBuilder, level: Level, face: FaceShapes) -> list[JsonObject]:
    """The morph targets of a level."""
    targets = []
    for offsets in face.offsets:
        moved = np.flatnonzero(offsets.any(axis=1))
        # glTF has no empty list: what moves nothing moves one vertex by nothing
        moved = moved if len(moved) else np.zeros(1, int)
        accessor = builder.add_sparse(face.vertices[moved], offsets[moved], len(level.positions))
        targets.append({"POSITION": accessor})
    return targets


def add_follow(builder: GltfBuilder, face: FaceShapes, follow: Follow) -> JsonObject:
    """Which vertices of a level follow which of the finest one."""
    small = max(int(face.vertices.max()), int(follow.sources.max())) < 1 << 16
    arrays = {"vertices": face.vertices, "sources": follow.sources, "weights": follow.weights}
    return {
        name: builder.add_accessor(values.astype(np.uint16) if small and values.itemsize > 1 else values)
        for name, values in arrays.items()
    }


def read_eyes(gltf: Gltf, extension: JsonObject, where: str) -> tuple[Eye, Eye] | None:
    """The eyes that the extension describes; None: the file has no face."""
    if "face" not in extension:
        return None
    face, where = extension["face"], f"{where}.face"
    if not isinstance(face, dict) or face.get("version") != FACE_VERSION:
        raise gltf.error(where, f"an object of version {FACE_VERSION}", face)
    items = gltf.objects(face, "eyes", where)
    if len(items) != 2:
        raise gltf.error(f"{where}.eyes", "the left and the right one", items)
    eyes = []
    for k, item in enumerate(items):
        place = f"{where}.eyes[{k}]"
        center, axis = (gltf.numbers(item, name, place, (3,)) for name in ("center", "axis"))
        radius = gltf.numbers({"radius": [item.get("radius")]}, "radius", place, (1,))
        eyes.append(Eye(center, axis, float(radius[0])))
    return eyes[0], eyes[1]


def read_face(
    gltf: Gltf, item: JsonObject, arrays: dict[str, Array], first: int, finest: FaceShapes | None, where: str
) -> FaceShapes | None:
    """The face of a level, and its balls' joints in `arrays` folded to the head; None: it stays still.

    first: the number of the left eye's bone.
    """
    if "balls" not in item:
        return None
    balls = gltf.numbers(item, "balls", where, (2, 2))
    count, mesh = len(arrays["positions"]), item["mesh"]
    if (balls != np.floor(balls)).any() or (balls < [0, 1]).any() or (balls.sum(1) > count).any():
        raise gltf.error(f"{where}.balls", f"first vertex and count of both, within {count}", item["balls"])
    balls = balls.astype(np.uint32)
    _fold_to_head(gltf, arrays, balls.astype(int), first, f"meshes[{mesh}].primitives[0].JOINTS_0")

    if "follow" in item:
        return _read_follow(gltf, item["follow"], balls, finest, f"{where}.follow")
    extras, targets = gltf.items("meshes")[mesh].get("extras"), primitives(gltf, mesh)[0].get("targets")
    names = extras.get("targetNames") if isinstance(extras, dict) else None
    if names != list(SHAPES):
        raise gltf.error(f"meshes[{mesh}].extras.targetNames", f"ARKit's {len(SHAPES)} names in order", names)
    where = f"meshes[{mesh}].primitives[0].targets"
    if not isinstance(targets, list) or len(targets) != len(SHAPES) or not all(isinstance(t, dict) for t in targets):
        raise gltf.error(where, f"a list of {len(SHAPES)} objects", targets)
    rows, values = [], []
    for k, target in enumerate(targets):
        if list(target) != ["POSITION"]:
            raise gltf.error(f"{where}[{k}]", "of POSITION alone", list(target))
        dense = gltf.accessor(target["POSITION"], field=f"{where}[{k}].POSITION")
        if dense.shape != (count, 3) or dense.dtype != np.float32:
            raise gltf.error(f"{where}[{k}].POSITION", f"({count}, 3) floats", (dense.shape, dense.dtype.name))
        rows.append(np.flatnonzero(dense.any(axis=1)))
        values.append(dense[rows[-1]])
    vertices = np.unique(np.concatenate(rows))
    if not 1 <= len(vertices) <= MOST_MOVING:
        raise gltf.error(where, f"of 1 to {MOST_MOVING} vertices", len(vertices))
    offsets = np.zeros((len(SHAPES), len(vertices), 3), np.float32)
    for shape, moved, by in zip(offsets, rows, values, strict=True):
        shape[np.searchsorted(vertices, moved)] = by
    return FaceShapes(vertices.astype(np.uint32), offsets, balls)


def _read_follow(gltf: Gltf, item: object, balls: Array, finest: FaceShapes | None, where: str) -> FaceShapes:
    """The face of a level below the finest one."""
    if not isinstance(item, dict) or finest is None:
        raise gltf.error(where, "an object, of a level below a finest one with a face", item)
    names = ("vertices", "sources", "weights")
    vertices, sources, weights = (gltf.accessor(item.get(name), field=f"{where}.{name}") for name in names)
    count = len(vertices)
    if count > MOST_MOVING or (vertices.shape, sources.shape, weights.shape) != ((count,), (count, 4), (count, 4)):
        rows = f"at most {MOST_MOVING} rows of one vertex, four sources and four weights"
        raise gltf.error(where, rows, (vertices.shape, sources.shape, weights.shape))
    if any(values.dtype.kind != "u" for values in (vertices, sources)) or weights.dtype != np.uint8:
        raise gltf.error(where, "whole numbers, weights of a byte", (vertices.dtype.name, weights.dtype.name))
    follow = Follow(sources.astype(np.uint32), weights)
    return FaceShapes(vertices.astype(np.uint32), followed(finest, follow), balls, follow)


def _fold_to_head(gltf: Gltf, arrays: dict[str, Array], balls: Array, first: int, where: str) -> None:
    """The balls' vertices, bound to the eyes' bones alone, bound to the head; no other vertex may be."""
    joints, weights = arrays["joints"], arrays["weights"]
    if joints.dtype != np.uint8 or joints.shape[1:] != (4,) or joints.shape != weights.shape:
        # refused with all other skins of another kind
        return
    on_eye = np.asarray(((joints >= first) & (joints < first + 2)).any(axis=1))
    for bone, (start, count) in enumerate(balls):
        ball = slice(start, start + count)
        if not ((joints[ball] == first + bone) | (weights[ball] == 0)).all():
            raise gltf.error(where, f"of the {SIDES[bone]} ball {EYE_JOINTS[bone]} alone", joints[start].tolist())
        on_eye[ball] = False
        joints[ball] = np.where(weights[ball] > 0, HEAD, 0)
    if on_eye.any():
        raise gltf.error(where, "of the balls alone those of the eyes", f"vertex {int(np.argmax(on_eye))}")
