"""A whole avatar of a few kilobytes, and ways to spoil its file."""

import json
import struct
from dataclasses import replace

import numpy as np

from avatar.body import builtin_body
from avatar.face import Eye, FaceShapes, Follow, followed
from avatar.gltf.avatar_file import Avatar, Level, ViewNetwork
from avatar.skeleton import BIG_POSE


def unit(vectors):
    return (vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)).astype(np.float32)


def tiny_level(seed=0, *, vertices=8, faces=6, size=4, features=4) -> Level:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(vertices, 3, 2))
    q = np.einsum("nik,njk->nij", root, root)[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    joints = np.array([rng.choice(52, 4, replace=False) for _ in range(vertices)])
    cuts = np.sort(rng.integers(1, 255, (vertices, 3)), axis=1)
    weights = np.diff(cuts, prepend=0, append=255, axis=1)
    return Level(
        positions=rng.normal(size=(vertices, 3)).astype(np.float32),
        normals=unit(rng.normal(size=(vertices, 3))),
        uv=rng.random((vertices, 2), dtype=np.float32),
        faces=np.array([rng.choice(vertices, 3, replace=False) for _ in range(faces)]).astype(np.uint32),
        joints=np.where(weights > 0, joints, 0).astype(np.uint8),
        weights=weights.astype(np.uint8),
        view_dir=unit(rng.normal(size=(vertices, 3))),
        view_q=q.astype(np.float32),
        view_seen=rng.random(vertices, dtype=np.float32),
        base_color=rng.integers(0, 256, (size, size, 3), dtype=np.uint8),
        features=rng.integers(0, 256, (size // 2, size, features), dtype=np.uint8) if features else None,
    )


def tiny_avatar(seed=0, **changes) -> Avatar:
    rng = np.random.default_rng(seed)

    def normal(*shape):
        return rng.normal(size=shape).astype(np.float32)

    fields = {
        "name": "tiny",
        "joint_positions": builtin_body("male").joints.astype(np.float64),
        "canonical_pose": np.array(BIG_POSE),
        "levels": (tiny_level(1), tiny_level(2, vertices=5, faces=3, size=2)),
        "network": ViewNetwork(normal(16, 8), normal(16), normal(3, 16), normal(3)),
        "linear": normal(4, 3, 3),
        "amplitude": 0.6,
        "default_view": "network",
        "provenance": {"preset": "demo", "psnr_db": [31.5, None], "licence": "CC0 – née"},
    }
    return Avatar(**(fields | changes))


def tiny_face(seed=0, **changes) -> Avatar:
    """One whose first level has a face of a few vertices: of its 12, two and two are the eyes' balls. One vertex of the
    second follows them."""
    rng = np.random.default_rng(seed)
    level = tiny_level(1, vertices=12)
    joints, weights = level.joints.copy(), level.weights.copy()
    joints[8:], weights[8:] = 15, [255, 0, 0, 0]
    joints[8:, 1:] = 0
    offsets = (rng.normal(size=(52, 3, 3)) * (rng.random((52, 3, 1)) < 0.5) * 0.01).astype(np.float32)
    # the last, tongueOut, moves nothing
    offsets[0], offsets[-1] = 0.01, 0
    face = FaceShapes(np.array([0, 3, 7], np.uint32), offsets, np.array([[8, 2], [10, 2]], np.uint32))
    eyes = [Eye(rng.normal(size=3), np.array([0.0, 0.6, 0.8]), 0.012) for _ in range(2)]
    follow = Follow(np.array([[7, 0, 3, 1]], np.uint32), np.array([[100, 100, 50, 5]], np.uint8))
    below = FaceShapes(np.array([4], np.uint32), followed(face, follow), np.array([[0, 2], [2, 2]], np.uint32), follow)
    second = tiny_level(2, vertices=5, faces=3, size=2)
    second.joints[:4], second.weights[:4] = [15, 0, 0, 0], [255, 0, 0, 0]
    levels = (replace(level, joints=joints, weights=weights, face=face), replace(second, face=below))
    return tiny_avatar(seed, levels=levels, eyes=tuple(eyes), **changes)


def same(a, b) -> bool:
    """Whether two avatars, or parts of them, are equal to the last bit."""
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and np.array_equal(a, b)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if hasattr(a, "__dataclass_fields__"):
        return type(a) is type(b) and all(same(getattr(a, f), getattr(b, f)) for f in a.__dataclass_fields__)
    return type(a) is type(b) and a == b


def split_glb(data: bytes) -> tuple[dict, bytearray]:
    """The JSON and the binary chunk of a GLB."""
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), bytearray(data[28 + size :])


def join_glb(document: dict | str, binary: bytes) -> bytes:
    """A GLB of this JSON, honest about its own lengths."""
    text = (document if isinstance(document, str) else json.dumps(document)).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + bytes(binary)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
