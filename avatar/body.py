"""Body models: the built-in free body, and a user's own SMPL+H model file."""

from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from avatar.constant import constant
from avatar.skeleton import JOINTS, PARENTS
from avatar.skinning import SkinWeights, strongest_four
from command.errors import AssetError
from files.npz import field, indices, read_npz
from files.unpickle import read_pickle

HANDS = ("hands_meanl", "hands_meanr", "hands_componentsl", "hands_componentsr")
# what is read of a model; its pose correctives (`posedirs`, 74 MB) are not
FIELDS = ("v_template", "f", "weights", "shapedirs", "kintree_table", "J", "J_regressor", "joint_dirs", "vt", "ft",
          *HANDS)  # fmt: skip


@dataclass(frozen=True)
class HandSpace:
    """MANO's space of hand poses (Romero et al. 2017): pose = coefficients @ components + mean. Left, then right."""

    mean: Float[Array, "2 45"]
    components: Float[Array, "2 components 45"]


@dataclass(frozen=True)
class Body:
    """A shaped body in pose 0, pelvis joint at the origin, metres."""

    name: str
    vertices: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]
    skin: SkinWeights
    joints: Float[Array, "52 3"]
    shape_directions: Float[Array, "vertices 3 shapes"]  # metres per unit of beta
    joint_directions: Float[Array, "52 3 shapes"]
    uv: Float[Array, "texcoords 2"] | None  # glTF convention, v down
    uv_faces: Int[Array, "faces 3"] | None
    licence: str
    # where the file puts the pelvis joint: added to AMASS trans
    origin: Float[Array, "3"]
    # merged SMPL+H models have it
    hands: HandSpace | None = None


@constant
def builtin_body(sex: str) -> Body:
    """The free body that ships with the project; `sex` is "male" or "female". Provenance: THIRD_PARTY.md."""
    if sex not in ("male", "female"):
        raise ValueError(f"sex should be 'male' or 'female', is {sex!r}")
    path = Path(str(files("avatar") / "data" / "body" / f"body_{sex}.npz"))
    return replace(read_body(path), name=f"builtin:{sex}", licence="CC0-1.0 (MakeHuman base mesh)")


def shaped(body: Body, betas: Float[Array, "n"]) -> Body:
    """The body with its shape changed: vertices and joints move linearly with beta; the pelvis stays at 0.

    Raises:
        ValueError: more coefficients than the body has directions.
    """
    count = len(betas)
    if count > body.shape_directions.shape[2]:
        raise ValueError(f"{count} shape coefficients, but {body.name} has {body.shape_directions.shape[2]}")
    vertices = body.vertices + body.shape_directions[:, :, :count] @ betas
    joints = body.joints + body.joint_directions[:, :, :count] @ betas
    return replace(body, vertices=vertices - joints[0], joints=joints - joints[0], origin=body.origin + joints[0])


def read_body(path: Path | str) -> Body:
    """Read an SMPL+H model (.npz, .pkl) or a body of ours: v_template, f, weights, J or J_regressor, shapedirs, ...

    SMPL+H itself is licensed and must be obtained by the user (mano.is.tue.mpg.de); the format is read here.
    Nothing in a .pkl is run (files/unpickle.py). A model with hands_meanl/r and hands_componentsl/r has `hands`.

    Raises:
        AssetError: a field is absent, misshapen or not finite, or the tree is not SMPL+H's. File and field named.
    """
    path = Path(path)
    fields = _model_fields(path)
    vertices = field(path, fields, "v_template", (None, 3))
    count = len(vertices)
    faces = indices(path, fields, "f", (None, 3), count, "vertices")
    if not len(faces):
        raise AssetError(f"{path}: f should be triangles, is empty")
    weights = field(path, fields, "weights", (count, 52))
    try:
        skin = strongest_four(weights)
    except ValueError as error:
        raise AssetError(f"{path}: weights: {error}") from None
    shapes = field(path, fields, "shapedirs", (count, 3, None))
    tree = field(path, fields, "kintree_table", (2, 52)).astype(np.int64)
    if (tree[0, 1:] != PARENTS[1:]).any():
        joint = int(np.argmax(tree[0, 1:] != PARENTS[1:])) + 1
        raise AssetError(
            f"{path}: kintree_table should be SMPL+H's; the parent of {JOINTS[joint]} is {int(tree[0, joint])}, "
            f"expected {int(PARENTS[joint])}"
        )
    joint_directions = np.zeros((52, 3, shapes.shape[2]))
    joints = None
    if "J_regressor" in fields:
        regressor = field(path, fields, "J_regressor", (52, count))
        joints, joint_directions = regressor @ vertices, np.einsum("jv,vcs->jcs", regressor, shapes)
    if "J" in fields:
        joints = field(path, fields, "J", (52, 3))
    if "joint_dirs" in fields:
        joint_directions = field(path, fields, "joint_dirs", (52, 3, shapes.shape[2]))
    if joints is None:
        raise AssetError(f"{path}: neither J nor J_regressor; the file has {sorted(fields)}")
    uv = uv_faces = None
    if "vt" in fields and "ft" in fields:
        uv = field(path, fields, "vt", (None, 2)) * [1, -1] + [0, 1]  # the file's v runs up
        uv_faces = indices(path, fields, "ft", (len(faces), 3), len(uv), "points of vt")
    licence = "the licence of your own model file"
    return Body(
        path.stem, vertices - joints[0], faces, skin, joints - joints[0], shapes, joint_directions, uv, uv_faces,
        licence, joints[0], _hand_space(path, fields),
    )  # fmt: skip


def _model_fields(path: Path) -> dict[str, Array]:
    if path.suffix.lower() != ".pkl":
        return _doubles(read_npz(path, "an SMPL+H model", (), FIELDS))
    content = read_pickle(path, "an SMPL+H model")
    if type(content) is not dict or not all(isinstance(name, str) for name in content):
        raise AssetError(f"{path}: expected an SMPL+H model, a dict of arrays, found a {type(content).__name__}")
    return _doubles({name: content[name] for name in FIELDS if isinstance(content.get(name), Array)})


def _doubles(fields: dict[str, Array]) -> dict[str, Array]:
    return {name: array.astype(np.float64) if array.dtype.kind in "biuf" else array for name, array in fields.items()}


def _hand_space(path: Path, fields: dict[str, Array]) -> HandSpace | None:
    if not any(name in fields for name in HANDS):
        return None
    mean = np.stack([field(path, fields, name, (45,)) for name in HANDS[:2]])
    left, right = (field(path, fields, name, (None, 45)) for name in HANDS[2:])
    if len(left) != len(right):
        raise AssetError(f"{path}: hands_componentsr should be {left.shape} as hands_componentsl, is {right.shape}")
    return HandSpace(mean, np.stack([left, right]))
