"""A filmed person: a skinned, textured mesh in pose 0 with its own 52 joints, read from any humanoid glTF.

Frame: pose 0 (T-pose), pelvis joint at the origin, +x the subject's left, +y up, +z out of the chest, metres.
avatar/gltf/rigged.py says how a rig becomes that.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from avatar.gltf.document import Gltf, read_gltf
from avatar.gltf.rigged import read_rigged
from avatar.gltf.scene import read_base_color
from avatar.skeleton import JOINTS, PARTS
from avatar.skinning import SkinWeights
from capture.read.template import part_of
from command.errors import AssetError

HAIR_NAME = re.compile(r"wig|hair|ponytail|afro|beard", re.IGNORECASE)
# eyeballs; lids, lashes, brows and glasses are called after the eye as well
EYE_NAME = re.compile(r"eyes?(balls?)?(?![a-z])", re.IGNORECASE)
# metres: a mesh on the head alone and larger than this in two directions is no eye and no tooth
HAIR_SIZE = 0.10


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
    # vertices of the eyeballs; None: the file does not separate them
    eye: Bool[np.ndarray, "vertices"] | None = None
    # named places of the face (synth/face_places.py), where they are known; None: they are looked for
    features: dict[str, Float[np.ndarray, "3"]] | None = None


def read_subject(path: Path) -> SynthSubject:
    """Read a rigged humanoid .glb, .gltf or .vrm.

    Raises:
        AssetError: the file is unreadable, compressed, without a mesh, or its rig lacks a joint.
    """
    path = Path(path)
    if not path.exists():
        raise AssetError(
            f"{path}: no such file; expected builtin, builtin:female, builtin:SEED "
            "or a rigged person (.glb, .gltf, .vrm)"
        )
    gltf = read_gltf(path)
    rigged = read_rigged(gltf)
    meshes, vertices, skin, joints, notes = rigged.parts, rigged.vertices, rigged.skin, rigged.joints, rigged.notes

    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, offsets, strict=False)])
    materials = sorted({mesh.material for mesh in meshes})
    textures, alpha = zip(*(read_base_color(gltf, index, notes) for index in materials), strict=True)
    part = part_of(skin)
    hair, eye = np.zeros((2, len(vertices)), bool)
    for mesh, start in zip(meshes, offsets, strict=False):
        own = slice(start, start + len(mesh.vertices))
        on_head = mesh.weights[:, JOINTS.index("head")].mean() > 0.9
        # called so, or too large for an eye
        large = np.sort(np.ptp(mesh.vertices, axis=0))[1] > HAIR_SIZE
        hair[own] = bool(HAIR_NAME.search(mesh.called)) or (on_head and large)
        eye[own] = on_head and not large and not HAIR_NAME.search(mesh.called) and bool(EYE_NAME.search(mesh.called))
    part[hair] = PARTS.index("head")  # hair that hangs over the shoulders is measured with the head all the same
    subject = SynthSubject(
        name=path.stem,
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.int32),
        uv=np.concatenate([mesh.uv for mesh in meshes]).astype(np.float32),
        material=np.repeat(
            [materials.index(mesh.material) for mesh in meshes], [len(mesh.faces) for mesh in meshes]
        ).astype(np.int32),
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
