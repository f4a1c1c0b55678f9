"""The template of an imported person: a shaped SMPL+H body, or the body that the authors' folder holds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from avatar.body import Body
from avatar.skeleton import JOINTS, LEFT_HAND, PARENTS, PARTS, RIGHT_HAND
from avatar.skinning import SkinWeights
from capture.folder import other_unit
from command.errors import AssetError
from files.whole import whole_file

HEIGHT = (1.0, 2.5)  # metres, of a person in a T-pose
LICENSED = "fitted with a licensed body model ({}): avatars made from it are not redistributable without its licence"


@dataclass(frozen=True)
class TemplateMesh:
    """A body in pose 0, pelvis joint at the origin, metres."""

    vertices: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]
    skin: SkinWeights
    joints: Float[Array, "52 3"]
    licence: str
    uv: Float[Array, "texcoords 2"] | None = None
    uv_faces: Int[Array, "faces 3"] | None = None

    @property
    def part(self) -> UInt8[Array, "vertices"]:
        return part_of(self.skin)


def body_template(body: Body) -> TemplateMesh:
    licence = body.licence if body.name.startswith("builtin") else LICENSED.format(body.name)
    return TemplateMesh(body.vertices, body.faces, body.skin, body.joints, licence, body.uv, body.uv_faces)


def part_of(skin: SkinWeights) -> UInt8[Array, "vertices"]:
    """The part of each vertex: that of the joint with most weight; wrist and fingers are hand, the neck is body."""
    part_of_joint = np.zeros(len(JOINTS), np.uint8)
    part_of_joint[JOINTS.index("head")] = PARTS.index("head")
    part_of_joint[LEFT_HAND] = part_of_joint[JOINTS.index("left_wrist")] = PARTS.index("hand_left")
    part_of_joint[RIGHT_HAND] = part_of_joint[JOINTS.index("right_wrist")] = PARTS.index("hand_right")
    return part_of_joint[skin.heaviest]


def check_height(place: str, vertices: Float[Array, "vertices 3"]) -> None:
    """Refuse a body that is not as tall as a person: another unit, another up axis, a part of a body."""
    height = float(np.ptp(vertices[:, 1]))
    if not HEIGHT[0] <= height <= HEIGHT[1]:
        found = f"{height:.4g}{other_unit(height)}"
        raise AssetError(f"{place} should be a person {HEIGHT[0]} to {HEIGHT[1]} m tall (y up, metres), is {found}")


def write_template(
    path: Path,
    template: TemplateMesh,
    hair: Bool[Array, "vertices"] | None = None,
    eyes: Float[Array, "2 4"] | None = None,
) -> None:
    """Write subject.npz; no vertex is marked as hair, and no eye is placed, where the source does not say."""
    fields: dict[str, Any] = {
        "v_template": template.vertices.astype(np.float64),
        "faces": template.faces.astype(np.int32),
        "skin_joints": template.skin.joints.astype(np.uint8),
        "skin_weights": template.skin.weights.astype(np.float32),
        "joints": template.joints.astype(np.float64),
        "parents": PARENTS,
        "hair": np.zeros(len(template.vertices), bool) if hair is None else hair,
        "part": template.part,
    }
    if template.uv is not None and template.uv_faces is not None:
        fields |= {"uv": template.uv, "uv_faces": template.uv_faces}
    if eyes is not None:
        fields["eyes"] = eyes
    with whole_file(path) as file:
        np.savez_compressed(file, **fields)
