"""A painted person as a rigged glTF file that `synth.subject.read_subject` reads back bit by bit.

A glTF mesh is cut into a primitive for each material. `asset.extras.selfscan` keeps what that loses: the number of
each vertex and triangle before the cut, which vertices are hair, which joins the skin without a seam, and the weights,
which a reader scales once more to the sum 1 and so rounds.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from avatar.gltf.write import INDICES, VERTICES, GltfBuilder
from avatar.skeleton import JOINTS, PARENTS
from files.whole import whole_file
from synth.subject import SynthSubject

Array = np.ndarray


def write_subject(path: Path, subject: SynthSubject) -> None:
    """Write a subject whose textures are opaque; the same subject gives the same bytes."""
    builder = GltfBuilder()
    weights = subject.skin.weights
    joints = np.where(weights > 0, subject.skin.joints, 0).astype(np.uint8)
    primitives, vertex_order, face_order = [], [], []
    for material in range(len(subject.textures)):
        chosen = np.flatnonzero(subject.material == material)
        used, corners = np.unique(subject.faces[chosen], return_inverse=True)
        attributes = {
            "POSITION": builder.add_accessor(subject.vertices[used], VERTICES, bounds=True),
            "TEXCOORD_0": builder.add_accessor(subject.uv[used], VERTICES),
            "JOINTS_0": builder.add_accessor(joints[used], VERTICES),
            "WEIGHTS_0": builder.add_accessor(weights[used], VERTICES),
        }
        # the largest index of a type is kept for primitive restart
        small = np.uint16 if len(used) < 65535 else np.uint32
        indices = builder.add_accessor(corners.reshape(-1).astype(small), INDICES)
        primitives.append({"attributes": attributes, "indices": indices, "material": material})
        vertex_order.append(used)
        face_order.append(chosen)
    vertices = np.concatenate(vertex_order)
    extras = {
        "vertices": builder.add_accessor(vertices.astype(np.uint32)),
        "faces": builder.add_accessor(np.concatenate(face_order).astype(np.uint32)),
        "hair": builder.add_accessor(subject.hair[vertices].astype(np.uint8)),
        "weights": builder.add_accessor(weights[vertices]),
    }
    joint_from_mesh = np.tile(np.eye(4, dtype=np.float32), (len(JOINTS), 1, 1))
    joint_from_mesh[:, :3, 3] = -subject.joints
    described = builder.add_accessor(joint_from_mesh)
    names = ("body", "head", "eyes", "skirt")[: len(subject.textures)]
    document: dict[str, Any] = {
        "asset": {
            "version": "2.0",
            "generator": "selfscan experiments.builtin",
            "copyright": subject.licence,
            "extras": {"selfscan": extras},
        },
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0, len(JOINTS)]}],
        "nodes": [*_skeleton(subject.joints), {"name": subject.name, "mesh": 0, "skin": 0}],
        "skins": [{"joints": list(range(len(JOINTS))), "skeleton": 0, "inverseBindMatrices": described}],
        "meshes": [{"name": subject.name, "primitives": primitives}],
        "materials": [
            {
                "name": name,
                "pbrMetallicRoughness": {"baseColorTexture": {"index": i}, "metallicFactor": 0, "roughnessFactor": 1},
                "extensions": {"KHR_materials_unlit": {}},
            }
            for i, name in enumerate(names)
        ],
        "textures": [
            {"sampler": 0, "source": builder.add_image(_small_png(texture), name)}
            for name, texture in zip(names, subject.textures, strict=True)
        ],
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
    }
    with whole_file(path) as file:
        file.write(builder.to_bytes(document))


def _skeleton(joints: Float[Array, "52 3"]) -> list[dict[str, Any]]:
    """The joints' nodes, parallel to the world."""
    nodes = []
    for joint, name in enumerate(JOINTS):
        parent = PARENTS[joint]
        offset = joints[joint] - (joints[parent] if parent >= 0 else 0)
        children = [int(child) for child in np.flatnonzero(joint == PARENTS)]
        node: dict[str, Any] = {"name": name, "translation": [float(x) for x in offset]}
        nodes.append(node | ({"children": children} if children else {}))
    return nodes


def _small_png(image: UInt8[Array, "height width 3"]) -> bytes:
    out = io.BytesIO()
    Image.fromarray(image).save(out, format="PNG", optimize=True)
    return out.getvalue()
